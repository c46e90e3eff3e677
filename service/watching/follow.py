"""The watch over robots until somebody ends it: encoders where a robot tells them, else stops and faults."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

from cellcal.calibration.errors import CellError
from cellcal.drivers.errors import UnreachableError, WrongDeviceError
from cellcal.drivers.interfaces import Condition, Readiness, Robot
from cellcal.drivers.supervision import raise_lost_cancellation, supervise
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.healthy_counts import LastHealthyCounts
from cellcal.service.record.journal_files import leases
from cellcal.service.record.robot_lock import DEVICES, is_held
from cellcal.service.watching.loss_modes import wrong_robot
from cellcal.service.watching.mastering_comparison import HeldMastering, journalled_mastering
from cellcal.service.watching.watch import PositionLoss, Watch, WatchedRobot
from cellcal.service.watching.watched import watched

_LOG = logging.getLogger(__name__)
_RETRY_S = 5.0


async def _look_no_further(robot: Robot, condition: Condition) -> None:
    """Ask the robot nothing more."""


def _miss_nobody(robot: str, condition: Condition | None) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True)
class Listener:
    """Who hears what is seen of robots that are followed."""

    say: Callable[[str], None]
    looked: Callable[[Robot, Condition], Awaitable[None]] = _look_no_further  # after each look at one
    missed: Callable[[str, Condition | None], None] = (
        _miss_nobody  # out of reach; None: left to another cellcal
    )


class Watches:
    """The watch of each robot that tells its encoders. What one has reported outlives a connection."""

    def __init__(
        self,
        config: CellConfig,
        on_loss: Callable[[PositionLoss], Awaitable[None]],
        warn: Callable[[str], None] = _LOG.warning,
    ) -> None:
        self.config, self.on_loss, self._warn = config, on_loss, warn
        self._memory = LastHealthyCounts(config.cell.data_dir)
        self._watches: dict[str, Watch] = {}

    def of(self, name: str, robot: Robot) -> Watch:
        """Return the watch of a robot that is reached just now."""
        encoders = cast(WatchedRobot, robot)
        if name not in self._watches:
            held = HeldMastering(journalled_mastering(self.config, self.config.robot(name).serial))
            self._watches[name] = Watch(
                encoders, self._memory, self.on_loss,
                period_s=self.config.watch.period_s, warn=self._warn, held=held,
            )  # fmt: skip
        self._watches[name].meet(encoders)
        return self._watches[name]

    def known(self, name: str) -> Watch | None:
        """Return the watch of a robot that was reached before."""
        return self._watches.get(name)

    def left_to_a_run(self, name: str) -> None:
        """Note that a run has the robot: its own steps guard the encoders."""
        if name in self._watches:
            self._watches[name].forget_motion()


async def follow(watches: Watches, listener: Listener) -> None:
    """Watch all robots of a cell until cancelled."""
    async with asyncio.TaskGroup() as tasks:
        for entry in watches.config.robots:
            work = partial(follow_robot, watches, entry, listener)
            tasks.create_task(supervise(f"watch of {entry.name}", work))


async def follow_robot(watches: Watches, entry: Any, listener: Listener) -> None:
    """Watch one robot until cancelled; an unreachable one is looked for again and again.

    The link is left to whoever holds the right to connect to it.
    """
    told = ""
    while True:
        raise_lost_cancellation()
        if not _is_free(watches, entry):
            listener.missed(entry.name, None)
            await asyncio.sleep(_RETRY_S)
            continue
        try:
            async with entry.open() as robot:
                seen = watched(robot.capabilities)
                listener.say(f"{robot.name}: watched every {watches.config.watch.period_s:g} s: {seen}.")
                told = ""
                await _look_while_free(watches, entry, robot, listener)
                continue
        except WrongDeviceError as error:
            listener.missed(entry.name, Condition(Readiness.NOT_READY, error.message, error.remedy))
            if error.message != told:
                told = error.message
                await watches.on_loss(PositionLoss(entry.name, error.message, (), None, wrong_robot()))
        except CellError as error:
            listener.missed(entry.name, Condition(Readiness.UNREACHABLE, error.message, error.remedy))
            if error.message != told:
                listener.say(f"{error}")
                told = error.message
        await asyncio.sleep(_RETRY_S)


def _is_free(watches: Watches, entry: Any) -> bool:
    """Whether nobody else is connected to a robot: a second connection could take the link away from a run."""
    if is_held(leases(watches.config), entry.serial, DEVICES):
        watches.left_to_a_run(entry.name)
        return False
    return True


async def _look_while_free(watches: Watches, entry: Any, robot: Robot, listener: Listener) -> None:
    stops = _Stops(robot.name, listener.say)
    while _is_free(watches, entry):
        if robot.capabilities.writes_mastering:
            watch = watches.of(entry.name, robot)
            if await watch.look() is not None:
                watch.forget_motion()  # a recovery may have moved it
            condition = watch.condition
        else:
            condition = await robot.condition()
            stops.hear(condition)
        if condition.readiness is Readiness.UNREACHABLE:
            raise UnreachableError(
                robot.name, condition.message or "it does not answer.", remedy=condition.remedy
            )
        await listener.looked(robot, condition)
        await asyncio.sleep(watches.config.watch.period_s)


class _Stops:
    """Says each time that a robot stops, or does not stand stopped any more."""

    def __init__(self, robot: str, say: Callable[[str], None]) -> None:
        self._robot, self._say, self._told = robot, say, ""

    def hear(self, condition: Condition) -> None:
        """Take in how the robot is at this look."""
        stopped = condition.readiness is Readiness.STOPPED
        words = f"{self._robot}: {condition.message} {condition.remedy}" if stopped else ""
        if words != self._told:
            self._say(words or f"{self._robot}: neither stopped nor out of reach any more.")
        self._told = words
