"""Where the points of many programs go, and the new programs: written, read back, compared with what was asked."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from cellcal.calibration.compensation.pose_gap import Flags
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.transfer import same_place
from cellcal.drivers.program_registry import change_programs
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import PositionChange, ProgramFile
from cellcal.service.engineering.programs.controller_joints import as_chain, as_written
from cellcal.service.engineering.programs.external.carried_points import CarriedChanges
from cellcal.service.engineering.programs.external.moving_axes import NO_AXES, CellAxes
from cellcal.service.engineering.programs.external.point_values import point_axes_of, written_values
from cellcal.service.engineering.programs.fitting_changes import change_what_fits
from cellcal.service.engineering.programs.point_columns import joints_of, side_by_side
from cellcal.service.engineering.programs.program_points import ProgramPoints, Rows
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.result import CHANGED, LEFT, UNCHANGED, PointFinding, ProgramResult

_BLOCK = 32768
_ALIKE_AXIS = 1e-9  # [m or rad]
_WRITTEN_AXIS = 2e-6  # [m or rad]: a unit of the last decimal that files give to external axes
_SHARES = "its external axes stand in one row with those of {name}, which is left"
_MOST_FOREIGN, _FEWEST_FOREIGN = 0.5, 2  # share of a program's points, and how many: one may be a mistake


@dataclass(eq=False)
class PointOutcomes:
    """Columns of all points, NaN where a point is left."""

    frame_tip: Array
    joints: Array  # one row of NaN for all while no joints are written
    before: Array
    after: Array
    shift_m: Array
    turn_rad: Array
    expected_m: Array
    uncorrected_m: Array
    left_rad: Array  # (N,) turn that the arm could not follow
    texts: dict[int, str] = field(default_factory=dict)
    axis_values: Array = field(
        default_factory=lambda: np.zeros((0, 0))
    )  # (N, A) of the target's external axes
    carried: CarriedChanges | None = None  # None where the cell has no external axes
    target_axes: CellAxes = NO_AXES

    @classmethod
    def make_empty(cls, count: int, axes: int) -> "PointOutcomes":
        new, before, after = (np.full((count, 4, 4), np.nan) for _ in range(3))
        shift, turn, expected, uncorrected, left = (np.full(count, np.nan) for _ in range(5))
        joints = np.broadcast_to(np.full(axes, np.nan), (count, axes))
        return cls(new, joints, before, after, shift, turn, expected, uncorrected, left)


def results_of(
    points: ProgramPoints,
    outcome: PointOutcomes,
    warnings: Sequence[str],
    findings: Sequence[tuple[PointFinding, ...]],
    *,
    source: Project,
) -> tuple[ProgramResult, ...]:
    """Return what became of every program.

    Raises
    ------
    ProgramFileError
        Most points of a program do not belong to the source's robot, a program can take no change at all, or does
        not say what was asked for when it is read again.
    """
    bounds = np.searchsorted(points.of, np.arange(len(points.programs) + 1)).tolist()
    good = np.array([not reason for reason in points.reasons], dtype=bool)
    slices = [slice(first, beyond) for first, beyond in pairwise(bounds)]
    for program, its in zip(points.programs, slices, strict=True):
        if not good[its].all():
            _refuse_foreign_points(program, points.reasons[its], source)
    after = _changed_programs(points, outcome, good & ~points.stays, slices)
    good = np.array([not reason for reason in points.reasons], dtype=bool)
    written = good & ~points.stays
    status = _point_statuses(points, after, good)
    _check_written(points, after, outcome, written)
    _check_axes_written(points, after, outcome, written)
    for column in (
        outcome.shift_m,
        outcome.turn_rad,
        outcome.expected_m,
        outcome.uncorrected_m,
        outcome.after,
    ):
        column[~good] = np.nan
    return tuple(
        ProgramResult(
            before=before,
            after=new,
            status=tuple(status[its]),
            reason=tuple(points.reasons[its]),
            shift_m=outcome.shift_m[its],  # views: a large file is not copied
            turn_rad=outcome.turn_rad[its],
            base_tip_before=outcome.before[its],
            base_tip_after=outcome.after[its],
            expected_error_m=outcome.expected_m[its],
            uncorrected_m=outcome.uncorrected_m[its],
            warnings=(
                *(make_message("line {line}: {text}", line=one.line, text=one.text) for one in found),
                *warnings,
                *(make_message("line {line}: {text}", line=r.line, text=r.text) for r in before.remarks),
            ),
            findings=found,
        )
        for before, new, its, found in zip(points.programs, after, slices, findings, strict=True)
    )


def _changed_programs(
    points: ProgramPoints, outcome: PointOutcomes, good: Flags, slices: Sequence[slice]
) -> list[ProgramFile]:
    """Return every program with its good points where they go; points that it cannot take are left."""
    after = list(points.programs)
    rows = [
        _without_shared_axes(points, its.start + np.flatnonzero(good[its]), its.start, outcome)
        for its in slices
    ]
    some = [i for i, its in enumerate(rows) if len(its)]
    changes = [_program_change(points, rows[i], outcome) for i in some]
    try:
        changed = change_programs([points.programs[i] for i in some], changes)
    except ProgramFileError:
        for i in some:
            after[i] = _change_one(points, rows[i], slices[i].start, outcome)
    else:
        for i, new in zip(some, changed, strict=True):
            after[i] = new
    return after


def _change_one(points: ProgramPoints, rows: Rows, start: int, outcome: PointOutcomes) -> ProgramFile:
    """Return one program with the changes that it can take."""
    program = points.programs[int(points.of[start])]
    after, refused = change_what_fits(program, rows, lambda its: _program_change(points, its, outcome))
    for row, why in refused.items():
        points.refuse_points(np.array([row], dtype=np.intp), why)
    fitting = rows[[row not in refused for row in rows.tolist()]]
    together = _without_shared_axes(points, fitting, start, outcome)
    if len(together) < len(fitting):
        return _change_one(points, together, start, outcome) if len(together) else program
    return after


def _without_shared_axes(points: ProgramPoints, rows: Rows, start: int, outcome: PointOutcomes) -> Rows:
    """Return rows to change, without those whose external axes would change for a position that is left, too."""
    program = points.programs[int(points.of[start])] if len(rows) else None
    if program is None or not program.positions.shared_external:
        return rows
    its = points.row[points.of == points.of[start]].tolist()
    first = {row: start + number for number, row in enumerate(its)}
    while len(rows):
        changed = set(points.row[rows].tolist())
        table = _changed_axes(program, points.row[rows], outcome, rows)
        moved = set() if table is None else set(points.row[rows][np.isfinite(table).any(axis=1)].tolist())
        shared = set[int]()
        for group in program.positions.shared_external:
            unchanged_rows = [row for row in group if row not in changed]
            with_it = [first[row] for row in group if row in moved] if unchanged_rows else []
            if with_it:
                why = make_message(_SHARES, name=program.positions.names[unchanged_rows[0]])
                points.refuse_points(np.array(with_it, dtype=np.intp), why)
                shared.update(with_it)
        if not shared:
            break
        rows = np.setdiff1d(rows, sorted(shared))
    return rows


def _program_change(points: ProgramPoints, rows: Rows, outcome: PointOutcomes) -> PositionChange:
    whole = len(rows) == rows[-1] - rows[0] + 1
    part = slice(int(rows[0]), int(rows[-1]) + 1) if whole else rows
    brand = points.programs[int(points.of[rows[0]])].brand
    poses, joints = outcome.frame_tip[part], as_written(brand, outcome.joints[part])
    spelled = [i for i in rows.tolist() if i in outcome.texts] if outcome.texts else []
    texts = [outcome.texts.get(i, points.texts[i]) for i in rows.tolist()] if spelled else None
    return PositionChange(
        rows=points.row[part].astype(np.int64),
        frame_tip=poses if np.isfinite(poses[:, 0, 0]).any() else None,
        joints=joints if np.isfinite(joints[:, 0]).any() else None,
        configurations=texts,
        external=_changed_axes(points.programs[int(points.of[rows[0]])], points.row[part], outcome, rows),
    )


def _changed_axes(program: ProgramFile, its: Rows, outcome: PointOutcomes, rows: Rows) -> Array | None:
    """Return what the columns of external axes get; None where all stay as they are."""
    axes, positions = outcome.target_axes, program.positions
    if not outcome.axis_values.size:
        return None
    there = point_axes_of(positions, axes)
    values = np.full_like(there.values, np.nan)
    values[its] = outcome.axis_values[rows]
    values[np.abs(values - there.values) <= _ALIKE_AXIS] = np.nan
    table = written_values(positions, axes, there, values)[its]
    return table if np.isfinite(table).any() else None


def _point_statuses(points: ProgramPoints, after: Sequence[ProgramFile], good: Flags) -> list[str]:
    same = np.array(
        [
            a == b
            for a, b in zip(
                points.texts, (text for new in after for text in new.positions.configurations), strict=True
            )
        ],
        dtype=bool,
    )
    poses = side_by_side([new.positions.frame_tip for new in after], points.frame_tip[:0])
    axes = points.joints.shape[1]
    joints = side_by_side(
        [as_chain(new.brand, joints_of(new.positions, axes)) for new in after], points.joints[:0]
    )
    for first in range(0, len(same), _BLOCK):
        block = slice(first, first + _BLOCK)
        same[block] &= _is_equal(points.frame_tip[block], poses[block]) & _is_equal(
            points.joints[block], joints[block]
        )
    for number, (before, new) in enumerate(zip(points.programs, after, strict=True)):
        if len(before.positions.external_columns):
            rows = np.flatnonzero(points.of == number)
            same[rows] &= _is_equal(before.positions.all_external_axes, new.positions.all_external_axes)
    return list(np.where(good, np.where(same, UNCHANGED, CHANGED), LEFT).tolist())


def _is_equal(old: Array, new: Array) -> Flags:
    one = ((old == new) | (np.isnan(old) & np.isnan(new))).reshape(len(old), -1)
    return np.asarray(one.all(axis=1), dtype=np.bool_)


def _check_written(
    points: ProgramPoints, after: Sequence[ProgramFile], outcome: PointOutcomes, good: Flags
) -> None:
    """Read back what was written: the files' numbers say the points, within their own resolution.

    Raises
    ------
    ProgramFileError
        They do not; nothing of this file may be used.
    """
    read = [new.positions for new in after]
    poses = side_by_side([one.frame_tip for one in read], points.frame_tip[:0])
    none = np.zeros(0)
    step_m = side_by_side([one.resolution_m for one in read], none)
    step_rad = side_by_side([one.resolution_rad for one in read], none)
    rows = np.flatnonzero(good & np.isfinite(outcome.frame_tip[:, 0, 0]))
    for first in range(0, len(rows), _BLOCK):
        some = rows[first : first + _BLOCK]
        apart, turned = same_place(poses[some], outcome.frame_tip[some])
        near = (apart <= 2.0 * step_m[some] + 1e-9) & (turned <= 4.0 * step_rad[some] + 1e-7)
        if not near.all():
            _refuse_written(points, some[~near], apart[~near])


def _check_axes_written(
    points: ProgramPoints, after: Sequence[ProgramFile], outcome: PointOutcomes, good: Flags
) -> None:
    """Read back what was written of external axes.

    Raises
    ------
    ProgramFileError
        The file says something else.
    """
    for number, new in enumerate(after):
        rows = np.flatnonzero((points.of == number) & good)
        if not outcome.axis_values.size or not len(rows):
            continue
        there = point_axes_of(new.positions, outcome.target_axes).values[points.row[rows]]
        apart = np.abs(there - outcome.axis_values[rows])
        if (np.nan_to_num(apart) > _WRITTEN_AXIS).any():
            raise ProgramFileError(
                new.name,
                "the values written for external axes are not read back.",
                remedy="Do not use this file; report it with the program.",
            )


def _refuse_written(points: ProgramPoints, rows: Rows, apart_m: Array) -> None:
    worst = int(rows[np.argmax(apart_m)])
    program = points.programs[int(points.of[worst])]
    raise ProgramFileError(
        program.name,
        make_message(
            "the numbers written for {names} are {apart_mm:.4f} mm from the point.",
            names=program.positions.names[int(points.row[worst])],
            apart_mm=apart_m.max() * 1000.0,
        ),
        remedy="Do not use this file; report it with the program.",
    )


def _refuse_foreign_points(program: ProgramFile, reasons: Sequence[str], project: Project) -> None:
    """Refuse a program most of whose points its own robot cannot reach."""
    beyond = sum(reason.startswith(("unreachable: the arm has", "its joints and")) for reason in reasons)
    if beyond >= _FEWEST_FOREIGN and beyond > _MOST_FOREIGN * len(reasons):
        raise ProgramFileError(
            program.name,
            make_message(
                "{beyond} of its {reason_count} positions do not belong to the {nominal_name} of "
                "{path_name}: {next}.",
                beyond=beyond,
                reason_count=len(reasons),
                nominal_name=project.nominal.label,
                path_name=project.file_name,
                next=next(r for r in reasons if r),
            ),
            remedy="See that robot, user frame and tool of the project are those this program was taught with.",
        )
