"""The tags of a simulated cell once more, some of them left out: what if, of a finished run."""

import math
from collections.abc import Callable

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.points.tag_placement import PlacedTags
from cellcal.calibration.points.tag_points import TagPairs
from cellcal.calibration.points.tag_robot import LEAST_TAGS, SimulatedRobot
from cellcal.procedures.refit import (
    STANDS_OUT,
    FitPoint,
    FittedValue,
    Refit,
    RefitResult,
    Use,
    misses_in_space,
    pose_values,
)

_LEAST = {"three_points": 3, "six_points": 6, "least_squares": 3}


def refit_place(
    pairs: TagPairs, recorded: PlacedTags, sigma_m: float | None, place: Callable[[TagPairs], PlacedTags]
) -> Refit:
    """Return the tags of a base or a workpiece; ``sigma_m`` of a coordinate [m], None: the residuals tell."""

    def solve_place(use: Use) -> RefitResult:
        placed = place(_used_pairs(pairs, use))
        pose = placed.outer_inner
        inner = pairs.one.to_positions() @ pose.rotation_matrix().T + np.array(pose.position_m)
        gaps = inner - pairs.other.to_positions()
        misses = misses_in_space(gaps.tolist(), sigma_m or _scatter_m(gaps, use, 6), STANDS_OUT)
        return RefitResult(
            misses, placed.origin_uncertainty.expanded_uncertainty, pose_values(pose, recorded.outer_inner)
        )

    return Refit("place", _tag_points(pairs), _LEAST[recorded.method], "origin", solve_place)


def refit_robot(pairs: TagPairs, fit: Callable[[TagPairs], tuple[SimulatedRobot, RobotModel]]) -> Refit:
    """Return the tags of a robot's path; one that its robust fit does not believe stands out."""
    labels = [pairs.one.tag_label(row) for row in range(len(pairs.one))]

    def solve_robot(use: Use) -> RefitResult:
        found, arm = fit(_used_pairs(pairs, use))
        tip = np.array(found.flange_tool.position_m)
        device = found.device_base
        computed = arm.tip_positions(np.array(pairs.one.joints_rad), tip) @ device.rotation_matrix().T
        gaps = computed + np.array(device.position_m) - pairs.other.to_positions()
        believed = tuple(used and tag not in found.rejected for used, tag in zip(use, labels, strict=True))
        misses = misses_in_space(gaps.tolist(), _scatter_m(gaps, believed, len(found.values) + 9), STANDS_OUT)
        values = tuple(FittedValue(each.name, each.unit, each.value) for each in found.values)
        return RefitResult(misses, found.tool.expanded_uncertainty, values)

    return Refit("place", _tag_points(pairs), LEAST_TAGS, "tip", solve_robot)


def _tag_points(pairs: TagPairs) -> tuple[FitPoint, ...]:
    return tuple(
        FitPoint(make_message("tag {tag_label}", tag_label=pairs.one.tag_label(row)))
        for row in range(len(pairs.one))
    )


def _used_pairs(pairs: TagPairs, use: Use) -> TagPairs:
    rows = [row for row, used in enumerate(use) if used]
    return TagPairs(pairs.one.select_tags(rows), pairs.other.select_tags(rows), pairs.unpaired)


def _scatter_m(gaps_m: Array, use: Use, unknowns: int) -> float:
    """Return the deviation of a coordinate by the tags that took part (n, 3) [m]."""
    used = gaps_m[np.array(use)]
    return max(math.sqrt(float((used**2).sum()) / max(used.size - unknowns, 1)), 1e-9)
