"""KRL programs and data lists of relative, led, shifted, array, external-tool and mixed points, and what they do."""

import re
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from tests.programs.motion.geometry import Array, TipTarget, pose_from

_FIELD = re.compile(r"\b(A[1-6]|[XYZABCE]\d?) ([-+]?[\d.]+)")
TOOL = pose_from(Rotation.identity(), (0, 0, 0.08))
BASES = {
    "1": pose_from(Rotation.from_euler("ZYX", (0.3, 0.0, 0.0)), (0.05, 0.02, 0.03)),
    "2": pose_from(Rotation.from_euler("ZYX", (-0.2, 0.05, 0.1)), (0.0, -0.03, 0.02)),
}


def generate(seed: int) -> dict[str, str]:
    """Return a data list and its program."""
    rng = np.random.default_rng([seed, 13])
    data = ["DEFDAT GEN PUBLIC", "DECL E6AXIS XHOME={A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0,E1 0}"]
    for k in (1, 2, 3):
        data.append(f"DECL E6POS XP{k}={_point_text(rng, '1')}")
        if k < 3:
            data.append(f"DECL FDAT FP{k}={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE}}")
    data.append("DECL E6POS P[2]")
    data += [f"P[{k}]={_point_text(rng, '1')}" for k in (1, 2)]
    data.append(f"DECL FRAME F1={_point_text(rng, '1').partition(',S')[0]}}}")
    data.append(f"DECL STATION S1={{PLACE {_point_text(rng, '1')},SPEED 1}}")
    body = [line for _ in range(int(rng.integers(3, 10))) for line in _statement_lines(rng)]
    head = [
        "&ACCESS RVP",
        "DEF GEN()",
        "DECL E6POS XH",
        "DECL INT I",
        "$BASE = BASE_DATA[1]",
        "$TOOL = TOOL_DATA[1]",
    ]
    if seed % 17 == 0:
        head.append("$IPO_MODE = #TCP")
    program = [*head, *body, "END", ""]
    return {"gen.dat": "\n".join([*data, "ENDDAT", ""]), "gen.src": "\n".join(program)}


def _point_text(rng: np.random.Generator, base: str) -> str:
    a1, a4, a6 = rng.choice([-1, 1], 3) * rng.uniform((12, 20, 20), (40, 60, 60))
    a2, a3, a5 = rng.uniform(-100, -70), rng.uniform(75, 105), rng.uniform(30, 65)
    angles = (a1, a2, a3, a4, a5, a6)
    tip = np.linalg.inv(BASES[base]) @ _flange_of_kr6(np.radians(angles)) @ TOOL
    x, y, z = tip[:3, 3] * 1e3
    a, b, c = Rotation.from_matrix(tip[:3, :3]).as_euler("ZYX", degrees=True)
    turn = sum((angle < 0) << k for k, angle in enumerate(angles))
    return f"{{X {x:.3f},Y {y:.3f},Z {z:.3f},A {a:.4f},B {b:.4f},C {c:.4f},S 2,T {turn},E1 0.0,E2 0.0}}"


def _flange_of_kr6(angles: Array) -> Array:
    """Return the flange of a KR 6 R900, from its data sheet."""
    tip = pose_from(Rotation.identity(), (0, 0, 0.4))
    signs, axes = (-1, 1, 1, -1, 1, -1), "zyyxyx"
    links = ((0.025, 0, 0), (0.455, 0, 0), (0.42, 0, 0.035), (0, 0, 0), (0.08, 0, 0), (0, 0, 0))
    for axis, sign, angle, link in zip(axes, signs, angles, links, strict=True):
        tip = (
            tip
            @ pose_from(Rotation.from_euler(axis, sign * angle), (0, 0, 0))
            @ pose_from(Rotation.identity(), link)
        )
    return tip @ pose_from(Rotation.from_euler("y", np.pi / 2), (0, 0, 0))


def _frame_text(rng: np.random.Generator) -> str:
    x, y, z = rng.integers(-30, 30, 3)
    turn = rng.choice([0, 0, 5])
    return f"{{X {x},Y {y},Z {z},A {turn},B 0,C 0}}"


def _statement_lines(rng: np.random.Generator) -> list[str]:
    point = f"XP{int(rng.integers(1, 4))}"
    linear = str(rng.choice(["LIN", "lin", "SLIN"]))
    add = int(rng.integers(5, 25))
    x, y, z = rng.integers(-30, 30, 3)
    some = [
        [f"{linear} {point}"],
        [f"{linear} {point.lower()} C_DIS"],
        [f"LIN {_point_text(rng, '1')}"],
        ["PTP {A1 0,A2 -90,A3 90,A4 0,A5 20,A6 0}"],
        [f"LIN_REL {{X {x},Y {y},Z {z}}}{rng.choice(['', ' #BASE', ' #TOOL', ' C_DIS'])}"],
        [f"LIN_REL {{Z {add}}}"],
        [f"LIN {point}:{{X 0,Y {y},Z -50,A 0,B 0,C 0}}"],
        [f"LIN {_frame_text(rng)}:{point}"],
        [f"XH = {point}", f"XH.X = XH.X + {add}", "LIN XH"],
        [f"XH={point}", "XH.z = 900", "LIN XH"],
        [f"XH = {_frame_text(rng)}:{point}", "LIN XH"],
        ["LIN P[1]"],
        ["FOR I=1 TO 2", "LIN P[I]", "ENDFOR"],
        ["LIN F1"],
        ["LIN S1.PLACE"],
        ["PTP_REL {A1 5}"],
        ["PTP XHOME"],
        [f"{point}.Y = {point}.Y - {add}", f"LIN {point}"],
        ["LIN {Z 700}"],
        ["$Base = BASE_DATA[2]", f"LIN {_point_text(rng, '2')}", "$BASE = BASE_DATA[1]"],
        [f"XH = {point}:{{Z -{add}}}", "LIN XH"],
    ]
    weights = np.array([1.0] * (len(some) - 2) + [0.25, 1.0])
    return some[int(rng.choice(len(some), p=weights / weights.sum()))]


@dataclass
class _KrlInterpreter:
    """A controller that goes through a program line by line."""

    values: dict[str, dict[str, float]] = field(default_factory=dict)  # coordinates by name
    origins: dict[str, set[str]] = field(default_factory=dict)
    base: Array = field(default_factory=lambda: BASES["1"])
    led: bool = False
    tip: Array = field(default_factory=lambda: np.full((4, 4), np.nan))
    chain: set[str] = field(default_factory=set)
    tips: list[TipTarget] = field(default_factory=list)

    def declare_line(self, at: int, line: str) -> None:
        found = re.match(r"(?:DECL \w+ )?([\w\[\]]+)=\{(?:PLACE (\{))?(.*)", line)
        if found is None or "FDAT" in line:
            return
        name = found[1].lower() + (".place" if found[2] else "")
        self.values[name] = _read_fields(found[3])
        self.origins[name] = {found[1].lower(), f"line {at + 1}"} if found[2] else {name}

    def run(self, lines: list[str]) -> list[TipTarget]:
        at = 0
        while at < len(lines):
            if lines[at].startswith("FOR "):
                for number in (1, 2):
                    self._execute_statement(at + 1, lines[at + 1].replace("[I]", f"[{number}]"))
                at += 3
                continue
            self._execute_statement(at, lines[at])
            at += 1
        return self.tips

    def _execute_statement(self, at: int, line: str) -> None:
        moved = re.match(r"(S?LIN|PTP)(_REL)? (.*?)( C_DIS| #BASE| #TOOL)?$", line, re.IGNORECASE)
        based = re.match(r"\$BASE = BASE_DATA\[(\d)\]", line, re.IGNORECASE)
        if moved is not None:
            self._execute_move(
                at, moved[1].upper(), moved[3], relative=bool(moved[2]), of_tool=moved[4] == " #TOOL"
            )
        elif based is not None:
            self.base = BASES[based[1]]
        elif line.startswith("$IPO_MODE"):
            self.led = True
        elif "=" in line and line[0] != "$":
            self._assign_value(line)

    def _execute_move(self, at: int, word: str, text: str, *, relative: bool, of_tool: bool) -> None:
        names = self._names_in(text) | {f"{word.lower()}@{at + 1}", f"{word.lower()}_rel@{at + 1}"}
        if relative or re.match(r"\{Z [^,]*\}$", text):
            names |= self.chain
        self.chain = names | {f"#{at + 1}"}
        fields = _read_fields(text) if text.startswith("{") and ":" not in text else {}
        if text == "XHOME" or "A1" in fields:
            self.tips.append(
                TipTarget(at + 1, frozenset(names), None, f"{'on by ' if relative else ''}joints {text}")
            )
            self.tip = np.full((4, 4), np.nan)
            return
        if self.led and relative:
            self.tips.append(TipTarget(at + 1, frozenset(names), None, f"on from a held work {text}"))
            return
        if self.led:
            self.tips.append(
                TipTarget(at + 1, frozenset(names), None, f"led {text} {self._describe_target(text, fields)}")
            )
            return
        self.tip = self._goal_pose(text, fields, relative=relative, of_tool=of_tool)
        if np.isnan(self.tip).any():
            self.tips.append(TipTarget(at + 1, frozenset(names), None, f"on from joints {text}"))
        else:
            self.tips.append(TipTarget(at + 1, frozenset(names), self.tip))

    def _goal_pose(self, text: str, fields: dict[str, float], *, relative: bool, of_tool: bool) -> Array:
        if relative and of_tool:
            return self.tip @ _pose_from_fields(fields)
        if relative:
            there = np.linalg.inv(self.base) @ self.tip
            there[:3, 3] += _pose_from_fields(fields)[:3, 3]
            return self.base @ there
        if fields and "X" not in fields:  # the rest stays as it is
            there = np.linalg.inv(self.base) @ self.tip
            there[2, 3] = fields["Z"] * 1e-3
            return self.base @ there
        return self.base @ self._evaluate(text)

    def _describe_target(self, text: str, fields: dict[str, float]) -> str:
        return str(fields or np.round(self._evaluate(text), 6).tolist())

    def _assign_value(self, line: str) -> None:
        component = re.match(r"(\w+)\.([XYZ]) = (?:\w+\.[XYZ] ([+-]) )?(\d+)$", line, re.IGNORECASE)
        if component is not None:
            name, axis, value = component[1].lower(), component[2].upper(), float(component[4])
            old = dict(self.values[name])
            old[axis] = value if component[3] is None else old[axis] + float(component[3] + "1") * value
            self.values[name] = old
            return
        name, _, text = line.partition("=")
        self.origins[name.strip().lower()] = self._names_in(text.strip())
        self.values[name.strip().lower()] = _fields_of(self._evaluate(text.strip()))

    def _names_in(self, text: str) -> set[str]:
        words = re.findall(r"[a-z]\w*(?:\[\d\])?(?:\.place)?", re.sub(r"\{[^}]*\}", "", text.lower()))
        return {one for word in words for one in (word, *self.origins.get(word, ()))}

    def _evaluate(self, text: str) -> Array:
        parts = re.findall(r"\{[^}]*\}|[^:{}]+", text)
        found = np.eye(4)
        for part in parts:
            found = found @ _pose_from_fields(
                _read_fields(part) if part[0] == "{" else self.values[part.strip().lower()]
            )
        return found


def _read_fields(text: str) -> dict[str, float]:
    return {name: float(number) for name, number in _FIELD.findall(text)}


def _pose_from_fields(fields: dict[str, float]) -> Array:
    angles = [fields.get(name, 0.0) for name in "ABC"]
    place = np.array([fields.get(name, 0.0) for name in "XYZ"]) * 1e-3
    return pose_from(Rotation.from_euler("ZYX", angles, degrees=True), place)


def _fields_of(matrix: Array) -> dict[str, float]:
    angles = Rotation.from_matrix(matrix[:3, :3]).as_euler("ZYX", degrees=True)
    return dict(zip("XYZABC", (*(matrix[:3, 3] * 1e3).tolist(), *angles.tolist()), strict=True))


def interpret(texts: dict[str, str]) -> list[TipTarget]:
    """Return where the motions of a program go."""
    robot = _KrlInterpreter()
    for at, line in enumerate(texts["gen.dat"].split("\n")):
        robot.declare_line(at, line)
    return robot.run(texts["gen.src"].split("\n"))
