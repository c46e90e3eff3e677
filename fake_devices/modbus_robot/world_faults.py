"""What people, batteries and accidents do to the Modbus robot, by name.

Imitates
    A shop floor: a forgotten battery, a new motor, a collision, a hand on the pendant, the mains switch.
Source
    Loss modes M0 to M5 of the design's mastering page; rows F38-F46, F53 of its fault table.
Modelled
    The faults of ``WorldFaults.fault_names``. Random values come from the world's seed and the loss's number.
Not modelled
    Slow wear: gears, belts, bearings.
"""

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from cellcal.fake_devices.arm_models import COUNTS_PER_TURN
from cellcal.fake_devices.device import FaultRefusedError, JsonObject
from cellcal.fake_devices.modbus_robot.controller import AUTO, T1, T2, TOOLS, ModbusRobotController
from cellcal.fake_devices.modbus_robot.program import ProgramRefusalError
from cellcal.fake_devices.modbus_robot.tp_program import TpProgram
from cellcal.fake_devices.world import World

OFF_S = 5.0
_EVERY_AXIS = "all"


class WorldFaults:
    """Named happenings around one controller."""

    def __init__(self, world: World, controller: ModbusRobotController) -> None:
        self._world, self._controller = world, controller
        self._losses = 0
        self._boot_at_s: float | None = None
        self._fault_actions: dict[str, Callable[[dict[str, Any]], JsonObject | None]] = {
            "battery_loss": self._battery_loss,
            "motor_exchange": self._motor_exchange,
            "reference_loss": self._reference_loss,
            "crash": self._crash_arm,
            "memory_loss": self._memory_loss,
            "old_backup": self._old_backup,
            "swapped_arm": self._swapped_arm,
            "new_battery": self._new_battery,
            "battery_low": self._battery_low,
            "alarm": self._raise_alarm,
            "power_off": self._power_off,
            "power_on": self._power_on,
            "power_cycle": self._power_cycle,
            "emergency_stop": lambda _parameters: self._controller.press_emergency_stop(),
            "release_emergency_stop": lambda _parameters: self._controller.release_emergency_stop(),
            "auto_mode": lambda _parameters: self._controller.turn_mode_switch(AUTO),
            "t1_mode": lambda _parameters: self._controller.turn_mode_switch(T1),
            "t2_mode": lambda _parameters: self._controller.turn_mode_switch(T2),
            "override": self._set_override,
            "jog_by_hand": self._jog_by_hand,
            "hand_moves": self._hand_moves,
            "bring_tip": lambda parameters: self._bring_tool(parameters, seated=False),
            "bring_to_seat": lambda parameters: self._bring_tool(parameters, seated=True),
            "press_reset": self._press_reset,
            "acknowledge_lost_position": self._acknowledge_lost_position,
            "type_mastering": self._type_mastering,
            "partial_write": self._partial_write,
            "select": self._select_at_pendant,
            "tool_switched": self._tool_switched,
            "external_moved": self._move_external_axis,
            "early_stop": self._early_stop,
            "start_program": self._start_program,
            "abort_program": self._abort_program,
        }

    def fault_names(self) -> frozenset[str]:
        """Return all happenings."""
        return frozenset(self._fault_actions)

    def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        """Let it happen; parameters that it does not know are refused."""
        remaining = dict(parameters)
        try:
            answer = self._fault_actions[name](remaining) or {}
        except ProgramRefusalError as refused:
            raise FaultRefusedError(f"the controller refuses: {refused}") from refused
        if remaining:
            raise FaultRefusedError(f"{name} does not know {', '.join(sorted(remaining))}")
        return answer

    def clear_faults(self) -> None:
        """Take refusals of writes away."""
        self._controller.refused_axes = frozenset()

    def boot_when_due(self) -> None:
        """Switch on again after a power cycle."""
        if self._boot_at_s is not None and self._world.clock.now_s() >= self._boot_at_s:
            self._boot_at_s = None
            self._controller.switch_on()

    # losses

    def _battery_loss(self, parameters: dict[str, Any]) -> None:
        self._lose_positions(parameters, _parse_axes(parameters.pop("axes", _EVERY_AXIS)))

    def _motor_exchange(self, parameters: dict[str, Any]) -> None:
        axis = _parse_axis(parameters.pop("axis", "J3"))
        self._lose_positions(parameters, _parse_axes(_EVERY_AXIS), new_motors=[axis], drift_turns=2.0)

    def _reference_loss(self, parameters: dict[str, Any]) -> None:
        every = _parse_axes(_EVERY_AXIS)
        self._lose_positions(parameters, every, new_motors=every, drift_turns=2.0)

    def _crash_arm(self, parameters: dict[str, Any]) -> None:
        rng = self._world.make_rng(self._controller.arm.name, "crash", str(self._losses))
        signs = rng.choice([-1.0, 1.0], (6, 5))
        angles, lengths = np.radians(rng.uniform(0.3, 0.6, (6, 5))), rng.uniform(2e-3, 5e-3, (6, 5))
        bent = (
            np.column_stack([angles[:, 0], lengths[:, 1], lengths[:, 2], angles[:, 3], np.zeros(6)]) * signs
        )
        hit = np.isin(np.arange(6), (1, 2, 3, 4))
        self._controller.arm.bend_links(np.where(hit[:, None], bent, 0.0))
        self._lose_positions(parameters, _parse_axes(_EVERY_AXIS))

    def _memory_loss(self, _parameters: dict[str, Any]) -> None:
        """Forget the mastering data in the cabinet; the encoders go on counting."""
        self._controller.forget_mastering()

    def _old_backup(self, parameters: dict[str, Any]) -> None:
        """Load a backup from before the robot was last mastered: one axis then had its zero elsewhere."""
        controller, axis = self._controller, _parse_axis(parameters.pop("axis", "J3"))
        counts = list(controller.counts_at_zero)
        counts[axis] += int(parameters.pop("counts", COUNTS_PER_TURN // 3))
        controller.write_counts_at_zero(tuple(counts))
        controller.calibrate_joints()

    def _swapped_arm(self, parameters: dict[str, Any]) -> None:
        """Put another arm of the same type under the same cabinet: its zeros are its own, its links, too."""
        rng, every = (
            self._world.make_rng(self._controller.arm.name, "swap", str(self._losses)),
            _parse_axes(_EVERY_AXIS),
        )
        size = np.array([*np.radians([0.03]), 4e-4, 4e-4, *np.radians([0.03, 0.0])])
        self._controller.arm.bend_links(rng.normal(0.0, 1.0, (6, 5)) * size)
        self._lose_positions(parameters, every, new_motors=every, drift_turns=2.0)

    def _lose_positions(
        self,
        parameters: dict[str, Any],
        axes: list[int],
        *,
        new_motors: list[int] | None = None,
        drift_turns: float = 1.0,
    ) -> None:
        """Take power and battery away; the arm moves a little while the counter is off; the power comes back."""
        controller, coders = self._controller, self._controller.coders
        drift_turns = float(parameters.pop("drift_turns", drift_turns))
        off_s, battery = float(parameters.pop("off_s", OFF_S)), str(parameters.pop("battery", "dead"))
        rng = self._world.make_rng(controller.arm.name, "loss", str(self._losses))
        self._losses += 1
        controller.switch_off()
        controller.battery_dead_axes = frozenset(axes) if battery == "dead" else frozenset()
        drift = np.zeros(6)
        drift[axes] = rng.uniform(-drift_turns, drift_turns, len(axes))
        self._sag_by(coders.drift_joints(drift))
        for axis in new_motors or []:
            coders.replace_motor(axis, int(rng.integers(COUNTS_PER_TURN // 10, COUNTS_PER_TURN * 9 // 10)))
        coders.lose_turns(axes)
        self._boot_after(off_s)

    def _sag_by(self, joints_rad: np.ndarray[Any, np.dtype[np.float64]]) -> None:
        arm = self._controller.arm
        arm.put_joints(np.clip(arm.joints_rad + joints_rad, arm.lower_rad, arm.upper_rad))

    # power and battery

    def _boot_after(self, off_s: float) -> None:
        self._boot_at_s = self._world.clock.now_s() + off_s
        self.boot_when_due()

    def _power_off(self, _parameters: dict[str, Any]) -> None:
        self._boot_at_s = None
        self._controller.switch_off()

    def _power_on(self, _parameters: dict[str, Any]) -> None:
        self._boot_at_s = None
        self._controller.switch_on()

    def _power_cycle(self, parameters: dict[str, Any]) -> None:
        self._controller.switch_off()
        self._boot_after(float(parameters.pop("off_s", OFF_S)))

    def _new_battery(self, _parameters: dict[str, Any]) -> None:
        self._controller.battery_dead_axes = frozenset()
        self._controller.alarms = [a for a in self._controller.alarms if a.code != "SRVO-065"]

    def _battery_low(self, parameters: dict[str, Any]) -> None:
        for axis in reversed(_parse_axes(parameters.pop("axes", _EVERY_AXIS))):
            self._controller.raise_alarm("SRVO-065", axis)

    def _raise_alarm(self, parameters: dict[str, Any]) -> None:
        axis = parameters.pop("axis", None)
        self._controller.raise_alarm(
            str(parameters.pop("code", "SRVO-038")), None if axis is None else _parse_axis(axis)
        )

    # hands

    def _set_override(self, parameters: dict[str, Any]) -> None:
        self._controller.set_override(int(parameters.pop("percent", 100)))

    def _jog_by_hand(self, parameters: dict[str, Any]) -> None:
        """Another client, or a person at the pendant, moves one axis."""
        arm = self._controller.arm
        target = arm.joints_rad
        target[_parse_axis(parameters.pop("axis", "J1"))] += float(parameters.pop("rad", 0.01))
        arm.start_move(target, float(parameters.pop("speed_rad_s", 0.5)), 2.0)

    def _hand_moves(self, parameters: dict[str, Any]) -> None:
        """Drive the arm at the pendant to where the controller shows these joints."""
        arm = self._controller.arm
        arm.put_joints(np.clip(self._true_joints_for(parameters), arm.lower_rad, arm.upper_rad))

    def _bring_tool(self, parameters: dict[str, Any], *, seated: bool) -> None:
        """Bring the tool to a mark or into a seat; ``joints`` define its position the first time."""
        arm, number = self._controller.arm, int(parameters.pop("place"))
        near = self._true_joints_for(parameters) if "joints" in parameters else arm.joints_rad
        self._world.marks.bring_tool(arm, number, near, seated=seated)

    def _true_joints_for(self, parameters: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return the true joints (6,) at which the controller shows those that are given."""
        shown = np.array([float(angle) for angle in parameters.pop("joints")])
        if shown.shape != (6,) or not np.isfinite(shown).all():
            raise FaultRefusedError("joints are six finite numbers [rad]")
        return shown + self._controller.joint_offset()  # a lost robot stands elsewhere than it shows

    def _press_reset(self, _parameters: dict[str, Any]) -> None:
        """Press the RESET key of the pendant; what it cannot clear stays."""
        self._controller.reset_alarms()

    def _acknowledge_lost_position(self, _parameters: dict[str, Any]) -> None:
        """Press RES_PCA in the menu Master/Cal, then RESET; what these cannot clear stays."""
        self._controller.request_reset(1)
        with contextlib.suppress(ProgramRefusalError):  # the pendant shows what is left
            self._controller.reset_alarms()

    def _type_mastering(self, parameters: dict[str, Any]) -> None:
        """Type six master counts, set MASTER_DONE and press CALIBRATE."""
        counts = tuple(int(count) for count in parameters.pop("counts"))
        if len(counts) != len(self._controller.counts_at_zero):
            raise FaultRefusedError("there is one master count for each axis")
        self._controller.write_counts_at_zero(counts)
        self._controller.calibrate_joints()

    def _partial_write(self, parameters: dict[str, Any]) -> None:
        self._controller.refused_axes = frozenset(
            _parse_axes(parameters.pop("axes", parameters.pop("axis", "J4")))
        )

    def _select_at_pendant(self, parameters: dict[str, Any]) -> None:
        """Select another tool or frame at the pendant."""
        if "tool" in parameters:
            self._controller.select_tool(int(parameters.pop("tool")))
        if "frame" in parameters:
            self._controller.select_frame(int(parameters.pop("frame")))

    def _move_external_axis(self, parameters: dict[str, Any]) -> None:
        """Drive a rail or positioner, as a person may: E1 to E3, or one of a second group; it is there at once."""
        group, axis = int(parameters.pop("group", 1)), int(parameters.pop("axis", 1))
        if group != 1 and self._controller.second_group is None:
            self._controller.second_group = [0.0] * 9
        places = self._controller.external if group == 1 else self._controller.second_group or []
        if not 1 <= axis <= len(places):
            raise ValueError(f"the axes of group {group} are 1 to {len(places)}")
        places[axis - 1] = float(parameters.pop("value"))

    def _tool_switched(self, parameters: dict[str, Any]) -> None:
        """Select another tool at the pendant: ``number``, or the next one."""
        self._controller.select_tool(int(parameters.pop("number", self._controller.tool_number % TOOLS + 1)))

    def _start_program(self, _parameters: dict[str, Any]) -> None:
        """Press START: CELLCAL begins, or goes on where it was paused."""
        self._interpreted_program().start_program()

    def _abort_program(self, _parameters: dict[str, Any]) -> None:
        """End CELLCAL with FCTN, ABORT."""
        self._interpreted_program().abort_program()

    def _interpreted_program(self) -> TpProgram:
        program = self._controller.program
        if not isinstance(program, TpProgram):
            raise FaultRefusedError("the program of the simulated controller is always started")
        return program

    def _early_stop(self, _parameters: dict[str, Any]) -> None:
        """End a motion early, for no reason that the program knows: it will say done."""
        self._controller.arm.stop(8.0)


def _parse_axis(name: Any) -> int:
    text = str(name)
    if text.startswith("J") and text[1:].isdigit() and 1 <= int(text[1:]) <= 6:
        return int(text[1:]) - 1
    raise FaultRefusedError(f"{name!r} is no axis; they are J1 to J6")


def _parse_axes(names: Any) -> list[int]:
    if names == _EVERY_AXIS:
        return list(range(6))
    return sorted({_parse_axis(name) for name in ([names] if isinstance(names, str) else names)})
