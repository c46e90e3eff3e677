"""URScript programs of relative, shifted, listed, joint and mixed points, and what they do at the robot."""

import re
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from tests.programs.motion.geometry import Array, TipTarget, pose_from

_START = np.array([0.3, -1.4, 1.9, -2.0, -1.57, 0.1])
_DH = ((0, 0.089159, np.pi / 2), (-0.425, 0, 0), (-0.39225, 0, 0), (0, 0.10915, np.pi / 2),
       (0, 0.09465, -np.pi / 2), (0, 0.0823, 0))  # fmt: skip


def generate(seed: int) -> dict[str, str]:
    """Return a script."""
    rng = np.random.default_rng([seed, 14])
    lines = ["def gen():", "  set_tcp(p[0,0,0.05,0,0,0])", f"  movej([{_list_text(_START)}], a=1.4, v=1.05)"]
    lines += [f"  w{k} = {_point_text(rng)}" for k in (1, 2, 3)]
    lines.append(f"  feature = p[{_list_text(np.array([0.02, 0.01, -0.03, 0.1, 0, 0.2]))}]")
    lines.append("  up = p[0,0,0.04,0,0,0]")
    lines.append(f"  in_feature = {_point_text(rng)}")
    lines.append(f"  places = [{_point_text(rng)}, {_point_text(rng)}]")
    for _ in range(int(rng.integers(3, 10))):
        lines += [f"  {line}" for line in _statement_lines(rng)]
    return {"gen.script": "\n".join([*lines, "end", ""])}


def _list_text(values: Array) -> str:
    return ", ".join(f"{value:.6f}" for value in values)


def _point_text(rng: np.random.Generator) -> str:
    tip = np.eye(4)
    for angle, (a, d, alpha) in zip(_START + rng.uniform(-0.25, 0.25, 6), _DH, strict=True):
        turn = Rotation.from_euler("z", angle) * Rotation.from_euler("x", alpha)
        tip = tip @ pose_from(turn, (a * np.cos(angle), a * np.sin(angle), d))
    return f"p[{_list_text(_six_from_matrix(tip @ pose_from(Rotation.identity(), (0, 0, 0.05))))}]"


def _step_text(rng: np.random.Generator) -> str:
    x, y, z = rng.choice([0, 0, 1, -1], 3) * rng.uniform(0.01, 0.04, 3)
    return f"p[{x:.4f},{y:.4f},{z:.4f},0,0,0]"


def _statement_lines(rng: np.random.Generator) -> list[str]:
    point = f"w{int(rng.integers(1, 4))}"
    add = f"{rng.uniform(0.005, 0.03):.4f}"
    some = [
        [f"movel({point}, a=1.2, v=0.25)"],
        [f"movel({_point_text(rng)}, a=1.2, v=0.25)"],
        [f"movej([{_list_text(_START + rng.uniform(-0.2, 0.2, 6))}], a=1.4, v=1.05)"],
        [f"{point}[0] = {point}[0] + {add}", f"movel({point}, a=1.2, v=0.25)"],
        [f"{point}[{int(rng.integers(3))}] -= {add}", f"movel({point}, a=1.2, v=0.25)"],
        [f"{point}[2] = 0.3", f"movel({point}, a=1.2, v=0.25)"],
        [f"{point}[5] = {point}[5] + 0.02", f"movel({point}, a=1.2, v=0.25)"],
        [f"movel(pose_add({point}, {_step_text(rng)}), a=1.2, v=0.25)"],
        [f"movel(pose_add({point}, up), a=1.2, v=0.25)"],
        [f"over = pose_add({point}, {_step_text(rng)})", "movel(over, a=1.2, v=0.25)"],
        [f"over = pose_sub({point}, {_step_text(rng)})", "movel(over, a=1.2, v=0.25)"],
        [f"over = pose_trans({point}, {_step_text(rng)})", "movel(over, a=1.2, v=0.25)"],
        [f"movel(pose_trans({point}, up), a=1.2, v=0.25)"],
        ["movel(pose_trans(feature, in_feature), a=1.2, v=0.25)"],
        [f"movel(pose_trans({_step_text(rng)}, {point}), a=1.2, v=0.25)"],
        [f"movel(pose_trans({_step_text(rng)}, {_point_text(rng)}), a=1.2, v=0.25)"],
        [f"movel(places[{int(rng.integers(2))}], a=1.2, v=0.25)"],
        [f"movel(pose_add(get_actual_tcp_pose(), {_step_text(rng)}), a=1.2, v=0.25)"],
        [f"movel(pose_trans(get_actual_tcp_pose(), {_step_text(rng)}), a=1.2, v=0.25)"],
        ["here = get_actual_tcp_pose()", f"here[1] = here[1] + {add}", "movel(here, a=1.2, v=0.25)"],
        ["here = get_actual_tcp_pose()", "here[2] = 0.35", "movel(here, a=1.2, v=0.25)"],
        [f"between = interpolate_pose({point}, w1, 0.5)", "movel(between, a=1.2, v=0.25)"],
        [f"made = p[{point}[0], {point}[1], {point}[2] + {add}, {point}[3], {point}[4], {point}[5]]",
         "movel(made, a=1.2, v=0.25)"],
        [f"movel(p[{point}[0], {point}[1], 0.3, {point}[3], {point}[4], {point}[5]], a=1.2, v=0.25)"],
        [f"copy = {point}", f"copy[2] = copy[2] + {add}", "movel(copy, a=1.2, v=0.25)"],
        [f"copy = {point}", "movel(copy, a=1.2, v=0.25)"],
    ]  # fmt: skip
    return some[int(rng.integers(len(some)))]


@dataclass
class _ScriptInterpreter:
    """A controller that goes through a script line by line."""

    values: dict[str, Array | list[Array]] = field(default_factory=dict)
    origins: dict[str, set[str]] = field(default_factory=dict)
    tip: Array = field(default_factory=lambda: np.full(6, np.nan))
    chain: set[str] = field(default_factory=set)
    tips: list[TipTarget] = field(default_factory=list)

    def run(self, lines: list[str]) -> list[TipTarget]:
        for at, line in enumerate(lines):
            self._execute_statement(at, line.strip())
        return self.tips

    def _execute_statement(self, at: int, line: str) -> None:
        moved = re.match(r"move([lj])\((.*), a=[\d.]+, v=[\d.]+\)$", line)
        element = re.match(r"(\w+)\[(\d)\] (=|-=) (.*)$", line)
        assignment = re.match(r"(\w+) = (.*)$", line)
        if moved is not None:
            self._execute_move(at, moved[2])
        elif element is not None:
            old = self.values[element[1]]
            assert isinstance(old, np.ndarray)
            new, index = old.copy(), int(element[2])
            value = self._read_number(element[4])
            new[index] = value if element[3] == "=" else new[index] - value
            self.values[element[1]] = new
        elif assignment is not None:
            names = {assignment[1], *self._names_in(assignment[2])}
            self.values[assignment[1]] = (
                self._read_list(assignment[2])
                if assignment[2].startswith("[")
                else self._evaluate(assignment[2])
            )
            self.origins[assignment[1]] = {*names, f"#{at + 1}"}

    def _execute_move(self, at: int, text: str) -> None:
        names = frozenset({*self._names_in(text), f"line {at + 1}"})
        self.chain = {*names, f"#{at + 1}"}
        if text.startswith("["):
            self.tips.append(TipTarget(at + 1, names, None, f"joints {text}"))
            self.tip = np.full(6, np.nan)
            return
        self.tip = self._evaluate(text)
        if np.isnan(self.tip).any():
            self.tips.append(TipTarget(at + 1, names, None, f"on from joints {text}"))
        else:
            self.tips.append(TipTarget(at + 1, names, _matrix_from_six(self.tip)))

    def _names_in(self, text: str) -> set[str]:
        found = {
            one for word in re.findall(r"[a-z_]\w*", text) for one in (word, *self.origins.get(word, ()))
        }
        return found | self.chain if "get_actual" in text else found

    def _read_list(self, text: str) -> list[Array]:
        return [self._evaluate(one) for one in re.findall(r"p\[[^\]]*\]", text)]

    def _evaluate(self, text: str) -> Array:
        called = re.match(r"(pose_add|pose_sub|pose_trans|interpolate_pose)\((.*)\)$", text)
        if called is not None:
            one, other, *rest = (self._evaluate(part) for part in _split_arguments(called[2]))
            return _call_function(called[1], one, other, float(rest[0][0]) if rest else 0.0)
        if text == "get_actual_tcp_pose()":
            return self.tip
        if text.startswith("p["):
            return np.array([self._read_number(part) for part in _split_arguments(text[2:-1])])
        indexed = re.match(r"(\w+)\[(\d)\]$", text)
        if indexed is not None:
            return np.asarray(self.values[indexed[1]][int(indexed[2])])
        if text in self.values:
            return np.asarray(self.values[text])
        return np.array([float(text)])

    def _read_number(self, text: str) -> float:
        terms = re.split(r" \+ ", text.strip())
        return sum(float(self._evaluate(term).reshape(-1)[0]) for term in terms)


def _split_arguments(text: str) -> list[str]:
    """Return arguments: cut at commas outside all brackets."""
    parts, depth = [""], 0
    for sign in text:
        depth += (sign in "([") - (sign in ")]")
        if sign == "," and not depth:
            parts.append("")
        else:
            parts[-1] += sign
    return [part.strip() for part in parts]


def _call_function(function: str, one: Array, other: Array, share: float) -> Array:
    if function == "pose_trans":
        return _six_from_matrix(_matrix_from_six(one) @ _matrix_from_six(other))
    if np.isnan([one, other]).any():
        return np.full(6, np.nan)
    turns = Rotation.from_rotvec([one[3:], other[3:]])
    if function == "interpolate_pose":
        turn = turns[0] * Rotation.from_rotvec(share * (turns[0].inv() * turns[1]).as_rotvec())
        return np.hstack([one[:3] + share * (other[:3] - one[:3]), turn.as_rotvec()])
    turn = turns[0] * (turns[1] if function == "pose_add" else turns[1].inv())
    place = one[:3] + other[:3] if function == "pose_add" else one[:3] - other[:3]
    return np.hstack([place, turn.as_rotvec()])


def _matrix_from_six(six: Array) -> Array:
    if np.isnan(six).any():
        return np.full((4, 4), np.nan)
    return pose_from(Rotation.from_rotvec(six[3:]), six[:3])


def _six_from_matrix(matrix: Array) -> Array:
    if np.isnan(matrix).any():
        return np.full(6, np.nan)
    return np.hstack([matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]).as_rotvec()])


def interpret(texts: dict[str, str]) -> list[TipTarget]:
    """Return where the motions of a script go."""
    return _ScriptInterpreter().run(texts["gen.script"].split("\n"))
