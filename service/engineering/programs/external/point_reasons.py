"""Why positions are left for the sake of external axes, other motion groups, or a tool that stands in the cell."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.conditions import ConditionalBar, ProjectNeed
from cellcal.drivers.programs.positions import Positions, ProgramFile
from cellcal.service.engineering.programs.external.moving_axes import CellAxes
from cellcal.service.engineering.programs.external.point_values import (
    PointAxes,
    beyond_range,
    has_unstated_axes,
    is_stated,
    point_axes_of,
    stated_groups,
)
from cellcal.service.engineering.programs.external.standing_tools import StandingTools
from cellcal.service.engineering.programs.other_axes import (
    BESIDE_EXTERNAL,
    EXTERNAL,
    OTHER_JOINTS,
    find_moved_other_axes,
    of_another_arm,
)

OTHER_GROUP = "belongs to another motion group than the robot"
NOT_SAID = "does not say where {} stands"
SET_LATER = "a program sets values of external axes while it runs"
STANDS = "its program sets a base or work object that no axis turns, and {} turns it in the project"
NO_FRAME = "its program names no user frame, so nothing tells whether its work is on {}"


@dataclass(frozen=True, eq=False)
class ExternalReasons:
    """Of N positions of one program."""

    reasons: list[str]  # "" where a point can be moved
    stays: NDArray[np.bool_]  # rows of groups whose axes are stated: they are no points of the robot
    point_axes: PointAxes


def external_reasons(
    program: ProgramFile, axes: CellAxes, tools: StandingTools, joint_count: int, *, set_later: bool
) -> ExternalReasons:
    """Return why positions of a program are left; ``set_later`` where a program of its batch sets external axes.

    Raises
    ------
    ProgramFileError
        A program of an arm with another number of joints: every joint position says so.
    """
    positions = program.positions
    point_axes, groups = point_axes_of(positions, axes), stated_groups(positions, axes)
    stays = np.isin(positions.groups, list(groups))
    other_arm = of_another_arm(program, joint_count)
    unstated = has_unstated_axes(positions, axes)
    beside = find_moved_other_axes(positions, joint_count, unstated, groups)
    reasons = [""] * len(positions)
    for flags, why in (
        ((positions.groups != 1) & ~stays, OTHER_GROUP),
        (other_arm, make_message(OTHER_JOINTS, joint_count)),
        (unstated, EXTERNAL),
        (beside & ~stays, BESIDE_EXTERNAL),
    ):
        for row in np.flatnonzero(flags).tolist():
            reasons[row] = reasons[row] or why
    for row, condition in positions.conditions.items():
        if not _is_met(program, row, condition, axes, tools):
            reasons[row] = condition.why
    _add_standing(positions, axes, reasons, caseless=_is_caseless(program))
    if len(axes):
        _add_axis_reasons(program, axes, point_axes, reasons, stays)
        if set_later:
            _add_set_later(program, axes, reasons, stays)
    return ExternalReasons(reasons, stays, point_axes)


def leave_lists_of_programs(programs: Sequence[ProgramFile], found: Sequence[ExternalReasons]) -> None:
    """Leave all points of a KUKA program where its text, or its data list, carries axes that are not stated."""
    elsewhere = {
        program.name
        for program, external in zip(programs, found, strict=True)
        if program.brand == "kuka" and {EXTERNAL, BESIDE_EXTERNAL}.intersection(external.reasons)
    }
    for program, external in zip(programs, found, strict=True):
        if program.brand == "kuka" and program.name in elsewhere:
            external.reasons[:] = [reason or BESIDE_EXTERNAL for reason in external.reasons]


def _add_standing(positions: Positions, axes: CellAxes, reasons: list[str], *, caseless: bool) -> None:
    """Leave points whose program says that their frame stands, where the project lets an axis turn it."""
    for row in positions.standing_frames:
        axis_names = [
            axes.axes[n].name
            for n in axes.carriers_of(positions.user_frames[row], caseless=caseless)
            if axes.axes[n].coordinated
        ]
        if axis_names:
            reasons[row] = reasons[row] or make_message(STANDS, axis_names[0])


def _is_met(
    program: ProgramFile, row: int, condition: ConditionalBar, axes: CellAxes, tools: StandingTools
) -> bool:
    positions = program.positions
    carriers = axes.carriers_of(positions.user_frames[row], caseless=_is_caseless(program))
    if ProjectNeed.LEADER in condition.needs and not _leader_is_stated(positions, row, axes, carriers):
        return False
    if ProjectNeed.MOVED_FRAME in condition.needs and not any(axes.axes[n].coordinated for n in carriers):
        return False
    return ProjectNeed.STANDING_TOOL not in condition.needs or tools.states(
        program.brand, positions.tools[row], positions.user_frames[row], held=row in positions.held_work
    )


def _leader_is_stated(positions: Positions, row: int, axes: CellAxes, carriers: Sequence[int]) -> bool:
    """Return whether all axes of other groups at a position are stated, and one of them carries its work."""
    values = positions.all_external_axes[row]
    others = [
        column.name
        for column, value in zip(positions.external_columns, values.tolist(), strict=True)
        if column.other_group and np.isfinite(value)
    ]
    carrying = CellAxes(tuple(axes.axes[number] for number in carriers))
    return (
        bool(others)
        and all(is_stated(name, axes) for name in others)
        and any(is_stated(name, carrying) for name in others)
    )


def _is_caseless(program: ProgramFile) -> bool:
    return program.brand in ("abb", "kuka")


def _add_axis_reasons(
    program: ProgramFile,
    axes: CellAxes,
    point_axes: PointAxes,
    reasons: list[str],
    stays: NDArray[np.bool_],
) -> None:
    """Add why the stated axes leave points: no value, another unit, a value beyond the range, unknown work."""
    positions = program.positions
    tracks = [number for number, axis in enumerate(axes.axes) if axis.carries_robot]
    tables = [number for number, axis in enumerate(axes.axes) if not axis.carries_robot]
    beyond = beyond_range(axes, point_axes.values)
    of_frame: dict[str | None, tuple[int, ...]] = {}
    for row, frame in enumerate(positions.user_frames):
        if reasons[row] or stays[row]:
            continue
        if frame not in of_frame:
            of_frame[frame] = axes.carriers_of(frame, caseless=_is_caseless(program))
        carriers = () if row in positions.held_work else of_frame[frame]
        reasons[row] = _axis_reason(row, (*tracks, *carriers), axes, point_axes) or beyond[row]
        joint_point = np.isfinite(positions.joints[row]).any() if positions.joints.shape[1] else False
        if not reasons[row] and frame is None and joint_point and tables and not carriers:
            reasons[row] = make_message(NO_FRAME, axes.axes[tables[0]].name)


def _add_set_later(
    program: ProgramFile, axes: CellAxes, reasons: list[str], stays: NDArray[np.bool_]
) -> None:
    """Leave points whose place depends on axes that a program sets: the file's value is not where they stand."""
    is_any_track = any(axis.carries_robot for axis in axes.axes)
    for row, frame in enumerate(program.positions.user_frames):
        depends = is_any_track or axes.carriers_of(frame, caseless=_is_caseless(program))
        if depends and not stays[row]:
            reasons[row] = reasons[row] or SET_LATER


def _axis_reason(row: int, needed: Sequence[int], axes: CellAxes, point_axes: PointAxes) -> str:
    for number in needed:
        if point_axes.contradictions[number]:
            return point_axes.contradictions[number]
        if not np.isfinite(point_axes.values[row, number]):
            return make_message(NOT_SAID, axes.axes[number].axis)
    return ""
