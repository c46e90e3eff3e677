"""Our solvers on the shipped reference problems: evidence for readers who did not write them.

Each problem is solved as it stands, in another unit of length, in a turned and shifted world, and with its rows in
another order. The answers come from ``calibration/reference_data``, where an independent solver put them.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

import numpy as np

from cellcal.calibration.geometry import Array, exp_rotation, homogeneous_matrix
from cellcal.calibration.reference_data import load_reference, reference_names
from cellcal.service.engineering.bench.reference_solvers import SOLVERS, Given

UNIT = 3.280839895013123  # feet: an arm in millimetres is refused
WORLD = homogeneous_matrix(exp_rotation(np.array([0.4, -1.9, 1.2])), np.array([2.5, -1.5, 0.7]))

Answers: TypeAlias = dict[str, Array]


@dataclass(frozen=True, slots=True)
class ProblemForm:
    """A way to pose a problem otherwise without changing it.

    ``base`` names what is given or answered in the base frame, and moves with the world; ``rows`` names what
    changes places together, ``along`` the axis where that is not the first.
    """

    base: tuple[str, ...] = ()
    rows: tuple[str, ...] = ()
    along: tuple[tuple[str, int], ...] = ()


FORMS: dict[str, ProblemForm] = {
    "plane": ProblemForm(base=("base", "above_m", "foot_m"), rows=("joints_rad",)),
    "frame": ProblemForm(
        base=(
            "three_points_m", "six_points_m", "three_point_frame", "six_point_frame",
            "base_frame", "base_frame_moved", "base_fixture",
        ),
    ),
    "registration": ProblemForm(base=("target_m", "target_source"), rows=("source_m", "target_m")),
    "tool_point": ProblemForm(base=("touches", "pin_in_base_m"), rows=("touches",)),
    "dh": ProblemForm(rows=("joints_rad", "flanges")),
    "compensation": ProblemForm(rows=("joints_rad",)),
    "turn_loss": ProblemForm(rows=("metres_per_turn_m", "lengths_m")),
    "fixture": ProblemForm(
        base=("stations_m", "points_in_base_m", "base_fixture"), rows=("stations_m",), along=(("lengths_m", 1),)
    ),
}  # fmt: skip
# What a problem's base frame does to other answers: Eq. 9 and 11 hold the first robot's base on the right.
_FROM_THE_BASE = {"frame": ("other_base_base",)}


@dataclass(frozen=True, slots=True)
class ReferenceComparison:
    """One answer beside the reference: the largest difference of its numbers, and what is allowed."""

    problem: str
    posed: str  # as given | in millimetres | in another world | in another order
    answer: str
    numbers: int
    difference: float  # in the units of the answer; of lengths in the unit of the problem
    tolerance: float

    @property
    def passed(self) -> bool:
        """Whether it agrees; a number that is not finite never does."""
        return bool(self.difference <= self.tolerance)


def check_all() -> tuple[ReferenceComparison, ...]:
    """Solve every shipped problem in every form."""
    return tuple(each for name in reference_names() for each in check_problem(load_reference(name), name))


def as_document(found: tuple[ReferenceComparison, ...]) -> dict[str, object]:
    """Return one JSON object with every comparison."""
    rows = [
        {
            **asdict(each),
            "difference": each.difference if np.isfinite(each.difference) else None,
            "passed": each.passed,
        }
        for each in found
    ]
    return {"passed": all(each.passed for each in found), "comparisons": rows}


def check_problem(document: Mapping[str, Any], name: str) -> Iterator[ReferenceComparison]:
    """Solve one problem in every form, and compare each answer with the reference."""
    givens = {key: np.array(value, dtype=float) for key, value in document["given"].items()}
    answers = {key: np.array(value, dtype=float) for key, value in document["answers"].items()}
    tolerance = float(document["tolerance"])
    for posed, change in _CHANGES.items():
        changed = change(name, givens, answers)
        if changed is None:
            continue
        found = SOLVERS[name](changed[0])
        for key, expected in changed[1].items():
            # Where lengths are a thousand times as large, so is what their rounding leaves.
            scale = UNIT if posed == "in millimetres" else 1.0
            allowed = np.where(_length_mask(key, expected), scale, 1.0) * tolerance
            shares = np.abs(np.asarray(found[key], dtype=float) - expected) / allowed
            largest = float(shares.max()) if np.isfinite(shares).all() else float("inf")
            at = np.unravel_index(int(shares.argmax()), shares.shape)
            limit = float(allowed[at])
            yield ReferenceComparison(name, posed, key, expected.size, largest * limit, limit)


def _unchanged(name: str, givens: Given, answers: Answers) -> tuple[Given, Answers]:
    return givens, answers


def _in_millimetres(name: str, givens: Given, answers: Answers) -> tuple[Given, Answers]:
    scaled = [
        {key: np.where(_length_mask(key, value), value * UNIT, value) for key, value in part.items()}
        for part in (givens, answers)
    ]
    return scaled[0], scaled[1]


def _in_another_world(name: str, givens: Given, answers: Answers) -> tuple[Given, Answers] | None:
    form = FORMS[name]
    if not form.base:
        return None
    carried = [
        {key: _move_with_world(value) if key in form.base else value for key, value in part.items()}
        for part in (givens, answers)
    ]
    for key in _FROM_THE_BASE.get(name, ()):
        carried[1][key] = answers[key] @ np.linalg.inv(WORLD)
    return carried[0], carried[1]


def _in_another_order(name: str, givens: Given, answers: Answers) -> tuple[Given, Answers] | None:
    form = FORMS[name]
    if not form.rows:
        return None
    axes = {**dict.fromkeys(form.rows, 0), **dict(form.along)}
    mixed = [
        {key: np.flip(value, axes[key]) if key in axes else value for key, value in part.items()}
        for part in (givens, answers)
    ]
    return mixed[0], mixed[1]


_CHANGES: dict[str, Callable[[str, Given, Answers], tuple[Given, Answers] | None]] = {
    "as given": _unchanged,
    "in millimetres": _in_millimetres,
    "in another world": _in_another_world,
    "in another order": _in_another_order,
}


def _move_with_world(value: Array) -> Array:
    """Move points (…, 3) or poses (…, 4, 4) with the world."""
    is_pose = value.shape[-2:] == (4, 4)
    moved: Array = WORLD @ value if is_pose else value @ WORLD[:3, :3].T + WORLD[:3, 3]
    return moved


def _length_mask(key: str, value: Array) -> Array:
    """Return which of the numbers are lengths: by name, in poses the last column, in DH rows d and a."""
    mask = np.zeros(value.shape, dtype=bool)
    if key.endswith("_m"):
        mask[...] = True
    elif value.shape[-2:] == (4, 4):
        mask[..., :3, 3] = True
    elif key in ("rows", "nominal", "real"):
        mask[:, 1:3] = True
    return mask
