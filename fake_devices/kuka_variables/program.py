"""CELLCAL and its part of the submit interpreter in the fake controller: it obeys the text of the sources that ship.

Imitates
    A KUKA controller that runs them: CELLCAL.SRC, CELLCAL_RSI.SRC or both put together as the selected program,
    CELLCAL_SPS.SRC within SPS.SUB, CELLCAL_GLOBALS.DAT within $CONFIG.DAT.
Source
    deploy/controller_setup/kuka; fake_devices.krl_programs for what the statements mean.
Modelled
    Global variables with their kinds (32 bit); $AXIS_ACT with E1 to E6, $VEL_AXIS, $ACC_AXIS, $LOAD, $TIMER,
    $PRO_STATE1, $SOFTN_END, $SOFTP_END; a submit interpreter that is slower than the robot interpreter; a motion
    beyond a limit, or of an axis without mastering, is a stop message, and START tries the same line again.
Not modelled
    Everything else that $CONFIG.DAT and SPS.SUB hold; external axes that travel slowly: they are there at once.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellcal.fake_devices.krl_programs.source import (
    AXIS_MEMBERS,
    KrlSource,
    parse_axes,
    read_globals,
    read_lines,
    read_source,
    read_source_with_sensor,
)
from cellcal.fake_devices.krl_programs.tasks import RobotInterpreter, run_submit_lines
from cellcal.fake_devices.program_text.expressions import ProgramTextError, Value

if TYPE_CHECKING:
    from cellcal.fake_devices.kuka_variables.controller import KukaController

SOURCES = Path(__file__).parent / "sources"  # a link to deploy/controller_setup, which a wheel holds as files
_ACCELERATION_RAD_S2 = 4.0
_BRAKING_RAD_S2 = 8.0
_SUBMIT_PERIOD = 3  # cycles of the robot interpreter: 12 ms
_TIMERS = 20  # KR C2 has no more
_ROUNDING_RAD = 1e-6  # a limit in single-precision degrees is still the limit
_LARGEST = 2**31


CELLCAL, SENSOR, BOTH = "CELLCAL", "CELLCAL_RSI", "CELLCAL with the lines of CELLCAL_RSI"


@dataclass(frozen=True)
class KrlPrograms:
    """Where the sources are, which one is selected, and how fast it is executed."""

    folder: Path = SOURCES
    program: str = CELLCAL
    statements_per_cycle: int = 500

    def read_program(self) -> KrlSource:
        """Read the program that is selected."""
        if self.program == BOTH:
            return read_source_with_sensor(self.folder / f"{CELLCAL}.SRC", self.folder / f"{SENSOR}.SRC")
        return read_source(self.folder / f"{self.program}.SRC")


class CellcalPrograms:
    """The sources, executed, and their variables."""

    def __init__(self, controller: "KukaController", sources: KrlPrograms) -> None:
        self._c, folder = controller, sources.folder
        declared = read_globals(folder / "CELLCAL_GLOBALS.DAT")
        self._kinds = {name: variable.kind for name, variable in declared.items()}
        self._values: dict[str, Value] = {name: variable.value for name, variable in declared.items()}
        self._timers: dict[int, float] = {}  # when each stood at zero [s]
        self._speeds = dict.fromkeys(range(1, 7), 100)
        self._cycles = 0
        self._submit = read_lines(folder / "CELLCAL_SPS.SRC")
        self.context_files = {"CELLCAL_RSI.rsi"}  # of the controller; made in WorkVisual
        self._has_context = self.sensor_runs = False
        self.robot = RobotInterpreter(sources.read_program(), self, sources.statements_per_cycle)
        self.restart()

    # what a person does

    def restart(self) -> None:
        """Select CELLCAL and press START."""
        self.robot.select_program()
        self.robot.press_start()

    # variables on the wire

    def show(self, name: str) -> str | None:
        """Return a global variable as a text; None where it is not declared."""
        value = self._values.get(name)
        if isinstance(value, bool):
            return "TRUE" if value else "FALSE"
        if isinstance(value, dict):
            members = ", ".join(f"{member} {number:.7g}" for member, number in value.items())
            return f"{{E6AXIS: {members}}}"
        return None if value is None else str(value)

    def set_from_text(self, name: str, text: str) -> bool:
        """Set a global variable; return whether it is declared and the text fits. Members that are left out stay."""
        kind, word = self._kinds.get(name), text.strip()
        if kind == "E6AXIS":
            found = parse_axes(word)
            if found is not None:
                self._values[name] = {**self._values[name], **{key: _single(v) for key, v in found.items()}}
            return found is not None
        if kind == "BOOL" and word.upper() in ("TRUE", "FALSE"):
            self._values[name] = word.upper() == "TRUE"
            return True
        if kind != "INT" or not word.lstrip("-").isdigit() or not -_LARGEST <= int(word) < _LARGEST:
            return False
        self._values[name] = int(word)
        return True

    # running

    def run_cycle(self) -> None:
        """Run one cycle of the robot interpreter, and each third time one of the submit interpreter before it."""
        self._cycles += 1
        if self._cycles % _SUBMIT_PERIOD == 0:
            run_submit_lines(self._submit, self)
        self.robot.run_cycle(self._now_s())

    def _now_s(self) -> float:
        return self._c.real_s() / self._c.timer_factor

    # what the programs read and write

    def read_variable(self, name: str, index: int | None, member: str) -> Value:
        if name in self._values:
            value = self._values[name]
            return value.get(member) if member else value
        if name == "$AXIS_ACT":
            axes = self._c.shown_axes()
            return axes[member] if member else axes
        if name == "$PRO_STATE1":
            return self.robot.state
        return self._read_element(name, index)

    def _read_element(self, name: str, index: int | None) -> Value:
        number = self._checked_index(name, index)
        if name == "$TIMER":
            return int((self._now_s() - self._timers.get(number, 0.0)) * 1000.0)
        if name == "LOAD_DATA":
            return {"M": self._c.loads_kg[number - 1]}
        limits = {"$SOFTN_END": self._c.arm.lower_rad, "$SOFTP_END": self._c.arm.upper_rad}
        if name in limits:
            return _single(float(np.degrees(limits[name][number - 1])))
        raise ProgramTextError(f"{name} is not modelled")

    def write_variable(self, name: str, index: int | None, member: str, value: Value) -> None:
        if name in self._kinds:
            self._write_global(name, member, value)
        elif name == "$LOAD":
            self._c.load_kg = float(value["M"])
        elif name == "$TIMER":
            self._timers[self._checked_index(name, index)] = self._now_s() - int(value) / 1000.0
        elif name == "$TIMER_STOP":
            self._checked_index(name, index)
            if value is not False:
                raise ProgramTextError("a timer is never stopped here")
        elif name in ("$VEL_AXIS", "$ACC_AXIS"):
            self._write_speed(name, self._checked_index(name, index), value)
        else:
            raise ProgramTextError(f"{name} is not modelled")

    def _write_global(self, name: str, member: str, value: Value) -> None:
        kind = self._kinds[name]
        if kind == "E6AXIS" and member in AXIS_MEMBERS:
            self._values[name] = {**self._values[name], member: _single(float(value))}
        elif {"INT": int, "BOOL": bool}.get(kind) is type(value):
            self._values[name] = value
        else:
            raise ProgramTextError(f"{value!r} does not fit into {name}, which is {kind}")

    def _write_speed(self, name: str, axis: int, value: Value) -> None:
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 100:
            raise ProgramTextError(f"{name}[{axis}] takes 1 to 100, and not {value!r}")
        if name == "$VEL_AXIS":
            self._speeds[axis] = value

    def _checked_index(self, name: str, index: int | None) -> int:
        highest = {"$VEL_AXIS": 12, "$ACC_AXIS": 12, "LOAD_DATA": len(self._c.loads_kg)}.get(name, _TIMERS)
        if index is None or not 1 <= index <= highest:
            raise ProgramTextError(f"{name} has no element {index}")
        return index

    # the sensor interface

    def create_sensor_context(self, file: str) -> bool:
        if self._has_context or file not in self.context_files:
            return False
        self._has_context = True
        return True

    def start_sensor(self) -> bool:
        self.sensor_runs = self._has_context
        return self.sensor_runs

    def end_sensor(self) -> None:
        self._has_context = self.sensor_runs = False

    # what moves the arm

    def initialise_motion(self) -> None:
        """BAS(#INITMOV,0): speeds, no tool, no base. Its text is the controller's own and was not seen."""
        self._speeds = dict.fromkeys(range(1, 7), 100)
        self._c.select_tool(0)

    def select_tool(self, number: int) -> None:
        """BAS(#TOOL,n)."""
        self._c.select_tool(number)

    def accepts_motion(self, target: Value) -> bool:
        missing = [member for member in AXIS_MEMBERS if target.get(member) is None]
        if missing:
            raise ProgramTextError(f"{', '.join(missing)} of the target have no value")
        shown = np.radians([target[f"A{axis}"] for axis in range(1, 7)])
        arm = self._c.arm
        beyond = (shown < arm.lower_rad - _ROUNDING_RAD) | (shown > arm.upper_rad + _ROUNDING_RAD)
        if beyond.any() or not all(self._c.mastered):
            self._c.stop_message = True
            return False
        return True

    def begin_motion(self, target: Value) -> None:
        c, arm = self._c, self._c.arm
        c.external = [float(target[f"E{axis}"]) for axis in range(1, 7)]
        goal = c.zeros.to_true_joints(np.radians([target[f"A{axis}"] for axis in range(1, 7)]))
        way = np.abs(goal - arm.joints_rad)
        longest = float(way.max())
        if longest > 0.0:
            shares = np.array([self._speeds[axis] for axis in range(1, 7)]) / 100.0
            pace = shares * c.override_percent / 100.0
            needed_s = float((way / (arm.max_speed_rad_s * pace)).max())
            arm.start_move(goal, longest / needed_s, _ACCELERATION_RAD_S2)

    def brake(self) -> None:
        self._c.arm.stop(_BRAKING_RAD_S2)

    def is_standing(self) -> bool:
        return not self._c.arm.is_moving


def _single(value: float) -> float:
    """Return a REAL as its 32 bits hold it."""
    return float(struct.unpack("f", struct.pack("f", value))[0])
