"""What a Yaskawa's arm does with a job: an interpreter of its motions in plain numpy, apart from the drivers."""

import re
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tests.programs.fanuc_motion import LEADER, MotionEvent

Matrix = np.ndarray
_ROW = re.compile(r"(C|P)(\d+)=(.*)")


@dataclass
class StatedRow:
    """A row: the frame that it is stated in, and its numbers in mm and degrees."""

    frame: str
    values: tuple[float, ...]


def pose_from_xyzrxryrz(values: tuple[float, ...]) -> Matrix:
    """Return the pose of X Y Z Rx Ry Rz in mm and degrees."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", values[3:], degrees=True).as_matrix()
    matrix[:3, 3] = np.array(values[:3]) * 1e-3
    return matrix


def values_of(matrix: Matrix) -> tuple[float, ...]:
    """Return X Y Z Rx Ry Rz of a pose."""
    angles = Rotation.from_matrix(matrix[:3, :3]).as_euler("xyz", degrees=True)
    return (*(matrix[:3, 3] * 1e3).tolist(), *angles.tolist())


class YaskawaInterpreter:
    """Executes one job; ``frames`` are the user frames, ``variables`` those that no row states."""

    def __init__(self, text: str, frames: dict[int, Matrix], variables: dict[int, tuple[float, ...]]) -> None:
        head, body = text.split("//INST\n")
        self.frames, self.rows = dict(frames), rows_of(head)
        self.variables = {
            number: (StatedRow("BASE", values), (f"P{number:03d}",)) for number, values in variables.items()
        }
        self.variables |= {
            int(name[1:]): (row, (name,)) for name, row in self.rows.items() if name.startswith("P")
        }
        self.lines = [" ".join(line.split()) for line in body.split("\n")]
        self.counters: dict[str, int] = {}
        self.shift: tuple[StatedRow, str] | None = None
        self.tip = np.eye(4)
        self.last: tuple[str, ...] = ()
        self.events: list[MotionEvent] = []

    def run(self) -> list[MotionEvent]:
        """Return the motions of the job."""
        labels = {line: at for at, line in enumerate(self.lines) if line.startswith("*")}
        at, steps = 0, 0
        while at < len(self.lines) and steps < 500:
            line, steps = self.lines[at], steps + 1
            at += 1
            jump = re.match(r"JUMP (\*\w+) IF (B\d+)<(\d+)", line)
            if jump:
                at = labels[jump[1]] if self.counters.get(jump[2], 0) < int(jump[3]) else at
            elif not line.startswith(("'", "/", "*", "COMM")):
                self._execute_line(line)
        return self.events

    def _execute_line(self, line: str) -> None:
        word, _, rest = line.partition(" ")
        if word == "INC":
            self.counters[rest] = self.counters.get(rest, 0) + 1
        elif word == "CLEAR":
            self.counters[rest] = 0
        elif word == "SFTON":
            row, names = self.variables[int(re.search(r"P(\d+)", rest)[1])]
            self.shift = (StatedRow(re.search(r"BF|RF|TF|UF#\(\d+\)", rest)[0], row.values), names[0])
        elif word == "SFTOF":
            self.shift = None
        elif word == "GETS":
            number = int(re.search(r"PX(\d+)", rest)[1])
            self.variables[number] = (StatedRow("BASE", values_of(self.tip)), (*self.last, f"P{number:03d}"))
        elif word in ("SETE", "ADD"):
            self._compute_variable(word, rest)
        elif word == "MFRAME":
            self._make_frame(rest)
        elif "MOV" in word:
            self._execute_move(line, word, rest)

    def _compute_variable(self, word: str, rest: str) -> None:
        numbers = [int(each) for each in re.findall(r"P(\d+)", rest)]
        row, names = self.variables[numbers[0]]
        values = list(row.values)
        if word == "SETE":
            element, value = re.search(r"\((\d)\) (-?\d+)", rest).groups()
            values[int(element) - 1] = float(value) * 1e-3
        else:
            other, more = self.variables[numbers[1]]
            values, names = [a + b for a, b in zip(values, other.values, strict=True)], (*names, *more)
        self.variables[numbers[0]] = (StatedRow(row.frame, tuple(values)), names)

    def _make_frame(self, rest: str) -> None:
        number, *points = (int(each) for each in re.findall(r"(?:#\(|PX)(\d+)", rest))
        places = [self._row_pose(self.variables[point][0])[:3, 3] for point in points]
        x = (places[1] - places[0]) / np.linalg.norm(places[1] - places[0])
        z = np.cross(x, places[2] - places[0])
        z /= np.linalg.norm(z)
        self.frames[number] = np.eye(4)
        self.frames[number][:3, :3] = np.column_stack([x, np.cross(z, x), z])
        self.frames[number][:3, 3] = places[0]

    def _row_pose(self, row: StatedRow) -> Matrix:
        return self._frame_matrix(row.frame) @ pose_from_xyzrxryrz(row.values)

    def _frame_matrix(self, name: str) -> Matrix:
        found = re.search(r"\d+", name)
        return self.frames[int(found[0])] if found else np.eye(4)

    def _execute_move(self, line: str, word: str, rest: str) -> None:
        kind, number = re.match(r"(C|P)(\d+)", rest).groups()
        if kind == "C":
            row, names = self.rows[f"C{number}"], (f"C{number}",)
        else:
            row, names = self.variables[int(number)]
        if word == "IMOV":
            base_tip = self._add_amount(
                self.tip, StatedRow(re.search(r"BF|RF|TF|UF#\(\d+\)", rest)[0], row.values)
            )
            names = (*names, *self.last)
        else:
            base_tip = self._row_pose(row)
            if self.shift is not None:
                base_tip, names = self._add_amount(base_tip, self.shift[0]), (*names, self.shift[1])
        if word.startswith(("SMOV", "SYMOV", "EMOV")):
            base_tip = LEADER @ base_tip
        self.tip, self.last = base_tip, names
        self.events.append(MotionEvent(line, base_tip, names))

    def _add_amount(self, base_tip: Matrix, amount: StatedRow) -> Matrix:
        """Return a pose with an amount along the axes of a frame, or of the tool."""
        step = pose_from_xyzrxryrz(amount.values)
        if amount.frame == "TF":
            return base_tip @ step
        axes = self._frame_matrix(amount.frame)[:3, :3]
        new = np.eye(4)
        new[:3, :3] = axes @ step[:3, :3] @ axes.T @ base_tip[:3, :3]
        new[:3, 3] = base_tip[:3, 3] + axes @ step[:3, 3]
        return new


def rows_of(head: str) -> dict[str, StatedRow]:
    """Return the rows of a job by their names."""
    rows: dict[str, StatedRow] = {}
    frame, user = "", ""
    for line in head.split("\n"):
        if line.startswith("///USER"):
            user = line.split()[1]
        elif line.startswith("///POSTYPE"):
            frame = user if line.split()[1] == "USER" else line.split()[1]
        elif found := _ROW.match(line):
            rows[f"{found[1]}{found[2]}"] = StatedRow(frame, tuple(map(float, found[3].split(","))))
    return rows
