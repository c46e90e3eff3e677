"""Yaskawa jobs whose motions are absolute, incremental, led, shifted, computed and mixed, with their cell."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from tests.programs.yaskawa_motion import pose_from_xyzrxryrz, rows_of, values_of

PROJECT = """format = 1
name = "moved"
[robot]
serial = "Y1"
model = "yaskawa_ar2010"
smallest_sigma = 0.0001
[tools.0.entered]
position_mm = [0, 0, 100]
[frames.2]
position_mm = [1200, 100, -100]
yaskawa_rpy_deg = [0, 0, 30]
[frames.3]
position_mm = [1250, -50, 0]
yaskawa_rpy_deg = [0, 10, -20]
"""
FRAMES = {
    2: pose_from_xyzrxryrz((1200, 100, -100, 0, 0, 30)),
    3: pose_from_xyzrxryrz((1250, -50, 0, 0, 10, -20)),
}
DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass
class JobCase:
    """A job, variables that it does not state, how the work moves, and the positions that must go along."""

    text: str
    variables: dict[int, tuple[float, ...]]
    change: np.ndarray
    plain: set[str] = field(default_factory=set)


class _MovedJobWriter:
    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.lines: list[str] = []
        self.rows: dict[str, list[str]] = {"C": [], "P": []}
        self.stated: dict[str, str] = {"C": "", "P": ""}
        self.counts = {"C": 0, "P": 0}
        self.plain: set[str] = set()
        self.variables: dict[int, tuple[float, ...]] = {}
        self.every_frame_holds = True

    def write_row(self, kind: str, frame: str, values: tuple[float, ...]) -> str:
        """Write a row; return its name in instructions."""
        number = self.counts[kind]
        self.counts[kind] += 1
        stated = f"///USER {frame}\n///POSTYPE USER" if frame.isdigit() else f"///POSTYPE {frame}"
        if stated != self.stated[kind]:
            flags = ",".join("0" * 24)
            self.rows[kind] += [*stated.split("\n"), "///RECTAN", f"///RCONF {flags}"]
            self.stated[kind] = stated
        texts = [f"{value:.3f}" for value in values[:3]] + [f"{value:.4f}" for value in values[3:]]
        self.rows[kind].append(f"{kind}{number:05d}={','.join(texts)}")
        return f"C{number:05d}" if kind == "C" else f"P{number:03d}"

    def write_position(self, kind: str = "", *, plain: bool = True, frame: str = "") -> str:
        """Write a position over the work with the tool down."""
        kind = kind or ("C" if self.rng.random() < 0.7 else "P")
        frame = frame or _pick_one(self, ["BASE", "ROBOT", "2", "2", "3"])
        base = np.eye(4)
        base[:3, :3] = Rotation.from_rotvec(self.rng.uniform(-0.25, 0.25, 3)).as_matrix() @ DOWN
        base[:3, 3] = np.array([1.25, 0.0, 0.1]) + self.rng.uniform(-0.2, 0.2, 3)
        local = np.linalg.inv(FRAMES[int(frame)]) @ base if frame.isdigit() else base
        name = self.write_row(kind, frame, values_of(local))
        if plain:
            self.plain.add(row_name(name))
        return name

    def write_amount(self, *, stated: bool = True) -> str:
        """Write an amount, as a row or as a variable that only the controller holds."""
        turn = self.rng.uniform(-15, 15, 3) if self.rng.random() < 0.2 else np.zeros(3)
        values = tuple(np.round([*self.rng.uniform(-60, 60, 3), *turn], 3).tolist())
        if stated:
            return self.write_row("P", _pick_one(self, ["ROBOT", "BASE", "2"]), values)
        number = 60 + len(self.variables)
        self.variables[number] = values
        return f"P{number:03d}"

    def add_lines(self, *lines: str) -> None:
        self.lines += lines

    def add_move(self, target: str, word: str = "") -> None:
        word = word or _pick_one(self, ["MOVJ", "MOVL", "MOVL", "MOVC", "MOVS"])
        speed = "VJ=25.00" if word == "MOVJ" else "V=375.0"
        self.add_lines(f"{word} {target} {speed}{_pick_one(self, ['', ' PL=0', ' ACC=50'])}")


def row_name(name: str) -> str:
    """Return a row's name for that in an instruction."""
    return f"{name[0]}{int(name[1:]):05d}"


def _external_axes_text(make: _MovedJobWriter) -> str:
    return _pick_one(make, ["BF", "RF", "TF", "UF#(2)", "UF#(3)"])


def _add_absolute_moves(make: _MovedJobWriter) -> None:
    make.add_move(make.write_position())


def _add_increment(make: _MovedJobWriter) -> None:
    make.add_lines(
        f"IMOV {make.write_amount(stated=bool(make.rng.random() < 0.6))} V=50.0 {_external_axes_text(make)}"
    )


def _add_shift(make: _MovedJobWriter) -> None:
    make.add_lines(
        f"SFTON {make.write_amount(stated=bool(make.rng.random() < 0.6))} {_external_axes_text(make)}"
    )
    for _ in range(int(make.rng.integers(1, 4))):
        _pick_one(make, [_add_absolute_moves, _add_absolute_moves, _add_increment])(make)
    make.add_lines("SFTOF")


def _add_led_motion(make: _MovedJobWriter) -> None:
    make.add_move(
        make.write_position("C", plain=False), _pick_one(make, ["SMOVL", "SMOVC", "SYMOVL", "EMOVL"])
    )


def _variable_computed(make: _MovedJobWriter) -> None:
    name = make.write_position("P", plain=False)
    make.add_lines(f"SETE {name} ({make.rng.integers(1, 4)}) {make.rng.integers(-90000, 90000)}")
    make.add_move(name)


def _variable_summed(make: _MovedJobWriter) -> None:
    name = make.write_position("P", plain=False)
    make.add_lines(f"ADD {name} {make.write_amount()}")
    make.add_move(name)


def _raised_from_here(make: _MovedJobWriter) -> None:
    make.add_move(make.write_position())
    number = 90 + int(make.rng.integers(5))
    make.add_lines(f"GETS PX{number:03d} $PX001", f"ADD P{number:03d} {make.write_amount()}")
    make.add_move(f"P{number:03d}", "MOVL")


def _frame_made(make: _MovedJobWriter) -> None:
    if make.counts["P"] > 40:
        return
    points = [make.write_position("P", plain=False, frame="BASE") for _ in range(3)]
    make.add_lines("MFRAME UF#(3) " + " ".join(f"PX{point[1:]}" for point in points))
    make.add_move(make.write_position("C", plain=False, frame="3"))
    make.every_frame_holds = False


def _add_loop(make: _MovedJobWriter) -> None:
    label = len(make.lines)
    make.add_lines(f"CLEAR B{label:03d}", f"*L{label}")
    for _ in range(int(make.rng.integers(1, 3))):
        _pick_one(make, [_add_absolute_moves, _add_shift, _add_increment])(make)
    if make.rng.random() < 0.3:
        make.add_lines(f"SFTON {make.write_amount()} {_external_axes_text(make)}")
    make.add_lines(f"INC B{label:03d}", f"JUMP *L{label} IF B{label:03d}<2", "SFTOF")


def _add_silent_change(make: _MovedJobWriter) -> None:
    make.add_lines(
        _pick_one(make, ["'IMOV P000 V=1.0 RF", "COMM SFTON P000 BF", "TIMER T=1.00", "DOUT OT#(5) ON"])
    )


def _pick_one(make: _MovedJobWriter, choices):
    return choices[int(make.rng.integers(len(choices)))]


BLOCKS: list[Callable[[_MovedJobWriter], None]] = [
    _add_absolute_moves, _add_absolute_moves, _add_absolute_moves, _add_increment, _add_shift,
    _add_led_motion, _variable_computed, _variable_summed,
    _raised_from_here, _frame_made, _add_loop, _add_silent_change,
]  # fmt: skip


def generate_job(seed: int) -> JobCase:
    """Return one job with the move of its work: a third of the moves do not turn."""
    rng = np.random.default_rng([seed, 232])
    make = _MovedJobWriter(rng)
    _add_absolute_moves(make)
    for _ in range(int(rng.integers(2, 7))):
        _pick_one(make, BLOCKS)(make)
    rows = "\n".join([*make.rows["C"], *make.rows["P"]])
    text = (
        f"/JOB\n//NAME M{seed}\n//POS\n///NPOS {make.counts['C']},0,0,{make.counts['P']},0,0\n///TOOL 0\n{rows}\n"
        "//INST\n///DATE 2020/04/25 14:11\n///ATTR SC,RW\n///GROUP1 RB1\nNOP\n"
    ) + "\n".join([*make.lines, "END", ""])
    made = set() if make.every_frame_holds else {row_name(name) for name in _in_frame_3(text)}
    return JobCase(text, make.variables, _work_moves(rng), make.plain - made)


def _in_frame_3(text: str) -> set[str]:
    return {name for name, row in rows_of(text.partition("//INST")[0]).items() if row.frame == "3"}


def _work_moves(rng: np.random.Generator) -> np.ndarray:
    """Return how the work moves in the base: about its own place."""
    turn = np.zeros(3) if rng.random() < 0.33 else np.array([0, 0, rng.uniform(-0.4, 0.4)])
    if rng.random() < 0.3 and turn.any():
        turn = rng.uniform(-0.15, 0.15, 3)
    change, centre = np.eye(4), np.array([1.25, 0.0, 0.1])
    change[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    change[:3, 3] = centre - change[:3, :3] @ centre + rng.uniform(-0.06, 0.06, 3)
    return change
