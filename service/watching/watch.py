"""Follows the robots and sees an encoder loss by itself.

Three independent witnesses, each enough: the controller's own words, the encoder epoch, and counts that jump
further between two looks than the arm could have moved; a robot that tells no counts has the first one only.
A fourth sees what raises no alarm: mastering data that are not the newest record's. A battery that is low is told
before it is empty. The last healthy counts are kept on disk: after a loss they tell to within a few turns where each
motor stood.
"""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Protocol, cast

import numpy as np

from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, WireProtocolError
from cellcal.drivers.interfaces import (
    Alarm,
    Condition,
    Counts,
    PositionCure,
    Readiness,
    ReadsEncoderCounts,
    ReadsMastering,
    Robot,
)
from cellcal.drivers.supervision import raise_lost_cancellation
from cellcal.service.record.healthy_counts import HealthyCounts, LastHealthyCounts
from cellcal.service.watching.loss_modes import (
    LossKind,
    LossMode,
    Suspicion,
    battery_warning,
    is_position_doubtful,
    suspect_loss,
    turns_lost,
    with_zero_set_anew,
)

_LOG = logging.getLogger(__name__)
_LOOK_AT_LINK = (
    "Look at the network between, and whether something else answers at its address; it is looked at again."
)
_JUMP_SPEED_RAD_S = 6.0  # no industrial joint turns faster; a quicker change of counts is not motion


class ZeroComparison(Protocol):
    """Compares the zero that a controller holds with the one of its record."""

    def force_check(self) -> None: ...
    def note_loss(self, robot: str, condition: Condition, /) -> None: ...
    async def find_trouble(self, robot: Any, /) -> tuple[str, Suspicion] | None: ...


@dataclass(frozen=True, slots=True)
class PositionLoss:
    """A loss that the watch saw, in words for the technician, and what it knew before."""

    robot: str
    detected_by: str
    alarms: tuple[Alarm, ...]
    last_healthy: HealthyCounts | None
    suspicion: Suspicion = field(default_factory=lambda: suspect_loss(()))
    follows_another: bool = False  # something was reported before it, and that was not cleared yet
    during_run: bool = False  # the robot was not seen healthy since a run had it


class RobotWatch:
    """Looks at one robot again and again; calls ``on_loss`` once for each loss it sees.

    It outlives a connection (`meet`): a robot that is switched off and mended is the one that was reported before.
    """

    def __init__(
        self,
        robot: Robot,
        memory: LastHealthyCounts,
        on_loss: Callable[[PositionLoss], Awaitable[None]],
        *,
        period_s: float,
        warn: Callable[[str], None] = _LOG.warning,
        comparison: ZeroComparison | None = None,
    ) -> None:
        self._robot, self._memory, self._on_loss, self._period_s = robot, memory, on_loss, period_s
        self._warn, self._warned, self.comparison = warn, "", comparison
        self._last_observation: tuple[float, Counts] | None = None
        self._saved: HealthyCounts | None = memory.load_counts(robot.name)
        self._drive: DriveTrain | None = None
        self._disk = ""  # what was wrong when the counts were to be kept
        self._reported: PositionLoss | None = None
        self._after_run = False
        self.condition = Condition(Readiness.UNREACHABLE)  # as it was at the last look

    async def watch_forever(self) -> None:
        """Watch until cancelled. An unreachable robot is no loss: it is looked for again."""
        while True:
            raise_lost_cancellation()
            try:
                await self.look_once()
            except DeviceError as error:
                self._last_observation = None
                _LOG.info("watch: %s", error)
            await asyncio.sleep(self._period_s)

    async def look_once(self) -> PositionLoss | None:
        """Look once; return the loss if this look found a new one."""
        self._saved = self._memory.load_counts(self._robot.name) or self._saved  # a run may have renewed it
        condition = self.condition = await self._read_confirmed_condition()
        if condition.readiness is Readiness.UNREACHABLE:
            self._last_observation = None
            return None
        self._warn_once(battery_warning(self._robot.capabilities, condition))
        detected_by = None
        self._note_loss(condition)
        if _tells_of_loss(condition):
            detected_by = make_message(
                "the controller reports: {condition_message}", condition_message=condition.message
            )
        else:
            detected_by = await self._find_trouble()
        suspicion = _suspect_condition(condition)
        if detected_by is None and self.comparison is not None:
            trouble = await self.comparison.find_trouble(self._robot)
            detected_by, suspicion = trouble or (None, suspicion)
        if detected_by is None:
            self._reported, self._after_run = None, False
            return None
        alarms, before = condition.alarms, self._reported
        if before is not None:
            if suspicion.loss_kind is not LossKind.LOST or before.suspicion.loss_kind is LossKind.LOST:
                return None
            alarms = (*before.alarms, *alarms)  # an encoder that failed first may have been exchanged since
            graver = suspect_loss(alarms)
            suspicion = suspicion if graver.mode is LossMode.MEMORY else graver
        if self._robot.capabilities.position_cure is PositionCure.MASTERING_GAUGE:
            suspicion = with_zero_set_anew(suspicion)
        loss = PositionLoss(
            self._robot.name, detected_by, alarms, self._saved, suspicion,
            follows_another=before is not None, during_run=self._after_run,
        )  # fmt: skip
        self._reported = loss
        await self._on_loss(loss)
        return loss

    async def _read_confirmed_condition(self) -> Condition:
        """Read how the robot is; a loss is asked for twice before it counts: one damaged answer is none.

        Raises
        ------
        WireProtocolError
            The second answer tells of no loss.
        """
        condition = await self._robot.read_condition()
        if self._reported is not None or not _tells_of_loss(condition):
            return condition
        again = await self._robot.read_condition()
        if _tells_of_loss(again) or again.readiness is Readiness.UNREACHABLE:
            return again
        raise WireProtocolError(
            self._robot.name,
            make_message(
                "it reported a lost position ({condition_message}), and asked again at once none.",
                condition_message=condition.message,
            ),
            remedy=_LOOK_AT_LINK,
        )

    def _note_loss(self, condition: Condition) -> None:
        if condition.readiness is Readiness.POSITION_LOST and self.comparison is not None:
            self.comparison.note_loss(self._robot.name, condition)

    def _warn_once(self, words: str) -> None:
        if words and words != self._warned:
            self._warn(f"{self._robot.name}: {words}")
        self._warned = words

    def use_connection(self, robot: Robot) -> None:
        """Go on with the same robot over another connection."""
        if robot is not self._robot:
            self._robot, self._last_observation, self._drive = robot, None, None
            if self.comparison is not None:
                self.comparison.force_check()

    async def is_resolved(self) -> bool:
        """Whether the last look found nothing wrong, and the controller holds a mastering."""
        if self.is_still_lost or self.condition.alarms or self.condition.readiness is Readiness.UNREACHABLE:
            return False
        if not self._robot.capabilities.reads_mastering:
            return True  # its mastering cannot be read
        return (await cast(ReadsMastering, self._robot).read_mastering()).mastered

    @property
    def is_still_lost(self) -> bool:
        """Whether what was reported last was still so at the last look."""
        return self._reported is not None

    def forget_motion(self) -> None:
        """Do not compare the next look with the last: a run has the robot, and may move it on command."""
        self._last_observation, self._after_run = None, True
        if self.comparison is not None:
            self.comparison.force_check()

    async def _find_trouble(self) -> str | None:
        """Compare with what was seen before; remember this look when all is well."""
        if not self._robot.capabilities.reads_encoder_counts:
            return None  # its own words are the only witness
        counts, epoch, now_s = await self._read_encoders()
        trouble = await self._compare_encoders(counts, epoch, now_s)
        if trouble is not None or self._last_observation is None:
            await self._confirm_encoders(counts, epoch, now_s)
        if trouble is not None:
            return trouble
        self._last_observation = (now_s, counts)
        self._save_healthy(counts, epoch)
        return None

    async def _read_encoders(self) -> tuple[Counts, int, float]:
        encoders = cast(ReadsEncoderCounts, self._robot)
        return await encoders.encoder_counts(), await encoders.encoder_epoch(), time.monotonic()

    async def _compare_encoders(self, counts: Counts, epoch: int, now_s: float) -> str | None:
        if self._saved is not None and epoch != self._saved.epoch:
            return "the encoder epoch changed: the controller started after a lost position"
        if self._last_observation is None:
            return None
        then_s, before = self._last_observation
        moved_rad = await self._moved_rad(before, counts)
        if float(moved_rad.max()) <= _reach_rad(now_s - then_s):
            return None
        axis = int(moved_rad.argmax())
        return make_message(
            "the count of axis {axis} jumped by {jump_deg:.1f} deg without motion",
            axis=self._robot.capabilities.axis_name(axis),
            jump_deg=np.rad2deg(moved_rad[axis]),
        )

    async def _confirm_encoders(self, counts: Counts, epoch: int, now_s: float) -> None:
        """Read once more before counts are kept anew or a loss is told: one damaged answer is neither.

        Raises
        ------
        WireProtocolError
            The two readings are not of one arm.
        """
        again, epoch_again, again_s = await self._read_encoders()
        moved_rad = await self._moved_rad(counts, again)
        if epoch_again == epoch and float(moved_rad.max()) <= _reach_rad(again_s - now_s):
            return
        raise WireProtocolError(
            self._robot.name,
            "two readings of its encoders, one right after the other, contradict each other.",
            remedy=_LOOK_AT_LINK,
        )

    async def _moved_rad(self, before: Counts, counts: Counts) -> np.ndarray:
        if len(before) != len(counts):
            raise WireProtocolError(
                self._robot.name,
                make_message(
                    "it told {before_count} encoder counts, and then {count_count}.",
                    before_count=len(before),
                    count_count=len(counts),
                ),
                remedy=_LOOK_AT_LINK,
            )
        return np.abs((await self._drive_train()).to_joints(np.array(counts), np.array(before)))

    def _save_healthy(self, counts: Counts, epoch: int) -> None:
        moved = self._saved is None or self._saved.counts != counts or self._saved.epoch != epoch
        if not moved:
            return
        self._saved = HealthyCounts(self._robot.name, counts, epoch, datetime.now(UTC).isoformat())
        try:
            self._memory.save_counts(self._saved)
            self._disk = ""
        except OSError as error:  # the eyes on the encoders matter more than the disk
            reason = error.strerror or str(error)  # without the name of the draft, which is another each time
            if self._disk != reason:
                self._warn(
                    make_message(
                        "{robot}: its healthy counts cannot be kept: {reason}. See that the disk may be written and "
                        "has room.",
                        robot=self._robot.name,
                        reason=reason,
                    )
                )
            self._disk = reason

    async def _drive_train(self) -> DriveTrain:
        if self._drive is None:
            self._drive = await cast(ReadsEncoderCounts, self._robot).drive_train()
        return self._drive


def _tells_of_loss(condition: Condition) -> bool:
    return condition.readiness is Readiness.POSITION_LOST or is_position_doubtful(condition)


def _reach_rad(span_s: float) -> float:
    return _JUMP_SPEED_RAD_S * (span_s + 0.2)


def _suspect_condition(condition: Condition) -> Suspicion:
    """Return what the alarms suggest; a jump or a new epoch without any is a loss of turns."""
    if condition.readiness is Readiness.POSITION_LOST:
        return suspect_loss(condition.alarms)
    if is_position_doubtful(condition):
        return suspect_loss(condition.alarms, position_lost=False)
    return turns_lost(condition.alarms)
