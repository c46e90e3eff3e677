"""The background program CELLCAL: one request at a time, through registers.

Imitates
    Our own handshake program on the controller.
Source
    deploy/controller_setup/fanuc_hmi.md, "The handshake program".
Modelled
    All six operations, every refusal, hold, the host's heartbeat, override, hard stops at the end of an axis.
Not modelled
    Programs of the user beside it. The program's cycle is continuous: it sees a telegram when it arrives.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.kinematics import Array
from cellcal.fake_devices.modbus_robot.words import int32_words, words_float, words_int32

HEARTBEAT_S = 0.5
CYCLE_S = 0.01
SETTLE_S = 0.05
UNMASTERED_SPEED_RAD_S = float(np.radians(5.0))
HARD_STOP_RAD = float(np.radians(8.0))
_HOST_WORDS, _ROBOT_WORDS = 24, 14
_ROUNDING_RAD = 1e-5  # a limit commanded in single-precision degrees is still the limit


class RequestState(IntEnum):
    """R[122]."""

    IDLE = 0
    RUNNING = 1
    DONE = 2
    REFUSED = 3
    STOPPED = 4


class RefusalReason(IntEnum):
    """R[123]."""

    NONE = 0
    NOT_MASTERED = 1
    PULSE_NOT_ESTABLISHED = 2
    AXIS_LIMIT = 3
    BUSY = 4
    BAD_NUMBER = 5
    ALARM_ACTIVE = 6
    HEARTBEAT_MISSING = 7
    HOST_STOP = 8
    EMERGENCY_STOP = 9
    NOT_AUTO = 10
    POWER_CYCLE_NEEDED = 11
    BAD_OPERATION = 12


class ProgramRefusalError(Exception):
    """The program does not obey; the reason goes to R[123]."""

    def __init__(self, reason: RefusalReason) -> None:
        super().__init__(reason.name)
        self.reason = reason


class Firmware(Protocol):
    """The controller's functions that the program needs."""

    arm: SimulatedArm
    override_percent: int
    mode: int
    emergency_stop: bool

    @property
    def is_mastered(self) -> bool: ...
    def shown_joints(self) -> Array: ...
    def joint_offset(self) -> Array: ...
    def check_may_move(self) -> None: ...
    def calibrate_joints(self) -> None: ...
    def reset_alarms(self) -> None: ...
    def select_tool(self, number: int) -> None: ...
    def select_frame(self, number: int) -> None: ...
    def report_collision(self, axis: int) -> None: ...


@dataclass
class CellcalProgram:
    """State of CELLCAL; ``catch_up`` brings it up to the clock."""

    firmware: Firmware
    host: list[int] = field(default_factory=lambda: [0] * _HOST_WORDS)
    accepted: int = 0
    state: RequestState = RequestState.IDLE
    reason: RefusalReason = RefusalReason.NONE
    heartbeat_ignored: bool = False
    heartbeat_s: float = HEARTBEAT_S  # of real time, after which a move without one is stopped
    _running: bool = False
    _reported: bool = True
    _heartbeat_real_s: float = 0.0
    _begun_s: float = 0.0
    _stopping: RefusalReason = RefusalReason.NONE
    _hits: int | None = None

    # registers

    def robot_words(self) -> list[int]:
        """Return R[121] to R[127]."""
        self.catch_up()
        firmware = self.firmware
        counter = int(firmware.arm.clock.real_now_s() / CYCLE_S) & 0x7FFFFFFF
        words = int32_words([
            self.accepted, self.state, self.reason, int(firmware.arm.is_moving),
            firmware.mode, int(firmware.emergency_stop), counter,
        ])  # fmt: skip
        return words[:_ROBOT_WORDS]

    def write_host(self, words: list[int], touched: range) -> None:
        """Take R[101] to R[112]; the request number counts last, wherever it stands in the telegram."""
        self.catch_up()
        before, self.host = self.host, list(words)
        if words[22:24] != before[22:24]:
            self._heartbeat_real_s = self.firmware.arm.clock.real_now_s()
        if self._int_argument(20) == 1:
            self.abort_operation(RefusalReason.HOST_STOP)
        if touched.start < 2 and self._int_argument(0) != self.accepted:
            self._start_request(self._int_argument(0))

    def _int_argument(self, offset: int) -> int:
        return words_int32(self.host[offset : offset + 2])[0]

    def _float_arguments(self, offset: int, values: int) -> list[float]:
        return words_float(self.host[offset : offset + 2 * values])

    # running

    def restart_program(self) -> None:
        """Begin anew after a power cycle: nothing accepted, nothing under way."""
        self.accepted, self.state, self.reason = 0, RequestState.IDLE, RefusalReason.NONE
        self._stopping, self._hits, self._running = RefusalReason.NONE, None, False
        self.host = [0] * _HOST_WORDS

    def catch_up(self) -> None:
        """Notice what has happened since: heartbeat gone, target reached, standstill, hard stop."""
        if not self._running:
            return
        arm = self.firmware.arm
        if self._stopping is RefusalReason.NONE and arm.is_moving:
            self._check_heartbeat()
        if arm.is_moving or arm.clock.now_s() < arm.settled_at_s + SETTLE_S:
            return
        if self._stopping is RefusalReason.NONE and self._hits is not None:
            self.firmware.report_collision(self._hits)
            self._stopping = RefusalReason.ALARM_ACTIVE
        self._running = False
        if self._reported:
            self.state = RequestState.DONE if self._stopping is RefusalReason.NONE else RequestState.STOPPED
            self.reason = self._stopping
        self._stopping, self._hits = RefusalReason.NONE, None

    def _check_heartbeat(self) -> None:
        clock = self.firmware.arm.clock
        due_s = self._heartbeat_real_s + self.heartbeat_s
        if clock.real_now_s() > due_s and not self.heartbeat_ignored:
            self.abort_operation(
                RefusalReason.HEARTBEAT_MISSING,
                at_s=min(max(clock.world_time_at(due_s), self._begun_s), clock.now_s()),
            )

    def change_pace(self, pace: float) -> None:
        """Let the operation that runs go on so many times as fast; braking keeps its own time."""
        if self._running and self._stopping is RefusalReason.NONE:
            self.firmware.arm.change_pace(pace)

    def abort_operation(
        self, reason: RefusalReason, *, at_s: float | None = None, deceleration: float = 8.0
    ) -> None:
        """Brake, and report the operation as stopped once the arm stands."""
        if self._running and self._stopping is RefusalReason.NONE:
            self.firmware.arm.stop(deceleration, at_s)
            self._stopping = reason

    def _start_request(self, number: int) -> None:
        self.accepted = number
        try:
            if self._running:  # the running operation goes on, but R[122] has to answer the newcomer
                self._reported = False
                raise ProgramRefusalError(RefusalReason.BUSY)
            if self._int_argument(20) == 1:
                raise ProgramRefusalError(RefusalReason.HOST_STOP)
            self._start_operation()
        except ProgramRefusalError as refused:
            self.state, self.reason = RequestState.REFUSED, refused.reason

    def _start_operation(self) -> None:
        operation, number = self._int_argument(2), self._int_argument(4)
        at_once: dict[int, Callable[[], None]] = {
            3: self.firmware.calibrate_joints,
            4: self.firmware.reset_alarms,
            5: lambda: self.firmware.select_tool(number),
            6: lambda: self.firmware.select_frame(number),
        }
        if operation == 1:
            self._joint_move()
        elif operation == 2:
            self._jog_axis(number)
        elif operation in at_once:
            at_once[operation]()
            self.state, self.reason = RequestState.DONE, RefusalReason.NONE
        else:
            raise ProgramRefusalError(RefusalReason.BAD_OPERATION)

    def _joint_move(self) -> None:
        firmware = self.firmware
        firmware.check_may_move()
        if not firmware.is_mastered:
            raise ProgramRefusalError(RefusalReason.NOT_MASTERED)
        target = np.radians(self._float_arguments(6, 6))
        self._check_limits(target)
        self._move_true_joints(target + firmware.joint_offset(), self._speed_argument())

    def _jog_axis(self, axis_number: int) -> None:
        firmware = self.firmware
        firmware.check_may_move()
        amount = float(np.radians(self._float_arguments(6, 1)[0]))
        if not 1 <= axis_number <= 6 or not np.isfinite(amount):
            raise ProgramRefusalError(RefusalReason.BAD_NUMBER)
        step = np.zeros(6)
        step[axis_number - 1] = amount
        speed = self._speed_argument()
        if firmware.is_mastered:
            self._check_limits(firmware.shown_joints() + step)
        else:
            speed = min(speed, UNMASTERED_SPEED_RAD_S)
        self._move_true_joints(firmware.arm.joints_rad + step, speed)

    def _speed_argument(self) -> float:
        speed = float(np.radians(self._float_arguments(18, 1)[0]))
        if not np.isfinite(speed) or speed <= 0.0:
            raise ProgramRefusalError(RefusalReason.BAD_NUMBER)
        return speed * max(self.firmware.override_percent, 1) / 100.0

    def _check_limits(self, target: Array) -> None:
        if not np.isfinite(target).all():
            raise ProgramRefusalError(RefusalReason.BAD_NUMBER)
        arm = self.firmware.arm
        if (target < arm.lower_rad - _ROUNDING_RAD).any() or (target > arm.upper_rad + _ROUNDING_RAD).any():
            raise ProgramRefusalError(RefusalReason.AXIS_LIMIT)

    def _move_true_joints(self, target: Array, speed: float) -> None:
        """Move in true joints. An axis that runs into its stop ends the whole motion there."""
        arm = self.firmware.arm
        start = arm.joints_rad
        way = target - start
        beyond = np.maximum(
            target - (arm.upper_rad + HARD_STOP_RAD), (arm.lower_rad - HARD_STOP_RAD) - target
        )
        hits = np.flatnonzero(beyond > 0.0)
        shares = 1.0 - beyond[hits] / np.abs(way[hits]) if hits.size else np.ones(1)
        share = float(np.clip(shares.min(), 0.0, 1.0))
        self._hits = int(hits[int(np.argmin(shares))]) if hits.size else None
        longest = float(np.abs(way).max())
        if longest > 0.0:
            speed = min(speed, float(np.min(arm.max_speed_rad_s / np.maximum(np.abs(way) / longest, 1e-9))))
        arm.start_move(start + share * way, speed, max(speed / 0.2, 0.2))
        self._heartbeat_real_s, self._begun_s = arm.clock.real_now_s(), arm.clock.now_s()
        self.state, self.reason, self._stopping = RequestState.RUNNING, RefusalReason.NONE, RefusalReason.NONE
        self._running = self._reported = True
