"""Whether a cell's arm can go to a program's points, and how far from the truth it will then be."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_kinds import beyond_limits, shown_units
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.programs.transfer import smallest_sigma, tip_poses
from cellcal.drivers.program_registry import brand_named
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.cell_of_program import (
    bring_their_own,
    find_contradiction,
    frame_of,
    missing_reason,
    refuse_foreign,
    tool_of,
)
from cellcal.service.engineering.programs.expected_accuracy import Expectation, TransferEnds
from cellcal.service.engineering.programs.external.carried_points import AxisEnd, carry_points
from cellcal.service.engineering.programs.other_postures import OtherPostureSearch
from cellcal.service.engineering.programs.postures import PostureSearch, applied_rule, posture_search
from cellcal.service.engineering.programs.program_points import (
    PointGroup,
    ProgramPoints,
    groups_of,
    points_of,
)
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_poses import ProjectTool
from cellcal.service.engineering.programs.project_pulses import read_for_robot

Search: TypeAlias = PostureSearch | OtherPostureSearch
_ROUNDED_RAD = 1e-6  # a joint may be taught at its limit


@dataclass(frozen=True, eq=False)
class ProgramReach:
    """N points of a program in a cell; NaN where unknown."""

    joints_rad: Array  # (N, n) that the controller computes
    base_place_m: Array  # (N, 3) where the controller believes the tip to be
    why: tuple[str, ...]  # (N,) what is wrong with a point, or why it cannot be told; "" where nothing is
    failed: NDArray[np.bool_]  # (N,) the arm cannot go there; what cannot be told is no failure
    miss_m: (
        Array  # (N,) how far the real tip is from where the controller believes it, by the identified model
    )
    expected_m: Array  # (N,) k = 2, how surely the identified model knows the real tip
    shown_per_joint: (
        Array  # (n,) what joints are multiplied with to be shown in degrees, or mm where they slide
    )


def reach_of(programs: Sequence[ProgramFile], cell: Project) -> tuple[ProgramReach, ...]:
    """Return what a cell's arm makes of programs of one brand.

    Raises
    ------
    CellError
        A program of another robot, or in another unit.
    """
    programs = read_for_robot(programs, cell.pulses_per_rad, cell.control_group)
    for program in programs:
        refuse_foreign(program, cell)
    axes = cell.nominal.axis_count
    points = points_of(programs, cell)
    rule = brand_named(programs[0].brand).configurations
    search = posture_search(cell, rule)
    rule = applied_rule(cell, rule)
    found = _ReachColumns.make_empty(len(points), axes)
    for group in groups_of(points, bring_their_own(programs) or rule is None):
        _of_group(group, points, cell, search, found)
    return tuple(
        found.select_rows(np.flatnonzero(points.of == number), points, shown_units(cell.nominal)[0])
        for number in range(len(programs))
    )


@dataclass(frozen=True, eq=False)
class _ReachColumns:
    """The columns of all points, while they are filled in."""

    joints_rad: Array
    base_place_m: Array
    failed: NDArray[np.bool_]
    miss_m: Array
    expected_m: Array

    @classmethod
    def make_empty(cls, count: int, axes: int) -> "_ReachColumns":
        return cls(
            np.full((count, axes), np.nan),
            np.full((count, 3), np.nan),
            np.zeros(count, dtype=bool),
            np.full(count, np.nan),
            np.full(count, np.nan),
        )

    def select_rows(self, rows: NDArray[np.intp], points: ProgramPoints, shown: Array) -> ProgramReach:
        return ProgramReach(
            self.joints_rad[rows],
            self.base_place_m[rows],
            tuple(points.reasons[i] for i in rows.tolist()),
            self.failed[rows],
            self.miss_m[rows],
            self.expected_m[rows],
            shown,
        )


def _of_group(
    group: PointGroup, points: ProgramPoints, cell: Project, search: Search, found: _ReachColumns
) -> None:
    """Fill in the points that share tool and frame."""
    program, rows = points.programs[points.of[group.rows[0]]], group.rows
    tool, frame, other = _frames_of_group(group, program, cell)
    taught = np.isfinite(points.joints[rows]).all(axis=1)
    found.joints_rad[rows[taught]] = points.joints[rows[taught]]
    posed = rows[~taught]
    if other:
        points.refuse_points(rows, other)
        return
    if tool is None:
        points.refuse_points(rows, missing_reason("tool", group.tool, cell))
        return
    if frame is None:
        points.refuse_points(posed, missing_reason("user frame", group.frame, cell))
        posed = posed[:0]
    if frame is not None and len(posed):
        end = AxisEnd(cell.axes, False, frame, group.frame or cell.default_frame, program.brand, group.held)
        carried = carry_points(end, end, points.axis_values[posed])
        assert carried.source_frame is not None
        base_flange = carried.source_frame @ points.tips_of(posed) @ inverse_transform(tool.entered)
        texts = [points.texts[i] for i in posed.tolist()]
        postures = points.taught_before(posed)
        points.begin_programs(posed, postures, cell.starting)
        joints, why = search.find_joints(base_flange, texts, postures)
        found.joints_rad[posed] = joints
        _mark_failed(points, posed, why, found)
    _judge_points(rows[np.isfinite(found.joints_rad[rows]).all(axis=1)], points, cell, tool, found)


def _frames_of_group(
    group: PointGroup, program: ProgramFile, cell: Project
) -> tuple[ProjectTool | None, Array | None, str]:
    """Return the tool and the user frame, and why they contradict; of work in the gripper, work and standing tool."""
    if group.held:
        found = cell.standing_tools.of_position(program.brand, group.tool, group.frame)
        return (None, None, "") if found is None else (found[1], found[0].entered, "")
    other = find_contradiction(cell, program, group.tool, group.frame)
    return tool_of(cell, program, group.tool), frame_of(cell, program, group.frame), other


def _judge_points(
    rows: NDArray[np.intp], points: ProgramPoints, cell: Project, tool: ProjectTool, found: _ReachColumns
) -> None:
    """Look at the joints of some points: limits, singularities, accuracy."""
    if not len(rows):
        return
    joints, model = found.joints_rad[rows], cell.controller
    beyond = beyond_limits(model, joints) > _ROUNDED_RAD
    of = [*(f"J{j + 1}" for j in range(model.axis_count)), *(each.name for each in model.combined_limits)]
    names = [", ".join(of[j] for j in np.flatnonzero(one)) for one in beyond]
    _mark_failed(points, rows, [f"{name} beyond its limit" if name else "" for name in names], found)
    near = smallest_sigma(model, joints, cell.smallest_sigma, cell.held_joints) < cell.smallest_sigma
    _mark_failed(points, rows, ["too near to a singularity" if one else "" for one in near.tolist()], found)
    believed = tip_poses(TipArm(model, tool.entered), joints)
    found.base_place_m[rows] = believed[:, :3, 3]
    if cell.identified is None:
        return
    real = tip_poses(cell.real_arm(tool.real), joints)
    found.miss_m[rows] = np.linalg.norm(real[:, :3, 3] - believed[:, :3, 3], axis=1)
    expectation = Expectation(cell, cell, np.eye(4), nominal=True)
    found.expected_m[rows] = expectation.errors_m(TransferEnds(joints, joints, tool, tool))


def _mark_failed(
    points: ProgramPoints, rows: NDArray[np.intp], why: Sequence[str], found: _ReachColumns
) -> None:
    bad = np.array([bool(reason) for reason in why], dtype=bool)
    found.failed[rows[bad]] = True
    reasons = dict(zip(rows.tolist(), why, strict=True))
    points.refuse_points(rows[bad], lambda i: reasons[i])
