"""The firmware of a six-axis controller whose encoders live on a battery.

Imitates
    A FANUC R-30iA class controller with an M-6iB arm: mastering, pulse coder alarms, power, safety, frames.
Source
    deploy/controller_setup/fanuc_hmi.md; B-83525EN and B-84074EN on BZAL, RES_PCA, "pulse not established"
    and CALIBRATE; 27 public controller backups on $DMR_GRP and INTERACTION.
Modelled
    Joints from counts and the mastering made effective, battery alarm to mastered again step by step, the
    encoder epoch, emergency stop, modes, override, tool and user frames, the handshake program.
Not modelled
    Other motion groups, user programs, collision detection by motor torque, quick mastering from the
    pendant, configuration bits beyond FLIP and FRONT.
"""

from collections.abc import Callable

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.device import FaultRefusedError
from cellcal.fake_devices.encoders import PulseCoders
from cellcal.fake_devices.kinematics import Array, invert_pose, matrix_from_xyzwpr, wpr_from_matrix
from cellcal.fake_devices.modbus_robot.alarms import CODES, ActiveAlarm
from cellcal.fake_devices.modbus_robot.program import CellcalProgram, ProgramRefusalError, RefusalReason
from cellcal.fake_devices.modbus_robot.tp_program import TpProgram

AUTO, T1, T2 = 1, 2, 3
_UNTIL_POWER_CYCLE = frozenset(f"SRVO-0{n}" for n in (38, 62, 64, 68, 69, 70, 71, 72, 73, 74))
TOOLS, FRAMES = 10, 9
FIRST_TOOL = (12.5, -3.0, 118.0, 0.0, -15.0, 30.0)


class ModbusRobotController:
    """The programs and values of the cabinet. Computed on request; ``catch_up`` catches up with time."""

    def __init__(
        self,
        arm: SimulatedArm,
        coders: PulseCoders,
        serial: str,
        model_title: str,
        *,
        runs_listings: bool = False,
    ) -> None:
        self.arm, self.coders = arm, coders
        self.serial, self.model_title = serial, model_title
        self.version = "V7.70P/42" if runs_listings else "V7.70P/42 (simulated)"
        self.powered = True
        self.on_power: Callable[[], None] = lambda: None
        self.battery_dead_axes: frozenset[int] = frozenset()
        self.emergency_stop, self.mode, self.override_percent = False, AUTO, 100
        self.counts_at_zero = tuple(int(count) for count in coders.factory_counts_at_zero)
        self._effective = self.counts_at_zero
        self.master_done, self.calibrated = True, True
        self.reference_counts = (0,) * len(self.counts_at_zero)
        self.reference_rad = (0.0,) * len(self.counts_at_zero)
        self.reference_done = False
        self.reset_pending = False
        self.epoch = 1
        self.refused_axes: frozenset[int] = frozenset()
        self.alarms: list[ActiveAlarm] = []
        self.tools = [list(FIRST_TOOL), *([0.0] * 6 for _ in range(TOOLS - 1))]
        self.frames = [[0.0] * 6 for _ in range(FRAMES)]
        self.tool_number, self.frame_number = 1, 0
        self.external = [0.0, 0.0, 0.0]  # E1 to E3 [mm or deg]
        self.second_group: list[float] | None = None  # J1 to J9 of group 2, where there is one
        arm.convert_to_shown = lambda joints: joints - self.joint_offset()
        self.program: CellcalProgram | TpProgram = TpProgram(self) if runs_listings else CellcalProgram(self)

    # position

    @property
    def is_mastered(self) -> bool:
        """Whether positions mean anything: mastered, and the mastering made effective."""
        return self.master_done and self.calibrated

    def catch_up(self) -> None:
        """Catch up with the clock."""
        self.program.catch_up()
        self.coders.look_for_index()

    def shown_joints(self) -> Array:
        """Return the joints that the controller shows [rad]."""
        return self.coders.joints_from_counts(self._effective)

    def joint_offset(self) -> Array:
        """Return true joints minus shown joints [rad]."""
        return self.coders.offset_rad(self._effective)

    def true_offset_rad(self, counts_at_zero: tuple[int, ...] | None = None) -> Array:
        """Return true minus commanded joints under a mastering; by default the one in MASTER_COUN."""
        return self.coders.offset_rad(counts_at_zero or self.counts_at_zero)

    def user_tip(self) -> tuple[float, ...]:
        """Return X Y Z [mm] W P R [deg] of the active tool in the active user frame."""
        user = matrix_from_xyzwpr(self.frames[self.frame_number - 1]) if self.frame_number else np.eye(4)
        tool = matrix_from_xyzwpr(self.tools[self.tool_number - 1])
        pose = invert_pose(user) @ self.arm.believed_flange(self.shown_joints())[0] @ tool
        x, y, z = (float(value) * 1e3 for value in pose[:3, 3])
        return (x, y, z, *wpr_from_matrix(pose[:3, :3]))

    # mastering

    def write_counts_at_zero(self, counts: tuple[int, ...]) -> None:
        """Take MASTER_COUN; it becomes effective with CALIBRATE or a power cycle."""
        self.counts_at_zero = tuple(
            old if axis in self.refused_axes else new
            for axis, (old, new) in enumerate(zip(self.counts_at_zero, counts, strict=True))
        )

    def write_master_done(self, value: int) -> None:
        """Take $MASTER_DONE; the positions stay as they were until CALIBRATE."""
        self.master_done = value == 1

    def forget_mastering(self) -> None:
        """Lose MASTER_COUN with the rest of the memory; the pulse coders keep their counts."""
        self.catch_up()
        self.counts_at_zero = self._effective = (0,) * len(self.counts_at_zero)
        self.master_done = self.calibrated = False

    def calibrate_joints(self) -> None:
        """Compute the joints from counts and MASTER_COUN."""
        self.catch_up()
        if self.coders.lost.any():
            raise ProgramRefusalError(RefusalReason.ALARM_ACTIVE)
        if not self.coders.established.all():
            raise ProgramRefusalError(RefusalReason.PULSE_NOT_ESTABLISHED)
        self._effective = self.counts_at_zero
        self.master_done = self.calibrated = True

    def request_reset(self, value: int) -> None:
        """Take $MCR.$SPC_RESET: with a good battery the next power cycle leaves the battery alarm."""
        self.reset_pending = self.reset_pending or value == 1

    # alarms

    def active_alarms(self) -> list[ActiveAlarm]:
        """Return the alarm page, newest first."""
        self.catch_up()
        return list(self.alarms)

    def raise_alarm(self, code: str, axis: int | None = None) -> None:
        """Put a line on the alarm page, once."""
        if code not in CODES:
            raise FaultRefusedError(f"no alarm {code!r}; there are {', '.join(sorted(CODES))}")
        if all((alarm.code, alarm.axis) != (code, axis) for alarm in self.alarms):
            self.alarms.insert(0, ActiveAlarm(code, axis, self.arm.clock.now_s()))

    def report_collision(self, axis: int) -> None:
        """Report that an axis has hit its stop."""
        self.raise_alarm("SRVO-050", axis)

    def reset_alarms(self) -> None:
        """Clear what can be cleared; refuse with the reason for what cannot."""
        self.catch_up()
        unestablished = not self.coders.established.all()
        self.alarms = [alarm for alarm in self.alarms if self._is_persistent(alarm, unestablished)]
        if any(alarm.code in _UNTIL_POWER_CYCLE for alarm in self.alarms):
            raise ProgramRefusalError(
                RefusalReason.POWER_CYCLE_NEEDED if self.reset_pending else RefusalReason.ALARM_ACTIVE
            )
        if any(alarm.code == "SRVO-001" for alarm in self.alarms):
            raise ProgramRefusalError(RefusalReason.EMERGENCY_STOP)
        if any(alarm.code == "SRVO-075" for alarm in self.alarms):
            raise ProgramRefusalError(RefusalReason.PULSE_NOT_ESTABLISHED)

    def _is_persistent(self, alarm: ActiveAlarm, unestablished: bool) -> bool:
        stays = {
            "SRVO-001": self.emergency_stop,
            "SRVO-065": bool(self.battery_dead_axes),
            "SRVO-075": unestablished,
        }
        return alarm.code in _UNTIL_POWER_CYCLE or stays.get(alarm.code, False)

    # motion permission

    def check_may_move(self) -> None:
        """Refuse with the first reason that stands against any motion."""
        self.catch_up()
        if self.emergency_stop:
            raise ProgramRefusalError(RefusalReason.EMERGENCY_STOP)
        if self.mode != AUTO:
            raise ProgramRefusalError(RefusalReason.NOT_AUTO)
        if any(alarm.code not in ("SRVO-075", "SRVO-065") for alarm in self.alarms):
            raise ProgramRefusalError(
                RefusalReason.POWER_CYCLE_NEEDED if self.reset_pending else RefusalReason.ALARM_ACTIVE
            )

    def press_emergency_stop(self) -> None:
        """Stop at once; SRVO-001 stays until released and reset."""
        self.catch_up()
        self.emergency_stop = True
        self.raise_alarm("SRVO-001")
        self.program.abort_operation(RefusalReason.EMERGENCY_STOP, deceleration=15.0)
        self.arm.stop(15.0)

    def release_emergency_stop(self) -> None:
        """Pull the button out; the alarm still wants a reset."""
        self.emergency_stop = False

    def turn_mode_switch(self, mode: int) -> None:
        """Change AUTO, T1, T2; leaving AUTO stops what runs."""
        self.catch_up()
        self.mode = mode
        if mode != AUTO:
            self.program.abort_operation(RefusalReason.NOT_AUTO)

    def set_override(self, percent: int) -> None:
        """Take $GENOVERRIDE: 1 to 100, others are clipped as on the pendant; a motion under way follows it."""
        self.catch_up()
        before, self.override_percent = self.override_percent, min(max(percent, 1), 100)
        self.program.change_pace(self.override_percent / before)

    def select_tool(self, number: int) -> None:
        """Make a tool the active one."""
        if not 1 <= number <= TOOLS:
            raise ProgramRefusalError(RefusalReason.BAD_NUMBER)
        self.tool_number = number

    def select_frame(self, number: int) -> None:
        """Make a user frame the active one; 0 is the base."""
        if not 0 <= number <= FRAMES:
            raise ProgramRefusalError(RefusalReason.BAD_NUMBER)
        self.frame_number = number

    # power

    def switch_off(self) -> None:
        """Cut the mains: the arm brakes, a dead battery forgets, every connection drops."""
        if not self.powered:
            return
        self.catch_up()
        self.arm.put_joints(self.arm.joints_rad)
        self.powered = False
        if self.battery_dead_axes:
            self.coders.lose_turns(sorted(self.battery_dead_axes))
        self.on_power()

    def switch_on(self) -> None:
        """Boot: positions come from the counts, or an alarm says why they cannot."""
        if self.powered:
            return
        self.powered = True
        remaining = [alarm for alarm in self.alarms if alarm.code in ("SRVO-001", "SRVO-065")]
        self.alarms = [alarm for alarm in remaining if self._is_persistent(alarm, unestablished=False)]
        if self.reset_pending and not self.battery_dead_axes:
            self.coders.acknowledge_alarm()
        self.reset_pending = False
        self.program.restart_program()
        self._raise_position_alarms()
        self._effective = self.counts_at_zero
        self.on_power()

    def _raise_position_alarms(self) -> None:
        for axis in np.flatnonzero(self.coders.lost)[::-1]:
            self.raise_alarm("SRVO-062", int(axis))
        for axis in np.flatnonzero(~self.coders.established & ~self.coders.lost)[::-1]:
            self.raise_alarm("SRVO-075", int(axis))
        if not self.coders.established.all():
            self.epoch += 1
            self.master_done = self.calibrated = False
        self.calibrated = self.master_done
