"""CELLCAL and CELLCAL_BG in the fake controller: it obeys the text of the two listings that ship.

Imitates
    A FANUC controller that runs them: CELLCAL as a foreground task with group 1, CELLCAL_BG as background logic.
Source
    deploy/controller_setup/fanuc_tp.md and the listings beside it.
Modelled
    Registers R[101] to R[127], flags, the outputs and system variables that the listings read, a task that pauses
    with an emergency stop, outside of AUTO and at an alarm, START and abort by a person, per cent of an axis' speed.
Not modelled
    Registers of others, several tasks, limits of J2 + J3.
"""

import math
from pathlib import Path
from typing import Protocol

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.kinematics import Array
from cellcal.fake_devices.modbus_robot.alarms import ActiveAlarm
from cellcal.fake_devices.modbus_robot.program import HARD_STOP_RAD, HEARTBEAT_S, SETTLE_S, RefusalReason
from cellcal.fake_devices.modbus_robot.words import (
    float_words,
    int32_words,
    words_float,
    words_int32,
)
from cellcal.fake_devices.tp_programs.expressions import TpSyntaxError, Value
from cellcal.fake_devices.tp_programs.listing import read_listing
from cellcal.fake_devices.tp_programs.tasks import ForegroundTask, TaskStatus, run_background

LISTINGS = Path(__file__).resolve().parents[2] / "deploy" / "controller_setup" / "fanuc_programs"
ITP_S = 0.008
_MOST_SCANS = 3000  # of one look; a program that slept longer has seen all that it can see
_PASSING = frozenset(("SRVO-065", "SRVO-075"))  # alarms that do not pause a task
_INTEGERS = (101, 102, 103, 110, 111, 112)
_HOST, _ROBOT = range(101, 113), range(121, 128)
_EMERGENCY, _PENDANT = 1, 512  # bits of $MOR.$SAFETY_STAT
_DECELERATION = 8.0


class TpFirmware(Protocol):
    """The controller's functions that the programs need."""

    arm: SimulatedArm
    override_percent: int
    mode: int
    emergency_stop: bool
    alarms: list[ActiveAlarm]

    @property
    def is_mastered(self) -> bool: ...
    def shown_joints(self) -> Array: ...
    def joint_offset(self) -> Array: ...
    def select_tool(self, number: int) -> None: ...
    def select_frame(self, number: int) -> None: ...
    def report_collision(self, axis: int) -> None: ...


class TpProgram:
    """The two listings, executed; in place of the program of the simulated controller."""

    def __init__(self, firmware: TpFirmware, folder: Path = LISTINGS) -> None:
        self._firmware = firmware
        self._background = read_listing(folder / "CELLCAL_BG.LS")
        self.task = ForegroundTask(read_listing(folder / "CELLCAL.LS"), self)
        self.heartbeat_s = HEARTBEAT_S  # lengthened for slow machines: then each scan takes longer
        self.registers: dict[int, float] = {}
        self.flags: dict[int, bool] = {}
        self._positions: dict[int, Array] = {}
        self._scanned_s = firmware.arm.clock.real_now_s()
        self._begun_s = 0.0
        self._hits: int | None = None
        self.start_program()

    # registers on the wire

    @property
    def host(self) -> list[int]:
        """Return R[101] to R[112] as words."""
        words: list[int] = []
        for number in _HOST:
            value = self.registers.get(number, 0.0)
            words += int32_words([int(value)]) if number in _INTEGERS else float_words([value])
        return words

    def write_host(self, words: list[int], touched: range) -> None:
        """Take what the host wrote; the programs see it in their next cycle."""
        self.catch_up()
        for place, number in enumerate(_HOST):
            pair = words[2 * place : 2 * place + 2]
            if 2 * place in touched:
                self.registers[number] = (
                    float(words_int32(pair)[0]) if number in _INTEGERS else words_float(pair)[0]
                )

    def robot_words(self) -> list[int]:
        """Return R[121] to R[127] as words."""
        self.catch_up()
        return int32_words([int(self.registers.get(number, 0.0)) for number in _ROBOT])

    # running

    def start_program(self) -> None:
        """Press START, as a person does."""
        self.task.start_program()

    def abort_program(self) -> None:
        """Abort the task, as a person does with FCTN."""
        self.task.abort_task()

    def restart_program(self) -> None:
        """Boot: registers are there still, flags are off, background logic runs, the task waits for START."""
        self.task.abort_task()
        self.flags.clear()
        self._hits = None
        self._scanned_s = self._firmware.arm.clock.real_now_s()

    def abort_operation(
        self, reason: RefusalReason, *, at_s: float | None = None, deceleration: float = _DECELERATION
    ) -> None:
        """Pause the task and brake: an emergency stop, or the mode switch. The programs find the reason."""
        del reason
        self.catch_up()
        if self.task.status is TaskStatus.RUNNING:
            self.task.pause_task()
            if self.task.motion is not None:
                self._firmware.arm.stop(deceleration, at_s)

    def change_pace(self, pace: float) -> None:
        """Let a motion under way go on so many times as fast."""
        if self.task.motion is not None and not self.task.skipped and self.task.status is TaskStatus.RUNNING:
            self._firmware.arm.change_pace(pace)

    def catch_up(self) -> None:
        """Run every cycle that has passed."""
        period_s = ITP_S * self.heartbeat_s / HEARTBEAT_S
        now_s = self._firmware.arm.clock.real_now_s()
        self._scanned_s = max(self._scanned_s, now_s - _MOST_SCANS * period_s)
        while self._scanned_s + period_s <= now_s:
            self._scanned_s += period_s
            self._pause_at_alarm()
            run_background(self._background, self)
            self.task.run_lines(self._scanned_s)

    def _pause_at_alarm(self) -> None:
        if self._hits is not None and self.is_at_rest():
            self._firmware.report_collision(self._hits)
            self._hits = None
        if self._has_fault and self.task.status is TaskStatus.RUNNING:
            self.task.pause_task()
            if self.task.motion is not None:
                self._firmware.arm.stop(_DECELERATION)

    @property
    def _has_fault(self) -> bool:
        return any(alarm.code not in _PASSING for alarm in self._firmware.alarms)

    # what the programs read and write

    def read_item(self, kind: str, number: int, element: int) -> Value:
        if kind == "R":
            return self.registers.get(number, 0.0)
        if kind == "F":
            return self.flags.get(number, False)
        if kind == "PR":
            return float(self._positions[number][element - 1])
        outputs: dict[int, Value] = {
            3: self.task.status is TaskStatus.RUNNING,
            4: self.task.status is TaskStatus.PAUSED,
            6: self._has_fault,
            8: self._firmware.mode != 1,
        }
        if number not in outputs:
            raise TpSyntaxError(f"UO[{number}] is not modelled")
        return outputs[number]

    def read_system(self, name: str) -> Value:
        firmware = self._firmware
        if name == "$MOR.$SAFETY_STAT":
            return float(_EMERGENCY * firmware.emergency_stop + _PENDANT * (firmware.mode != 1))
        if name == "$MOR_GRP[1].$ROB_MOVE":
            return firmware.arm.is_moving
        if name == "$DMR_GRP[1].$MASTER_DONE":
            return firmware.is_mastered
        for head, limits in (("LOWER", firmware.arm.lower_rad), ("UPPER", firmware.arm.upper_rad)):
            if name.startswith(f"$PARAM_GROUP[1].${head}LIMS["):
                return round(math.degrees(limits[int(name[-2]) - 1]), 3)
        raise TpSyntaxError(f"{name} is not modelled")

    def write_item(self, kind: str, number: int, element: int, value: Value) -> None:
        if kind == "R":
            self.registers[number] = float(value)
        elif kind == "F":
            self.flags[number] = bool(value)
        elif kind == "PR":
            self._positions[number][element - 1] = float(value)
        elif kind == "UTOOL_NUM":
            self._firmware.select_tool(int(value))
        else:
            self._firmware.select_frame(int(value))

    def store_position(self, number: int) -> None:
        self._positions[number] = np.degrees(self._firmware.shown_joints())

    def start_motion(self, position: int, percent: float) -> None:
        """Move in joints, each axis at most at that share of its speed; a stop at its end ends the motion."""
        firmware, arm = self._firmware, self._firmware.arm
        target = np.radians(self._positions[position]) + firmware.joint_offset()
        if not np.isfinite(target).all():
            self.task.pause_task()  # the controller raises an alarm for such a position
            return
        start = arm.joints_rad
        beyond = np.maximum(
            target - (arm.upper_rad + HARD_STOP_RAD), (arm.lower_rad - HARD_STOP_RAD) - target
        )
        hits = np.flatnonzero(beyond > 0.0)
        way = target - start
        shares = 1.0 - beyond[hits] / np.abs(way[hits]) if hits.size else np.ones(1)
        self._hits = int(hits[int(np.argmin(shares))]) if hits.size else None
        way = way * float(np.clip(shares.min(), 0.0, 1.0))
        longest_s = float(np.max(np.abs(way) / arm.max_speed_rad_s))
        share = percent / 100.0 * max(firmware.override_percent, 1) / 100.0
        speed = float(np.abs(way).max()) / longest_s * share if longest_s > 0.0 else 1.0
        arm.start_move(start + way, speed, max(speed / 0.2, 0.2))
        self._begun_s = arm.clock.now_s()

    def stop_motion(self, at_real_s: float) -> None:
        clock = self._firmware.arm.clock
        when_s = min(max(clock.world_time_at(at_real_s), self._begun_s), clock.now_s())
        self._firmware.arm.stop(_DECELERATION, when_s)

    def is_at_rest(self) -> bool:
        arm = self._firmware.arm
        return not arm.is_moving and arm.clock.now_s() >= arm.settled_at_s + SETTLE_S
