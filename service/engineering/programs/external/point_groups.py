"""External axes of points that share tool and frame: what leaves them, and what carries the others."""

import numpy as np

from cellcal.service.engineering.programs.external.carried_points import (
    AxisEnd,
    CarriedPoints,
    carry_points,
    unlike_axis,
)
from cellcal.service.engineering.programs.external.point_values import beyond_range
from cellcal.service.engineering.programs.program_points import PointGroup, ProgramPoints, Rows
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.transfer_route import FramePair, TransferRoute, change_angle_rad

_LEAST_RAD = 1e-9
_ALONG_TOOL = (
    "its program also shifts points or goes on from them, perhaps along the axes of the tool in the cell, and this "
    "change turns these"
)
_SHIFTING = frozenset(("offset", "relative"))  # codes of remarks


def carry_group(
    points: ProgramPoints, rows: Rows, group: PointGroup, frames: FramePair, route: TransferRoute
) -> tuple[Rows, CarriedPoints]:
    """Return the rows of a group that can go, and their frames; the others are left with a reason."""
    brand = points.programs[points.of[group.rows[0]]].brand
    source, target = (
        AxisEnd(project.axes, real, frame, _frame_name(project, group), brand, group.held)
        for project, real, frame in zip(
            (route.source, route.target),
            route.real_ends,
            (frames.source_frame, frames.target_frame),
            strict=True,
        )
    )
    if group.held:
        _refuse_shifted_work(points, rows, route)
    needs = bool(source.needed_axes() or target.needed_axes())
    if needs and source.axes is not target.axes and (why := unlike_axis(source.axes, target.axes)):
        points.refuse_points(rows, why)
    rows = rows[[not points.reasons[row] for row in rows.tolist()]]
    carried = carry_points(source, target, points.axis_values[rows])
    if source.axes is not target.axes:
        reasons = beyond_range(target.axes, carried.target_values)
        points.refuse_points(rows, dict(zip(rows.tolist(), reasons, strict=True)).__getitem__)
        good = np.array([not reason for reason in reasons], dtype=bool)
        rows, carried = rows[good], carried.of_rows(good)
    return rows, carried


def _frame_name(project: Project, group: PointGroup) -> str | None:
    return group.frame if group.frame is not None or group.held else project.default_frame


def _refuse_shifted_work(points: ProgramPoints, rows: Rows, route: TransferRoute) -> None:
    """Leave work in the gripper whose program moves along axes of the standing tool, which the change turns."""
    angle = change_angle_rad(route)
    shifting = any(remark.code in _SHIFTING for program in points.programs for remark in program.remarks)
    if angle > _LEAST_RAD and shifting:
        points.refuse_points(rows, _ALONG_TOOL)
