"""The tags of a simulated cell once more, some of them left out: what if, of a finished run."""

import math
from collections.abc import Callable

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.points.tag_placement import PlacedTags
from cellcal.calibration.points.tag_points import Pairs
from cellcal.calibration.points.tag_robot import LEAST_TAGS, SimulatedRobot
from cellcal.procedures.refit import (
    STANDS_OUT,
    FitPoint,
    Refit,
    Refitted,
    Use,
    Value,
    misses_in_space,
    pose_values,
)

_LEAST = {"three_points": 3, "six_points": 6, "least_squares": 3}


def refit_place(
    pairs: Pairs, recorded: PlacedTags, sigma_m: float | None, place: Callable[[Pairs], PlacedTags]
) -> Refit:
    """Return the tags of a base or a workpiece; ``sigma_m`` of a coordinate [m], None: the residuals tell."""

    def solve(use: Use) -> Refitted:
        placed = place(_fewer(pairs, use))
        pose = placed.outer_inner
        inner = pairs.one.positions() @ pose.rotation().T + np.array(pose.position_m)
        gaps = inner - pairs.other.positions()
        misses = misses_in_space(gaps.tolist(), sigma_m or _scatter_m(gaps, use, 6), STANDS_OUT)
        return Refitted(misses, placed.origin.expanded, pose_values(pose, recorded.outer_inner))

    return Refit("place", _tags(pairs), _LEAST[recorded.method], "origin", solve)


def refit_robot(pairs: Pairs, fit: Callable[[Pairs], tuple[SimulatedRobot, RobotModel]]) -> Refit:
    """Return the tags of a robot's path; one that its robust fit does not believe stands out."""
    labels = [pairs.one.label(row) for row in range(len(pairs.one))]

    def solve(use: Use) -> Refitted:
        found, arm = fit(_fewer(pairs, use))
        tip = np.array(found.flange_tool.position_m)
        device = found.device_base
        computed = arm.tip_positions(np.array(pairs.one.joints_rad), tip) @ device.rotation().T
        gaps = computed + np.array(device.position_m) - pairs.other.positions()
        believed = tuple(used and tag not in found.rejected for used, tag in zip(use, labels, strict=True))
        misses = misses_in_space(gaps.tolist(), _scatter_m(gaps, believed, len(found.values) + 9), STANDS_OUT)
        values = tuple(Value(each.name, each.unit, each.value) for each in found.values)
        return Refitted(misses, found.tool.expanded, values)

    return Refit("place", _tags(pairs), LEAST_TAGS, "tip", solve)


def _tags(pairs: Pairs) -> tuple[FitPoint, ...]:
    return tuple(FitPoint(f"tag {pairs.one.label(row)}") for row in range(len(pairs.one)))


def _fewer(pairs: Pairs, use: Use) -> Pairs:
    rows = [row for row, used in enumerate(use) if used]
    return Pairs(pairs.one.take(rows), pairs.other.take(rows), pairs.unpaired)


def _scatter_m(gaps_m: Array, use: Use, unknowns: int) -> float:
    """Return the deviation of a coordinate by the tags that took part (n, 3) [m]."""
    used = gaps_m[np.array(use)]
    return max(math.sqrt(float((used**2).sum()) / max(used.size - unknowns, 1)), 1e-9)
