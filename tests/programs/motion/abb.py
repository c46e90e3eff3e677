"""RAPID programs of relative, led, shifted, array, held and mixed points, and what they do at the robot."""

import re
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from tests.programs.motion.geometry import Array, TipTarget, pose_from

_E = "[9E9,9E9,9E9,9E9,9E9,9E9]"
_FRAME = "[[0,0,0],[1,0,0,0]]"
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def generate(seed: int) -> dict[str, str]:
    """Return a module."""
    rng = np.random.default_rng([seed, 11])
    declarations = ["CONST num N_STANDS:=2;", "CONST num nUp:=60;"]
    declarations.append(
        f'PERS wobjdata wTab:=[FALSE,TRUE,"",[[{_millimetres_text(rng, 20)}],[{_quaternion_text(rng, 0.2)}]],{_FRAME}];'
    )
    declarations.append(f'PERS wobjdata wHeld:=[TRUE,TRUE,"",{_FRAME},{_FRAME}];')
    declarations.append(f'PERS wobjdata wBelt:=[FALSE,FALSE,"CNV1",{_FRAME},{_FRAME}];')
    declarations.append("PERS tooldata tGrip:=[TRUE,[[0,0,60],[1,0,0,0]],[1,[0,0,20],[1,0,0,0],0,0,0]];")
    declarations.append("PERS tooldata tStand:=[FALSE,[[500,0,300],[1,0,0,0]],[1,[0,0,20],[1,0,0,0],0,0,0]];")
    declarations.append("CONST jointtarget jHome:=[[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];")
    declarations += [f"PERS robtarget p{k}:={_robtarget_text(rng)};" for k in range(1, 5)]
    declarations.append(f"PERS robtarget pHeld:={_robtarget_text(rng)};")
    declarations.append(f"PERS robtarget pBelt:={_robtarget_text(rng)};")
    size = rng.choice(["N_STANDS", "2", "N_STANDS+0"])
    declarations.append(f"PERS robtarget pArr{{{size}}}:=[{_robtarget_text(rng)},{_robtarget_text(rng)}];")
    declarations.append(
        f'PERS station st{{2}}:=[["one",{_robtarget_text(rng)}],["two",{_robtarget_text(rng)}]];'
    )
    declarations.append("VAR robtarget pTmp;")
    body = [line for _ in range(int(rng.integers(3, 10))) for line in _statement_lines(rng)]
    sub = [line for _ in range(2) for line in _move_instruction(rng, "p4")]
    lines = [
        "MODULE GEN",
        *declarations,
        "PROC main()",
        *body,
        "ENDPROC",
        "PROC rSub()",
        *sub,
        "ENDPROC",
        "ENDMODULE",
        "",
    ]
    return {"gen.mod": "\n".join(lines)}


def _millimetres_text(rng: np.random.Generator, size: float) -> str:
    return ",".join(f"{value:.2f}" for value in rng.uniform(-size, size, 3))


def _quaternion_text(rng: np.random.Generator, size: float, like: tuple[float, ...] = (0, 0, 0, 1)) -> str:
    turn = Rotation.from_quat(like) * Rotation.from_rotvec(rng.uniform(-size, size, 3))
    x, y, z, w = turn.as_quat()
    return ",".join(f"{value:.7f}" for value in (w, x, y, z))


def _robtarget_text(rng: np.random.Generator) -> str:
    """Return a robtarget of an IRB 120 that holds tGrip, from joints well inside their quadrants."""
    signs = rng.choice([-1, 1], 3)
    q1, q4, q6 = signs * rng.uniform((12, 20, 20), (35, 60, 60))
    q2, q3, q5 = rng.uniform(-10, 20), rng.uniform(-15, 15), rng.uniform(35, 75)
    tip = _flange_of_irb120(np.radians([q1, q2, q3, q4, q5, q6])) @ pose_from(
        Rotation.identity(), (0, 0, 0.06)
    )
    x, y, z = tip[:3, 3] * 1e3
    a, b, c, d = Rotation.from_matrix(tip[:3, :3]).as_quat()
    quadrants = ",".join(str(int(np.floor(q / 90))) for q in (q1, q4, q6))
    return f"[[{x:.3f},{y:.3f},{z:.3f}],[{d:.7f},{a:.7f},{b:.7f},{c:.7f}],[{quadrants},0],{_E}]"


def _flange_of_irb120(joints: Array) -> Array:
    """Return the flange of an IRB 120, from its data sheet."""
    tip = np.eye(4)
    links = ((0, 0, 0.29), (0, 0, 0.27), (0, 0, 0.07), (0.302, 0, 0), (0.072, 0, 0), (0, 0, 0))
    for axis, angle, link in zip("zyyxyx", joints, links, strict=True):
        tip = (
            tip
            @ pose_from(Rotation.from_euler(axis, angle), (0, 0, 0))
            @ pose_from(Rotation.identity(), link)
        )
    return tip @ pose_from(Rotation.from_euler("y", np.pi / 2), (0, 0, 0))


def _case_lines(rng: np.random.Generator, name: str) -> str:
    return str(rng.choice([name, name.upper(), name.lower()]))


def _move_instruction(rng: np.random.Generator, target: str) -> list[str]:
    frame = {"p1": "", "p2": "\\WObj:=wTab", "p3": "\\WObj:=wobj0"}.get(target.lower(), "")
    frame = _case_lines(rng, frame) if frame else ""
    return [f"MoveL {_case_lines(rng, target)},v100,z1,{_case_lines(rng, 'tGrip')}{frame};"]


def _shift_text(rng: np.random.Generator) -> str:
    x, y, z = (int(value) for value in rng.integers(-40, 40, 3))
    return str(rng.choice([f"{x},{y},{z}", f"0,0,{abs(z)}", f"{x},0,0", "0,0,nUp"]))


def _statement_lines(rng: np.random.Generator) -> list[str]:  # noqa: PLR0911, PLR0912
    name = str(rng.choice(["p1", "p2", "p3", "p4"]))
    frame = "\\WObj:=wTab" if name == "p2" else ""
    kind = int(rng.integers(17))
    if kind == 0:
        return [f"MoveL Offs({_case_lines(rng, name)},{_shift_text(rng)}),v100,z1,tGrip{frame};"]
    if kind == 1:
        return [f"MoveL RelTool({name},{_shift_text(rng)}),v100,z1,tGrip{frame};"]
    if kind == 2:
        turn = _quaternion_text(rng, 0.2) if rng.random() < 0.5 else "1,0,0,0"
        moves = [*_move_instruction(rng, name), *(["rSub;"] if rng.random() < 0.4 else [])]
        end = ["PDispOff;"] if rng.random() < 0.8 else []
        return [f"PDispSet [[{_millimetres_text(rng, 30)}],[{turn}]];", *moves, *end]
    if kind == 3:
        axis = rng.choice(["x", "y", "z"])
        add = f"{name}.trans.{axis}{rng.choice(['+', '-'])}{int(rng.integers(5, 30))}"
        return [f"{_case_lines(rng, name)}.trans.{axis} := {add};", *_move_instruction(rng, name)]
    if kind == 4:
        return [f"{name}.trans.z := {int(rng.integers(300, 360))};", *_move_instruction(rng, name)]
    if kind == 5:
        return [f"pTmp := {name};", f"MoveL pTmp,v100,z1,tGrip{frame};"]
    if kind == 6:
        return [f"pTmp := Offs({name},{_shift_text(rng)});", f"MoveL pTmp,v100,z1,tGrip{frame};"]
    if kind == 7:
        return ["MoveAbsJ jHome,v100,z1,tGrip;"]
    if kind == 8:
        return ["FOR i FROM 1 TO 2 DO", "MoveL pArr{i},v100,z1,tGrip;", "ENDFOR"]
    if kind == 9:
        return [f"MoveL pArr{{{int(rng.integers(1, 3))}}},v100,z1,tGrip\\WObj:=WObj0;"]
    if kind == 10:
        return [f"MoveL st{{{int(rng.integers(1, 3))}}}.p,v100,z1,tGrip;"]
    if kind == 11:
        return ["MoveL pHeld,v100,z1,tStand\\WObj:=wHeld;"]
    if kind == 12:
        return ["MoveL pBelt,v100,z1,tGrip\\WObj:=wBelt;"]
    if kind == 13:
        return ["pTmp := CRobT(\\Tool:=tGrip);", f"MoveL Offs(pTmp,{_shift_text(rng)}),v100,z1,tGrip;"]
    if kind == 14:
        return [f"MoveJ {_robtarget_text(rng)},v100,z1,Tool0;"]
    if kind == 15:
        return [f"MoveL Offs({_robtarget_text(rng)},{_shift_text(rng)}),v100,z1,tGrip;"]
    return _move_instruction(rng, name)


@dataclass
class _RapidInterpreter:
    """A controller that goes through a module line by line."""

    lines: list[str]
    targets: dict[str, Array] = field(default_factory=dict)
    frames: dict[str, Array | None] = field(default_factory=lambda: {"wobj0": np.eye(4)})
    numbers: dict[str, float] = field(default_factory=dict)
    displaced: Array = field(default_factory=lambda: np.eye(4))
    tip: Array = field(default_factory=lambda: np.full((4, 4), np.nan))
    tips: list[TipTarget] = field(default_factory=list)
    origins: dict[str, set[str]] = field(default_factory=dict)  # names that a value comes from

    def run(self) -> list[TipTarget]:
        at = 0
        while not self.lines[at].startswith("PROC"):
            self._declare_name(at, self.lines[at])
            at += 1
        self._call_routine("main")
        return self.tips

    def _declare_name(self, at: int, line: str) -> None:
        found = re.match(r"(?:CONST|PERS|VAR) (\w+) (\w+)(?:\{[^}]*\})?(?::=(.*);)?$", line)
        if found is None or found[3] is None:
            return
        kind, name, value = found[1], found[2].lower(), found[3]
        self.origins[name] = {name, f"line {at + 1}"} if kind == "station" else {name}
        if kind == "num":
            self.numbers[name] = float(value)
        elif kind == "wobjdata":
            fixed = value.startswith("[FALSE,TRUE")
            numbers = _numbers_in(re.sub(r'"[^"]*"', "", value))
            self.frames[name] = (
                _pose_from_seven(numbers[:7]) @ _pose_from_seven(numbers[7:14]) if fixed else None
            )
        elif kind in ("robtarget", "station"):
            self._declare_targets(name, value, element=kind == "station" or value.startswith("[[["))

    def _declare_targets(self, name: str, value: str, *, element: bool) -> None:
        numbers = _numbers_in(re.sub(r'"[^"]*"', "", value))
        for k in range(len(numbers) // 17):
            self.targets[f"{name}{{{k + 1}}}" if element else name] = _pose_from_seven(
                numbers[17 * k : 17 * k + 7]
            )

    def _call_routine(self, name: str) -> None:
        begin = next(
            k for k, line in enumerate(self.lines) if line.lower().startswith(f"proc {name.lower()}(")
        )
        end = self.lines.index("ENDPROC", begin)
        at = begin + 1
        while at < end:
            at = self._execute_line(at)

    def _execute_line(self, at: int) -> int:
        line = self.lines[at]
        if line.startswith("FOR "):
            end = self.lines.index("ENDFOR", at)
            for number in (1, 2):
                for inner in range(at + 1, end):
                    self._execute_statement(inner, self.lines[inner].replace("{i}", f"{{{number}}}"))
            return end + 1
        self._execute_statement(at, line)
        return at + 1

    def _execute_statement(self, at: int, line: str) -> None:
        moved = re.match(r"Move([LJ]|AbsJ) (.*),v100,z1,(\w+)(?:\\WObj:=(\w+))?;", line, re.IGNORECASE)
        if moved is not None:
            self._execute_move(at, moved)
        elif line.startswith("PDispSet"):
            self.displaced = _pose_from_seven(_numbers_in(line))
        elif line.startswith("PDispOff"):
            self.displaced = np.eye(4)
        elif line == "rSub;":
            self._call_routine("rSub")
        else:
            self._assign_value(line)

    def _execute_move(self, at: int, moved: re.Match[str]) -> None:
        text, frame = moved[2], (moved[4] or "wobj0").lower()
        names = frozenset({*self._names_in(text), f"move{moved[1].lower()}@{at + 1}"})
        if moved[1].lower() == "absj":
            self.tips.append(TipTarget(at + 1, names, None, f"joints {text}"))
            self.tip = np.full((4, 4), np.nan)
            return
        base = self.frames[frame]
        if base is None:
            pose_text = np.array2string(self._evaluate(text), precision=5, suppress_small=True)
            self.tips.append(TipTarget(at + 1, names, None, f"led {text} {pose_text}"))
            self.tip = np.full((4, 4), np.nan)
            return
        self.tip = base @ self.displaced @ self._evaluate(text)
        if np.isnan(self.tip).any():
            self.tips.append(TipTarget(at + 1, names, None, f"on from joints {text}"))
        else:
            self.tips.append(TipTarget(at + 1, names, self.tip))

    def _names_in(self, text: str) -> set[str]:
        words = re.findall(r"[a-z]\w*(?:\{\d\})?", text.lower())
        return {one for word in words for one in (word, *self.origins.get(word.partition("{")[0], ()))}

    def _assign_value(self, line: str) -> None:
        component = re.match(
            r"(\w+)\.trans\.([xyz]) := (?:\w+\.trans\.[xyz]([+-]))?(\d+);", line, re.IGNORECASE
        )
        if component is not None:
            target = self.targets[component[1].lower()] = self.targets[component[1].lower()].copy()
            axis, value = "xyz".index(component[2]), float(component[4]) * 1e-3
            target[axis, 3] = (
                value if component[3] is None else target[axis, 3] + float(component[3] + "1") * value
            )
            return
        whole = re.match(r"(\w+) := (.*);", line)
        assert whole is not None, line
        self.targets[whole[1].lower()] = self._evaluate(whole[2])
        self.origins[whole[1].lower()] = self._names_in(whole[2])
        if whole[2].startswith("CRobT") and self.tips:
            self.origins[whole[1].lower()] = {*self.tips[-1].names, f"#{self.tips[-1].line}"}

    def _evaluate(self, text: str) -> Array:
        called = re.match(r"(Offs|RelTool)\((.*),([^,]+),([^,]+),([^,]+)\)$", text)
        if called is not None:
            shift = np.eye(4)
            shift[:3, 3] = [self._read_number(word) * 1e-3 for word in called.groups()[2:]]
            inner = self._evaluate(called[2])
            if called[1] == "Offs":
                return shift @ inner
            return inner @ shift
        if text.startswith("["):
            return _pose_from_seven(_numbers_in(text)[:7])
        if text.startswith("CRobT"):
            return (
                np.linalg.inv(self.displaced) @ self.tip
            )  # NaN behind joints, whose place is not the work's
        return self.targets[text.lower().removesuffix(".p")]

    def _read_number(self, word: str) -> float:
        return self.numbers[word.lower()] if word.isidentifier() else float(word)


def _numbers_in(text: str) -> list[float]:
    return [float(found) for found in _NUMBER.findall(text)]


def _pose_from_seven(seven: list[float]) -> Array:
    w, x, y, z = seven[3:7]
    return pose_from(Rotation.from_quat([x, y, z, w]), np.array(seven[:3]) * 1e-3)


def interpret(texts: dict[str, str]) -> list[TipTarget]:
    """Return where the motions of a module go."""
    return _RapidInterpreter(texts["gen.mod"].split("\n")).run()
