"""The state of an ABB controller with one arm, its RAPID data, and CellcalServer running on it.

Imitates
    An IRC5 with RobotWare 6 and one six-axis arm.
Source
    ABB 3HAC050973-001 rev M for names and states; deploy/controller_setup/abb for the program, whose text is executed
    (program.py).
Modelled
    Mode, motors, speed ratio, axis states, revolution counters, tools by name, external axes, event log; what stops
    the program: the emergency stop, the mode switch, an axis that is not synchronised.
Not modelled
    Tasks other than T_ROB1, jogging, programs in manual mode.
"""

import datetime
import math
from collections.abc import Callable, Mapping

import numpy as np

from cellcal.fake_devices.abb_web_services.files import FileFolder
from cellcal.fake_devices.abb_web_services.program import NO_AXIS, CellcalServer, RapidPrograms
from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.kinematics import Array
from cellcal.fake_devices.program_text.expressions import Value
from cellcal.fake_devices.shown_joints import ShownJoints

_LOG_PAGE = 50
_TOOLS = {
    "tool0": ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], 0.001),
    "tGripper": ([10.0, -5.0, 180.0], [0.9961947, 0.0, 0.0871557, 0.0], 3.5),
    "tPin": ([0.0, 0.0, 95.0], [0.9659258, 0.0, 0.0, 0.258819], 1.25),
}
_CALIBRATION_OFFSETS_RAD = (5.81034, 2.31177, 5.20941, 0.66128, 4.41203, 2.70586)  # of each resolver


class AbbController:
    """Everything behind the web service."""

    def __init__(
        self,
        arm: SimulatedArm,
        serial: str,
        real_s: Callable[[], float],
        counters: ShownJoints,
        sources: RapidPrograms | None = None,
    ) -> None:
        self.arm, self.serial, self.counters, self.real_s = arm, serial, counters, real_s
        arm.convert_to_shown = counters.to_shown_joints
        self.title = arm.model.name.removeprefix("abb_").upper()
        self.mode, self.motors, self.speed_percent = "AUTO", "motoron", 100
        self.has_second_robot = False
        self.axis_states = ["Synchronized"] * 6
        self.calibration_offsets = list(_CALIBRATION_OFFSETS_RAD)
        self.tool_name, self.work_object = "tGripper", "wobj0"
        self.external = [NO_AXIS] * 6  # eax_a to eax_f [mm or deg]; 9E9 where there is none
        self.timer_factor = 1.0  # timers run so many times slower, for machines that have other work
        self.log: list[tuple[int, int, str, str]] = []  # code, type, time, title
        self.files = FileFolder()
        self.server = CellcalServer(self, sources or RapidPrograms())

    # RAPID data

    def read_symbol(self, name: str) -> str | None:
        """Return the value of a symbol of T_ROB1."""
        if name in _TOOLS:
            place, turn, mass = _TOOLS[name]
            return f"[TRUE,[{_list_text(place)},{_list_text(turn)}],[{mass:g},[0,0,1],[1,0,0,0],0,0,0]]"
        return self.server.show(name)

    def write_symbol(self, name: str, value: str) -> bool:
        """Write a symbol; return whether it is there and the value fits."""
        return self.server.set_from_text(name, value)

    def tool_data(self, name: str) -> Value:
        """Return a tooldata by its name."""
        if name in _TOOLS:
            place, turn, mass = _TOOLS[name]
            load = [mass, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0]
            return [True, [list(place), list(turn)], load]
        return self.server.tool(name)

    def tool_matrix(self) -> Array:
        """Return the active tool (4, 4)."""
        place, (w, x, y, z) = self.tool_data(self.tool_name)[1]
        pose = np.eye(4)
        pose[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        pose[:3, 3] = np.array(place) * 1e-3
        return pose

    def payload_kg(self) -> float:
        """Return the mass of the active tool."""
        return float(self.tool_data(self.tool_name)[2][0])

    def tool_names(self) -> list[str]:
        """Return the tools that a person can select."""
        return [name for name in _TOOLS if name != "tool0"]

    def joints_deg(self) -> list[float]:
        """Return the joints as they are told."""
        return [float(value) for value in np.degrees(self.arm.controller_joints_rad)]

    def flange_pose(self) -> Array:
        """Return base_flange as the controller computes it."""
        return np.asarray(self.arm.believed_flange(self.arm.controller_joints_rad)[0])

    # the program on it

    @property
    def may_move(self) -> bool:
        """Whether a program may drive the arm."""
        ready = self.mode == "AUTO" and self.motors == "motoron"
        return ready and all(state == "Synchronized" for state in self.axis_states)

    @property
    def program_runs(self) -> bool:
        """Whether the task is started."""
        return self.server.task.is_running

    def run_program(self) -> None:
        """One cycle of the task; what bars motion stops it."""
        if not self.may_move:
            self.server.task.stop_program()
        self.server.run_cycle()

    # what happens

    @property
    def unit_status(self) -> str:
        """The state of the mechanical unit: that of its worst axis."""
        return next((state for state in self.axis_states if state != "Synchronized"), "Synchronized")

    def note_event(self, code: int, kind: int, title: str) -> None:
        """Write an entry of the event log."""
        stamp = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d T %H:%M:%S")
        self.log.insert(0, (code, kind, stamp, title))

    def note_programs(self, count: int) -> None:
        """Let a program be started often, of which the log tells each time."""
        for _ in range(count):
            self.note_event(10151, 1, "Program started")

    def log_page(self, query: Mapping[str, str]) -> list[tuple[int, tuple[int, int, str, str]]]:
        """Return a page of the log with the numbers of its entries, newest first; order=fifo: from elogseqnum on."""
        numbered = [(len(self.log) - k, entry) for k, entry in enumerate(self.log)]
        if query.get("order") == "fifo":
            begin = int(query.get("elogseqnum", "0"))
            numbered = [each for each in reversed(numbered) if each[0] >= begin]
        return numbered[:_LOG_PAGE]

    def press_emergency_stop(self) -> None:
        """Push the red button."""
        self.motors = "emergencystop"
        self.server.task.stop_program()
        self.note_event(10013, 1, "Emergency stop state")

    def turn_mode_switch(self, mode: str) -> None:
        """Turn the mode switch."""
        self.mode = mode
        if mode != "AUTO":
            self.motors = "motoroff"
            self.server.task.stop_program()

    def turn_to_auto(self) -> None:
        """Turn the mode switch to AUTO, switch the motors on and press START: a stopped program goes on."""
        self.mode, self.motors = "AUTO", "motoron"
        self.server.task.press_start()

    def lose_counters(self, axes: list[int]) -> None:
        """Empty the battery of the measuring board: the revolution counters of these axes are gone."""
        for axis in axes:
            self.axis_states[axis] = "NotAMSSynchronized"
        self.counters.lose_turns(axes)
        self.note_event(20032, 3, "Rev. counter not updated")

    def lose_calibration(self, axes: list[int]) -> None:
        """Take the calibration of these axes, as a new motor does: before a new one no counter can be updated."""
        for axis in axes:
            self.axis_states[axis] = "NotCalibrated"
        self.counters.lose_turns(axes)

    def update_counter(self, axis: int) -> None:
        """Update the revolution counter of an axis at the pendant, where it stands."""
        if self.axis_states[axis] == "NotCalibrated":
            return
        self.counters.update_counter(axis)
        self.axis_states[axis] = "Synchronized"

    def fine_calibrate(self, axis: int) -> None:
        """Take where an axis stands as its calibration position."""
        shown = float(self.counters.to_shown_joints(self.arm.joints_rad)[axis])
        motor_rad = shown / float(self.counters.turn_rad[axis]) * 2 * math.pi
        self.calibration_offsets[axis] = (self.calibration_offsets[axis] + motor_rad) % (2 * math.pi)
        self.counters.set_zero(axis)
        self.axis_states[axis] = "Synchronized"

    def set_speed(self, percent: int) -> None:
        """Turn the speed ratio."""
        if not 1 <= percent <= 100:
            raise ValueError("the speed ratio is 1 to 100 %")
        self.arm.change_pace(percent / self.speed_percent)
        self.speed_percent = percent

    def mend(self) -> None:
        """Set everything right at the pendant, and let the program run."""
        self.mode, self.motors = "AUTO", "motoron"
        self.axis_states = ["Synchronized"] * 6
        self.calibration_offsets = list(_CALIBRATION_OFFSETS_RAD)
        self.counters.mend()
        self.server.restart()


def _list_text(values: list[float]) -> str:
    if not all(map(math.isfinite, values)):
        raise ValueError("a value is not finite")
    return f"[{','.join(f'{value:.7g}' for value in values)}]"
