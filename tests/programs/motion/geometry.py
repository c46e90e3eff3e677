"""Poses for the interpreters of motion: numpy and scipy only, nothing of the product."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
FAR_M, FAR_RAD = 5e-5, np.radians(0.02)  # rounding of a file's numbers stays below


@dataclass(frozen=True, eq=False)
class TipTarget:
    """Where one motion of a program goes."""

    line: int
    names: frozenset[str]  # of the variables that it uses, in small letters; "#7": it goes on from line 7
    base_tip: Array | None  # (4, 4) [m]; None where the motion is not a place in the base
    text: str = ""  # what it says instead: joints, or a pose that is seen from the flange


@dataclass
class NamedMisses:
    """What a changed program is said to miss."""

    lines: set[int] = field(default_factory=set)
    names: set[str] = field(default_factory=set)

    def names_motion(self, tip: TipTarget) -> bool:
        """Tell whether a motion is named by its line or by a variable that it uses."""
        return bool(
            {f"#{line}" for line in self.lines} & {f"#{tip.line}", *tip.names} or self.names & tip.names
        )


def pose_from(rotation: Rotation, place_m: object) -> Array:
    """Return (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.as_matrix()
    matrix[:3, 3] = np.asarray(place_m, dtype=float)
    return matrix


def pose_distance(one: Array, other: Array) -> tuple[float, float]:
    """Return distance [m] and angle [rad] of two poses."""
    turn = Rotation.from_matrix(one[:3, :3].T @ other[:3, :3]).magnitude()
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3])), float(turn)


def moved_wrongly(
    before: list[TipTarget], after: list[TipTarget], change: Array, named: NamedMisses
) -> list[str]:
    """Return the motions that the changed program does not take along with the work, and that nothing names."""
    if len(before) != len(after):
        return [f"{len(before)} motions became {len(after)}"]
    wrong = []
    for old, new in zip(before, after, strict=True):
        if old.base_tip is None or new.base_tip is None:
            if old.text != new.text:
                wrong.append(f"line {old.line}: {old.text} became {new.text}")
            continue
        far, turned = pose_distance(change @ old.base_tip, new.base_tip)
        if (far > FAR_M or turned > FAR_RAD) and not named.names_motion(old):
            wrong.append(f"line {old.line}: {far * 1e3:.3f} mm, {np.degrees(turned):.3f} deg, not named")
    return wrong


def unnamed_stops(before: list[TipTarget], named: NamedMisses) -> list[str]:
    """Return motions that are seen from the flange, or led, and that are not named as left."""
    return [
        f"line {tip.line}: {tip.text} not named"
        for tip in before
        if tip.base_tip is None and tip.text.startswith("led") and not named.names_motion(tip)
    ]
