"""CellcalServer in the fake controller: it obeys the text of the module that ships.

Imitates
    A controller with CellcalServer in T_ROB1, program pointer at main, started; where the cell file names a stream,
    with CellcalStream beside it.
Source
    deploy/controller_setup/abb; fake_devices.rapid_programs for what the instructions mean.
Modelled
    RAPID data on the wire: all are read, PERS are written with a value of their kind; CTool, CJointT; a joint motion
    within a time, at the speed ratio; an axis beyond its limit, a tool beside the robot, and an external axis that is
    there and has no value in the target (each an event, and the program stops).
Not modelled
    Everything else in the task; external axes that travel slowly: they are there at once. The texts of the last two
    events are not the maker's.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellcal.fake_devices.program_text.expressions import ProgramTextError, Value
from cellcal.fake_devices.rapid_programs.source import (
    ExecutedModule,
    fits,
    parse_value,
    read_module,
    read_module_with_stream,
    write_value,
)
from cellcal.fake_devices.rapid_programs.tasks import MotionTask

if TYPE_CHECKING:
    from cellcal.fake_devices.abb_web_services.controller import AbbController

SOURCES = Path(__file__).parent / "sources"  # a link to deploy/controller_setup, which a wheel holds as files
NO_AXIS = 9e9
_ACCELERATION_RAD_S2 = 4.0
_BRAKING_RAD_S2 = 8.0
_ROUNDING_RAD = 1e-6  # a limit in single-precision degrees is still the limit


@dataclass(frozen=True)
class RapidPrograms:
    """Where the modules are, whether main starts a stream, and how fast they are executed."""

    folder: Path = SOURCES
    with_stream: bool = False
    instructions_per_cycle: int = 500

    def read_modules(self) -> ExecutedModule:
        """Read what is loaded into the task."""
        server = self.folder / "CellcalServer.mod"
        return (
            read_module_with_stream(server, self.folder / "CellcalStream.mod")
            if self.with_stream
            else read_module(server)
        )


class CellcalServer:
    """The module, executed."""

    def __init__(self, controller: "AbbController", sources: RapidPrograms) -> None:
        self._c = controller
        self._module = sources.read_modules()
        self.task = MotionTask(self._module, self, sources.instructions_per_cycle)
        self.restart()

    def restart(self) -> None:
        """Program pointer to main, and start."""
        self.task.move_pointer_to_main()
        self.task.press_start()

    def run_cycle(self) -> None:
        """Run one cycle."""
        self.task.run_cycle(self._c.real_s() / self._c.timer_factor)

    # data on the wire

    def show(self, name: str) -> str | None:
        """Return the value of data of the module, with or without its name before; None where there are none."""
        key = self._data_key(name)
        return None if key is None else write_value(self.task.data[key])

    def set_from_text(self, name: str, text: str) -> bool:
        """Set PERS data; return whether they are there and the value fits."""
        key, value = self._data_key(name), parse_value(text)
        if key is None or not self._module.data[key].is_persistent or value is None:
            return False
        if not fits(self._module.data[key].kind, value):
            return False
        self.task.data[key] = value
        return True

    def tool(self, name: str) -> Value:
        """Return the tooldata of the module by its name; None where it has none."""
        key = self._data_key(name)
        is_tool = key is not None and self._module.data[key].kind == "tooldata"
        return self.task.data[key] if is_tool and key is not None else None

    def _data_key(self, name: str) -> str | None:
        module, _, short = name.upper().rpartition("/")
        known = module in ("", self._module.name.upper()) and short in self._module.data
        return short if known else None

    # what the program calls

    def call_function(self, name: str) -> Value:
        if name == "CTOOL":
            return self._c.tool_data(self._c.tool_name)
        if name == "CJOINTT":
            return [self._c.joints_deg(), list(self._c.external)]
        raise ProgramTextError(f"{name} is no function that is executed here")

    def begin_motion(self, target: Value, time_s: float, tool: str) -> bool:
        c, arm = self._c, self._c.arm
        shown = np.radians(target[0])
        if (shown < arm.lower_rad - _ROUNDING_RAD).any() or (shown > arm.upper_rad + _ROUNDING_RAD).any():
            c.note_event(50027, 3, "Joint Out of Range")
            return False
        absent = [there < NO_AXIS * 0.9 < value for there, value in zip(c.external, target[1], strict=True)]
        carried = self.task.data[tool]
        if any(absent) or carried is None or not carried[0]:
            c.note_event(50416, 3, "Missing external axis value" if any(absent) else "Tool beside the robot")
            return False
        c.tool_name = next(datum.name for key, datum in self._module.data.items() if key == tool)
        c.external = [
            value if there < NO_AXIS * 0.9 else there
            for there, value in zip(c.external, target[1], strict=True)
        ]
        goal = c.counters.to_true_joints(shown)
        way = np.abs(goal - arm.joints_rad)
        longest = float(way.max())
        if longest > 0.0:
            fastest_s = float((way / arm.max_speed_rad_s).max())
            needed_s = max(time_s, fastest_s) * 100.0 / c.speed_percent
            arm.start_move(goal, longest / needed_s, _ACCELERATION_RAD_S2)
        return True

    def brake(self) -> None:
        self._c.arm.stop(_BRAKING_RAD_S2)

    def is_standing(self) -> bool:
        return not self._c.arm.is_moving
