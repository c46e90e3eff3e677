"""What a FANUC's arm does with a listing: an interpreter of its motions in plain numpy, apart from the drivers.

The tip in the base after every motion is returned, with the names of the positions that led it there. Registers are
those of the controller. A leader, a camera and a tool in the cell are poses that the interpreter makes up.
"""

import re
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

Matrix = np.ndarray
_RECORD = re.compile(r'P\[(\d+)(?::"[^"]*")?\]\{(.*?)\};', re.DOTALL)
_FIELD = re.compile(r"\b([XYZWPR]|J\d|E\d)\s*=\s*(-?[\d.]+)")
_MOVE = re.compile(r"^[JLC] (P|PR)\[(?:(\d+)|R\[(\d+)\])[^\]]*\](.*)$", re.DOTALL)
_VIA = re.compile(r":\s*P\[(\d+)[^\]]*\]")
_SET = re.compile(r"^PR\[(\d+)(?:,(\d))?[^\]]*\]=(.*)$")
LEADER = np.array([[0.0, -1, 0, 0.4], [1, 0, 0, -0.1], [0, 0, 1, 0.2], [0, 0, 0, 1]])
CAMERA = (12.0, -7.0, 0.0, 0.0, 0.0, 4.0)


@dataclass
class MotionEvent:
    """One motion: where the tip ends, and the positions that this depends on."""

    line: str
    base_tip: Matrix
    names: tuple[str, ...]


@dataclass
class FanucControllerState:
    """What the controller holds beside the program."""

    frames: dict[int, Matrix]
    registers: dict[int, tuple[float, ...]]
    numbers: dict[int, int] = field(default_factory=dict)


def pose_from_xyzwpr(values: tuple[float, ...]) -> Matrix:
    """Return the pose of X Y Z W P R in mm and degrees."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", values[3:], degrees=True).as_matrix()
    matrix[:3, 3] = np.array(values[:3]) * 1e-3
    return matrix


def values_of(matrix: Matrix) -> tuple[float, ...]:
    """Return X Y Z W P R of a pose."""
    angles = Rotation.from_matrix(matrix[:3, :3]).as_euler("xyz", degrees=True)
    return (*(matrix[:3, 3] * 1e3).tolist(), *angles.tolist())


class FanucInterpreter:
    """Executes one listing."""

    def __init__(self, text: str, controller: FanucControllerState) -> None:
        text = text.replace("\r\n", "\n")
        main, records = text.split("/MN\n")[1].split("/POS\n")
        self.lines = [
            re.sub(r"(\[\d+(?:,\d)?):[^\]]*\]", r"\1]", re.sub(r"^\s*\d+\s*:\s*", "", line)).strip()
            for line in re.sub(r"\n\s+:", " :", main).replace("//", "!").split(";\n")
        ]
        self.records: dict[int, tuple[int, tuple[float, ...]]] = {}
        for number, body in _RECORD.findall(records):
            frame = re.search(r"UF : (\d+|F)", body)
            fields = dict(_FIELD.findall(body.split("CONFIG")[-1]))
            if "X" in fields:
                values = tuple(float(fields[key]) for key in "XYZWPR")
                self.records[int(number)] = (-1 if frame[1] == "F" else int(frame[1]), values)
        self.controller = controller
        self.registers = {number: (list(values), ()) for number, values in controller.registers.items()}
        self.numbers = dict(controller.numbers)
        self.frame = 0
        self.condition = 0
        self.tool_condition = 0
        self.tip = np.eye(4)
        self.last: tuple[str, ...] = ()
        self.events: list[MotionEvent] = []

    def run(self) -> list[MotionEvent]:
        """Return the motions of the program."""
        labels = {line: at for at, line in enumerate(self.lines) if line.startswith("LBL[")}
        at, steps = 0, 0
        while at < len(self.lines) and steps < 500:
            line, steps = self.lines[at], steps + 1
            at += 1
            jump = re.match(r"IF R\[(\d+)\]<(\d+),JMP (LBL\[\d+\])", line)
            if jump:
                at = labels[jump[3]] if self.numbers.get(int(jump[1]), 0) < int(jump[2]) else at
            elif not line.startswith(("!", "--")):
                self._execute_line(line)
        return self.events

    def _execute_line(self, line: str) -> None:
        if count := re.match(r"R\[(\d+)\]=(?:R\[\d+\]\+)?(\d+)$", line):
            before = self.numbers.get(int(count[1]), 0) if "+" in line else 0
            self.numbers[int(count[1])] = before + int(count[2])
        elif frame := re.match(r"UFRAME_NUM=(\d+)", line):
            self.frame = int(frame[1])
        elif condition := re.match(r"(TOOL_)?OFFSET CONDITION PR\[(\d+)", line):
            if condition[1]:
                self.tool_condition = int(condition[2])
            else:
                self.condition = int(condition[2])
        elif assigned := _SET.match(line):
            self._assign_register(int(assigned[1]), assigned[2], assigned[3].strip())
        elif move := _MOVE.match(line):
            self._execute_move(line, move)

    def _read_value(self, text: str) -> tuple[list[float], tuple[str, ...]]:
        if text == "LPOS":
            in_frame = np.linalg.inv(self.controller.frames[self.frame]) @ self.tip
            return list(values_of(in_frame)), self.last
        kind, number = re.match(r"(PR?)\[(\d+)", text).groups()
        if kind == "P":
            return list(self.records[int(number)][1]), (f"P[{number}]",)
        return list(self.registers[int(number)][0]), self.registers[int(number)][1]

    def _assign_register(self, number: int, element: str | None, text: str) -> None:
        if element is not None:
            values, names = self.registers.get(number, ([0.0] * 6, ()))
            plus = re.match(r"PR\[\d+,\d\]([+-])([\d.]+)$", text)
            new = float(text) if plus is None else values[int(element) - 1] + float(plus[1] + plus[2])
            values[int(element) - 1] = new
            self.registers[number] = (values, names)
            return
        parts = re.split(r"(?<=[\]S])([+-])", text)
        values, names = self._read_value(parts[0])
        for sign, other in zip(parts[1::2], parts[2::2], strict=True):
            added, more = self._read_value(other)
            values = [a + float(sign + "1") * b for a, b in zip(values, added, strict=True)]
            names = (*names, *more)
        self.registers[number] = (values, names)

    def _execute_move(self, line: str, move: re.Match[str]) -> None:
        number = int(move[2]) if move[2] else self.numbers[int(move[3])]
        targets = [number, *map(int, _VIA.findall(move[4]))]
        for each in targets:
            if move[1] == "P":
                if each not in self.records:
                    continue
                frame, values = self.records[each]
                frame = self.frame if frame < 0 else frame
                names: tuple[str, ...] = (f"P[{each}]",)
            else:
                (values, names), frame = self.registers[each], self.frame
            self._move_to(line, self.controller.frames[frame], tuple(values), names)

    def _move_to(
        self, line: str, base_frame: Matrix, values: tuple[float, ...], names: tuple[str, ...]
    ) -> None:
        target = pose_from_xyzwpr(values)
        if re.search(r"\bINC\b", line):
            before = values_of(np.linalg.inv(base_frame) @ self.tip)
            target = pose_from_xyzwpr(tuple(a + b for a, b in zip(before, values, strict=True)))
        if offset := re.search(r"(?<![_A-Za-z])Offset(?:,PR\[(\d+))?", line):
            shift, more = self.registers[int(offset[1] or self.condition)]
            names = (*names, *more)
            turned = pose_from_xyzwpr((0.0, 0.0, 0.0, *shift[3:])) @ target
            turned[:3, 3] = target[:3, 3] + np.array(shift[:3]) * 1e-3
            target = turned
        if offset := re.search(r"Tool_Offset(?:,PR\[(\d+))?", line):
            target = target @ pose_from_xyzwpr(
                tuple(self.registers[int(offset[1] or self.tool_condition)][0])
            )
        if "VOFFSET" in line:
            target = pose_from_xyzwpr(CAMERA) @ target
        base_tip = base_frame @ target
        if re.search(r"\bCOORD\b", line):
            base_tip = LEADER @ target
        if re.search(r"\bRTCP\b", line):
            base_tip = LEADER @ np.linalg.inv(target)
        self.tip, self.last = base_tip, names
        self.events.append(MotionEvent(line, base_tip, names))
