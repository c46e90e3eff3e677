"""The state of a Yaskawa controller with one arm: mode, servo power, holds, alarms, one ordered move.

Imitates
    A YRC1000 with one six-axis arm, in command remote unless something happens.
Source
    The maker's status bits and added status codes as three independent clients list them (packets.py).
Modelled
    Modes, holds, servo power, emergency stop, alarms with their history, moves by pulses, tools, byte and
    double variables, home positions that are lost with the encoder battery.
Not modelled
    Jobs, interpolation other than axis by axis, stations that move, a second robot.
"""

import datetime
from collections.abc import Sequence

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.kinematics import Array, invert_pose, matrix_from_xyzwpr
from cellcal.fake_devices.shown_joints import ShownJoints
from cellcal.fake_devices.yaskawa.packets import CommandRefusal

AXES = "SLURBT"
TEACH, PLAY, REMOTE = "TEACH", "PLAY", "REMOTE"
LOST_TEXT = "OUT OF RANGE(ABSO DATA)"
_LOST_CODE = 4107
_ACCELERATION_RAD_S2 = 4.0
_BRAKING_RAD_S2 = 8.0
_TOOLS = ([0.0] * 6, [10.0, -5.0, 180.0, 0.0, 10.0, 0.0], [0.0, 0.0, 95.0, 0.0, 0.0, 30.0])
_MASSES_KG = (0.0, 3.5, 1.25)


class YaskawaController:
    """Everything behind both ports."""

    def __init__(
        self, arm: SimulatedArm, pulses_per_degree: Sequence[float], homes: ShownJoints, title: str
    ) -> None:
        self.jobs: dict[str, bytes] = {}  # by name in capitals
        self.arm, self.title, self.homes = arm, title, homes
        self.home_counts = [-1207, -61118, -60950, 344, 2975, 15502]
        self.pulses_per_rad: Array = np.degrees(np.array(pulses_per_degree, dtype=float))
        self.lost_axes: set[int] = set()
        arm.convert_to_shown = self.shown_joints
        self.mode, self.has_servo_power = REMOTE, True
        self.holds = {"pendant": False, "external": False, "command": False}
        self.emergency_stop = False
        self.is_jogged = False  # the last motion was made at the pendant: no word of the status tells of it
        self.has_second_robot = False
        self.stations: dict[
            int, list[int]
        ] = {}  # pulses of base axes (11) and stations (21, ...) by instance
        self.alarms: list[tuple[int, int, str, str]] = []  # code, data, time, text
        self.history: list[tuple[int, int, str, str]] = []
        self.tool_number, self.user_frame = 1, 0
        self.tools = [list(tool) for tool in _TOOLS]
        self.masses_kg = list(_MASSES_KG)
        self.override_percent = 100
        self.variables: dict[tuple[int, int], bytes] = {}

    # position

    def shown_joints(self, joints_rad: Array) -> Array:
        """Return the joints that the controller computes for true ones."""
        return np.asarray(self._pulses_at(joints_rad) / self.pulses_per_rad)

    def pulses(self) -> tuple[int, ...]:
        """Return the pulses that the controller shows now."""
        return tuple(int(count) for count in self._pulses_at(self.arm.joints_rad))

    def _pulses_at(self, joints_rad: Array) -> Array:
        return np.rint(self.homes.to_shown_joints(joints_rad) * self.pulses_per_rad)

    def base_tip(self) -> Array:
        """Return the pose (4, 4) of the active tool's tip that the controller computes."""
        flange = self.arm.believed_flange(self.shown_joints(self.arm.joints_rad))[0]
        return np.asarray(flange @ matrix_from_xyzwpr(self.tools[self.tool_number]))

    def base_flange(self) -> Array:
        """Return the flange's pose that belongs to ``base_tip``."""
        return np.asarray(self.base_tip() @ invert_pose(matrix_from_xyzwpr(self.tools[self.tool_number])))

    # orders

    def order_move(self, pulses: Sequence[int], share: float) -> None:
        """Begin a move to pulses, each axis at no more than this share of its own largest speed."""
        self._refuse_unless_free()
        shown = np.array(pulses, dtype=float) / self.pulses_per_rad
        target = self.homes.to_true_joints(shown)
        if (shown < self.arm.lower_rad).any() or (shown > self.arm.upper_rad).any():
            raise CommandRefusal(0x1F, 0xB005)  # a position beyond the soft limit
        way = np.abs(target - self.arm.joints_rad)
        longest = float(way.max())
        if longest > 0.0:
            pace = share * self.override_percent / 100.0
            needed_s = float((way / (self.arm.max_speed_rad_s * pace)).max())
            self.is_jogged = False
            self.arm.start_move(target, longest / needed_s, _ACCELERATION_RAD_S2)

    def _refuse_unless_free(self) -> None:
        reasons = (
            (self.mode == TEACH, 0x2080),
            (self.mode != REMOTE, 0x2100),
            (bool(self.alarms), 0x2060),
            (self.holds["pendant"], 0x2020),
            (self.holds["external"], 0x2040),
            (self.holds["command"], 0x2050),
            (not self.has_servo_power, 0x2070),
            (self.arm.is_moving, 0x2010),
        )
        for applies, added in reasons:
            if applies:
                raise CommandRefusal(0x1F, added)

    def order_hold(self, *, on: bool) -> None:
        """Hold by command, or release it. A move that was under way is given up."""
        self.holds["command"] = on
        if on:
            self._brake()

    def order_servo(self, *, on: bool) -> None:
        """Switch the servo power."""
        if on and (self.emergency_stop or self.alarms):
            raise CommandRefusal(0x1F, 0x2060)
        if on and self.mode != REMOTE:
            raise CommandRefusal(0x1F, 0x2100)
        self.has_servo_power = on
        if not on:
            self._brake()

    def reset_alarms(self) -> None:
        """Reset what may be reset: a lost position stays until its axis was confirmed."""
        lost = bool(self.lost_axes)
        self.alarms = [alarm for alarm in self.alarms if lost and alarm[3] == LOST_TEXT]

    def _brake(self) -> None:
        self.arm.stop(_BRAKING_RAD_S2)

    # what happens

    def turn_mode_switch(self, mode: str) -> None:
        """Turn the mode switch; moves of another mode end."""
        if mode != self.mode:
            self._brake()
        self.mode = mode

    def hold_by_hand(self, source: str, *, on: bool) -> None:
        """Press or release HOLD at the pendant, or an external signal."""
        self.holds[source] = on
        if on:
            self._brake()

    def press_emergency_stop(self) -> None:
        """Press the red button: the servo power is gone."""
        self.emergency_stop, self.has_servo_power = True, False
        self._brake()

    def release_emergency_stop(self) -> None:
        """Turn the button back and switch the servo power on at the panel."""
        self.emergency_stop, self.has_servo_power = False, not self.alarms

    def set_override(self, percent: int) -> None:
        """Turn the speed override of the pendant."""
        if not 1 <= percent <= 150:
            raise ValueError("the override is 1 to 150 %")
        self.arm.change_pace(percent / self.override_percent)
        self.override_percent = percent

    def raise_alarm(self, code: int, text: str, data: int = 0) -> None:
        """Raise an alarm; the servo power is gone."""
        stamp = datetime.datetime.now(datetime.UTC).strftime("%Y/%m/%d %H:%M")
        entry = (code, data, stamp, text)
        self.alarms.insert(0, entry)
        self.history.insert(0, entry)
        self.has_servo_power = False
        self._brake()

    def lose_positions(self, axes: Sequence[int]) -> None:
        """Empty the encoder battery over a power-off: these axes come back some motor turns off."""
        self.homes.lose_turns(axes)
        self.lost_axes |= set(axes)
        self.raise_alarm(_LOST_CODE, LOST_TEXT, sum(1 << axis for axis in axes))

    def type_absolute_data(self, axis: int) -> None:
        """Type the absolute data of an axis that stands at its mark: its turns are taken from where it stands."""
        self.homes.update_counter(axis)
        self.lost_axes.discard(axis)

    def make_home(self, axis: int) -> None:
        """Make the home position of an axis where it stands."""
        self.home_counts[axis] += int(self.pulses()[axis])
        self.homes.set_zero(axis)
        self.lost_axes.discard(axis)

    def confirm_positions(self) -> None:
        """Set the absolute data of all axes right at the pendant, from the label in the cabinet."""
        self.homes.mend()
        self.lost_axes.clear()
        self.reset_alarms()

    # files

    def home_file(self) -> str:
        """Return ABSO.DAT: the encoder counts of the home positions, four axes a row."""
        pairs = [f"1,{count}" for count in self.home_counts]
        rows = [",".join(pairs[:4]), ",".join([*pairs[4:], "0,0", "0,0"]), *["0,0,0,0,0,0,0,0"] * 3]
        zeros = ",".join(["0"] * 30)
        return "\r\n".join(["//ABSO", f"///RBPRM 1,63,{zeros},1,0,0", *rows]) + "\r\n"

    def tool_file(self) -> str:
        """Return TOOL.CND."""
        rows: list[str] = []
        for number, (tool, mass) in enumerate(zip(self.tools, self.masses_kg, strict=True)):
            pose = ",".join([f"{value:.3f}" for value in tool[:3]] + [f"{value:.4f}" for value in tool[3:]])
            rows += [f"//TOOL {number}", f"///NAME T{number}", pose, "0.000,0.000,0.000", f"{mass:.3f}"]
            rows += ["0.000,0.000,0.000", "0.000,0,1"]
        return "\r\n".join(rows) + "\r\n"
