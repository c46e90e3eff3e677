"""The watch over robots until it is ended: encoder counts where a robot reports them, else stops and faults."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import UnreachableError, WrongDeviceError
from cellcal.drivers.interfaces import Condition, Readiness, Robot
from cellcal.drivers.supervision import raise_lost_cancellation, supervise
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.healthy_counts import LastHealthyCounts
from cellcal.service.record.journal_files import lease_folder
from cellcal.service.record.robot_lock import DEVICES, is_held
from cellcal.service.record.shown_positions import KeptPositions
from cellcal.service.watching.loss_modes import wrong_robot
from cellcal.service.watching.mastering_comparison import MasteringComparison, journalled_mastering
from cellcal.service.watching.position_comparison import PositionComparison, journalled_position
from cellcal.service.watching.watch import PositionLoss, RobotWatch, ZeroComparison
from cellcal.service.watching.watch_coverage import describe_coverage, sees_losses
from cellcal.service.watching.zero_comparisons import ZeroComparisons

_LOG = logging.getLogger(__name__)
_RETRY_S = 5.0


async def _ignore_robot(robot: Robot, condition: Condition) -> None:
    """Ask the robot nothing more."""


def _ignore_unreachable(robot: str, condition: Condition | None) -> None:
    """Do nothing: the default of ``RobotListener.missed``."""


@dataclass(frozen=True, slots=True)
class RobotListener:
    """The receiver of what is seen of robots that are followed."""

    say: Callable[[str], None]
    looked: Callable[[Robot, Condition], Awaitable[None]] = _ignore_robot  # after each look at one
    missed: Callable[[str, Condition | None], None] = (
        _ignore_unreachable  # out of reach; None: left to another cellcal
    )


class RobotWatches:
    """The watch of each robot that tells its encoders. What one has reported outlives a connection."""

    def __init__(
        self,
        config: CellConfig,
        on_loss: Callable[[PositionLoss], Awaitable[None]],
        warn: Callable[[str], None] = _LOG.warning,
    ) -> None:
        self.config, self.on_loss, self._warn = config, on_loss, warn
        self._memory = LastHealthyCounts(config.cell.data_dir)
        self._watches: dict[str, RobotWatch] = {}

    def watch_of(self, name: str, robot: Robot) -> RobotWatch:
        """Return the watch of a robot that is reached just now."""
        if name not in self._watches:
            self._watches[name] = RobotWatch(
                robot, self._memory, self.on_loss,
                period_s=self.config.watch.period_s, warn=self._warn, comparison=self._comparison_for(name, robot),
            )  # fmt: skip
        self._watches[name].use_connection(robot)
        return self._watches[name]

    def _comparison_for(self, name: str, robot: Robot) -> ZeroComparison:
        serial = self.config.robot_named(name).serial
        mastering = MasteringComparison(journalled_mastering(self.config, serial))
        if robot.capabilities.writes_mastering:
            return mastering
        memory, newest = KeptPositions(self.config.cell.data_dir), journalled_position(self.config, serial)
        position = PositionComparison(memory, serial, newest, warn=self._warn)
        return ZeroComparisons(mastering, position) if robot.capabilities.reads_mastering else position

    def existing_watch(self, name: str) -> RobotWatch | None:
        """Return the watch of a robot that was reached before."""
        return self._watches.get(name)

    def pause_for_run(self, name: str) -> None:
        """Note that a run has the robot: its own steps guard the encoders."""
        if name in self._watches:
            self._watches[name].forget_motion()


async def follow_robots(watches: RobotWatches, listener: RobotListener) -> None:
    """Watch all robots of a cell until cancelled."""
    async with asyncio.TaskGroup() as tasks:
        for entry in watches.config.robots:
            work = partial(follow_robot, watches, entry, listener)
            tasks.create_task(supervise(make_message("watch of {robot}", robot=entry.name), work))


async def follow_robot(watches: RobotWatches, entry: Any, listener: RobotListener) -> None:
    """Watch one robot until cancelled; an unreachable one is looked for again and again.

    The connection is left to the holder of the right to connect.
    """
    last_message = suspected = ""
    while True:
        raise_lost_cancellation()
        if not _is_free(watches, entry):
            listener.missed(entry.name, None)
            await asyncio.sleep(_RETRY_S)
            continue
        try:
            async with entry.open() as robot:
                coverage = describe_coverage(robot.capabilities)
                listener.say(f"{robot.name}: watched every {watches.config.watch.period_s:g} s: {coverage}.")
                last_message = suspected = ""
                await _watch_while_free(watches, entry, robot, listener)
                continue
        except WrongDeviceError as error:
            listener.missed(entry.name, Condition(Readiness.NOT_READY, error.message, error.remedy))
            if error.message != suspected:  # one damaged answer is no other robot: it has to say so again
                suspected = error.message
                listener.say(f"{error}")
            elif error.message != last_message:
                last_message = error.message
                await watches.on_loss(PositionLoss(entry.name, error.message, (), None, wrong_robot()))
        except CellError as error:
            listener.missed(entry.name, Condition(Readiness.UNREACHABLE, error.message, error.remedy))
            if error.message != last_message:
                listener.say(f"{error}")
                last_message = error.message
        await asyncio.sleep(_RETRY_S)


def _is_free(watches: RobotWatches, entry: Any) -> bool:
    """Whether no other process is connected to a robot: a second connection could take the link away from a run."""
    if is_held(lease_folder(watches.config), entry.serial, DEVICES):
        watches.pause_for_run(entry.name)
        return False
    return True


async def _watch_while_free(watches: RobotWatches, entry: Any, robot: Robot, listener: RobotListener) -> None:
    stops = _StopReporter(robot.name, listener.say)
    while _is_free(watches, entry):
        if sees_losses(robot.capabilities):
            watch = watches.watch_of(entry.name, robot)
            if await watch.look_once() is not None:
                watch.forget_motion()  # a recovery may have moved it
            condition = watch.condition
        else:
            condition = await robot.read_condition()
            stops.on_condition(condition)
        if condition.readiness is Readiness.UNREACHABLE:
            raise UnreachableError(
                robot.name, condition.message or "it does not answer.", remedy=condition.remedy
            )
        await listener.looked(robot, condition)
        await asyncio.sleep(watches.config.watch.period_s)


class _StopReporter:
    """Says each time that a robot stops, or does not stand stopped any more."""

    def __init__(self, robot: str, say: Callable[[str], None]) -> None:
        self._robot, self._say, self._reported = robot, say, ""

    def on_condition(self, condition: Condition) -> None:
        """Take in how the robot is at this look."""
        stopped = condition.readiness is Readiness.STOPPED
        words = (
            make_message(
                "{robot}: {condition_message} {condition_remedy}",
                robot=self._robot,
                condition_message=condition.message,
                condition_remedy=condition.remedy,
            )
            if stopped
            else ""
        )
        if words != self._reported:
            self._say(words or f"{self._robot}: neither stopped nor out of reach any more.")
        self._reported = words
