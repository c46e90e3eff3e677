"""Measurements from a file, in SI: joints, what the device read, and every guess that was made on the way."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import (
    Observations,
    Rows,
)
from cellcal.calibration.identification.unrounding import find_resolution
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.columns import TableLayout, UnnamedPositionError, detect_layout
from cellcal.service.engineering.measured.joined_sheets import joined_tables
from cellcal.service.engineering.measured.joint_choice import better_joints, joint_sets
from cellcal.service.engineering.measured.joint_coupling import controller_joints
from cellcal.service.engineering.measured.joint_units import joint_units, refuse_typed_zeros
from cellcal.service.engineering.measured.joints_file import with_joints_of
from cellcal.service.engineering.measured.merged_cells import fill_merged_joints
from cellcal.service.engineering.measured.nest_readings import find_nest_readings
from cellcal.service.engineering.measured.no_readings import no_readings, usable_without
from cellcal.service.engineering.measured.place_choice import better_places, further_places_note
from cellcal.service.engineering.measured.place_differences import refuse_nominal_places, with_sums
from cellcal.service.engineering.measured.row_words import (
    refuse_no_angles,
    refuse_other_headings,
    refuse_several_robots,
    target_column,
    unused_columns,
)
from cellcal.service.engineering.measured.table import (
    WRITE_PLAINLY,
    MeasurementError,
    MeasurementTable,
    read_table,
)
from cellcal.service.engineering.measured.table_numbers import TableNumbers
from cellcal.service.engineering.measured.typed_options import (
    ReadOptions as ReadOptions,  # noqa: PLC0414  # users of measurements import it from here
)
from cellcal.service.engineering.measured.typed_options import refuse_idle_words, refuse_unknown_options
from cellcal.service.engineering.measured.unit_choice import UnitChoice
from cellcal.service.engineering.measured.units import to_celsius
from cellcal.service.engineering.measured.unnamed_columns import (
    Places,
    find_unnamed_columns,
    find_unnamed_place,
    tell_nothing,
)
from cellcal.service.engineering.measured.usable_rows import (
    REPEAT,
    RejectedRow,
    usable_rows,
    without_invalid,
)

_FEWEST_READINGS = 1  # a row beside joints of another file: the length of a wire
_NO_NUMBER = ", which is no number"


@dataclass(frozen=True, eq=False)
class Measurements:
    """Usable rows of a file; ``rows`` are their numbers in the file, data rows counted from 0."""

    observations: Observations
    rows: Rows
    read: int
    rejected: tuple[RejectedRow, ...]
    joint_step_rad: Array  # (n,)
    controller_m: Array | None  # (N, 3)
    controller_step_m: float
    value_step_m: float  # resolution of what was measured
    attitude_step_rad: float  # and of its attitude, 0 without any
    temperature: Array | None
    groups: Rows | None
    guesses: tuple[str, ...]
    layout: TableLayout
    units: Mapping[str, str]  # meaning -> unit, stated or guessed
    convention: str  # of the attitude; empty if none is used
    joint_coupling: str = ""  # in which the joints were said to be
    targets: tuple[str, tuple[str, ...]] = ("", ())  # a column that tells targets apart, and their names
    unused: Mapping[str, Array] = field(
        default_factory=dict
    )  # columns that take no part, a number or code a row


def read_measurements(path: Path, model: RobotModel, options: ReadOptions | None = None) -> Measurements:
    """Read a file of measurements of this robot.

    Raises
    ------
    MeasurementError
        The file, its columns or its numbers cannot be understood; the remedy names the option that helps.
    """
    options = options or ReadOptions()
    refuse_unknown_options(options.units, options.convention)
    if options.joints_file is None:
        table = read_table(path, sheet=options.sheet)
    else:
        readings = read_table(path, sheet=options.sheet, fewest=_FEWEST_READINGS)
        table = with_joints_of(options.joints_file, readings, model)
    table, columns = with_sums(table, options.columns)
    return _interpret_table(table, path, model, replace(options, columns=columns))


def _interpret_table(
    table: MeasurementTable, path: Path, model: RobotModel, options: ReadOptions
) -> Measurements:
    table, layout = _lay_out(table, path, model, options)
    names = [name for name in (*layout.joints, *layout.position, *layout.turn, layout.length) if name]
    numbers = {name: table.column_values(name) for name in (*names, *layout.spread, *layout.controller)}
    refuse_other_headings(table, names)
    good, rejected = _valid_rows(table, path, (names, layout.group), numbers)
    guesses = [table.dialect] if table.dialect else []
    units = UnitChoice({**layout.units, **options.units}, guesses)
    raw = np.column_stack([numbers[name][good] for name in layout.joints])
    unit = joint_units(units, layout.joints, raw, model)
    if model.sliding is None:
        refuse_no_angles(layout.joints, raw, unit)
    joints = controller_joints(_as_typed(raw * unit, layout, model), model, options.joint_coupling)
    better, notes = _find_better_columns(table, layout, good, (model, joints, _steps_of(raw) * unit), options)
    if better:
        return _interpret_table(table, path, model, replace(options, columns={**options.columns, **better}))
    guesses += notes
    good, joints, silent = _with_readings(table, good, joints, (layout, numbers, model))
    _refuse_none(path, good, (*rejected, *silent))
    good, joints, again = _without_repeats(table, good, joints, [numbers[name] for name in names])
    rejected = tuple(sorted([*rejected, *silent, *again], key=lambda item: item.row))
    numbers = {name: values[good] * layout.column_sign(name) for name, values in numbers.items()}
    raw = np.column_stack([numbers[name] for name in layout.joints])
    source = TableNumbers(layout, numbers, model, options.convention, units, joints)
    controller, controller_step = source.controller_positions()
    observations, value_step = source.observations()
    refuse_idle_words(options, units.used, layout)
    rows = np.flatnonzero(good)
    used = (*numbers, layout.group)
    refuse_several_robots(table, rows, used)
    return Measurements(
        observations=observations,
        rows=rows,
        read=len(table),
        rejected=rejected,
        joint_step_rad=_steps_of(raw) * unit,
        controller_m=controller,
        controller_step_m=controller_step,
        value_step_m=value_step,
        attitude_step_rad=source.attitude_step_rad() if observations.kind == "pose" else 0.0,
        temperature=_read_temperature(table, layout.temperature, rows),
        groups=_read_groups(table, layout.group, rows),
        guesses=tuple(guesses),
        layout=layout,
        units={key: unit for key, unit in units.used.items() if key != "convention"},
        convention=units.used.get("convention", ""),
        joint_coupling=options.joint_coupling,
        targets=target_column(table, rows, used),
        unused=unused_columns(table, rows, used),
    )


def _valid_rows(
    table: MeasurementTable, path: Path, used: tuple[Sequence[str], str], numbers: Mapping[str, Array]
) -> tuple[np.typing.NDArray[np.bool_], tuple[RejectedRow, ...]]:
    """Return which rows hold the numbers that are needed and are not called bad, and the others."""
    names, group = used
    good, rejected = usable_rows(table, names, numbers)
    _refuse_none(path, good, rejected)
    _refuse_mostly_text(path, rejected, len(table))
    good, rejected = without_invalid(table, good, rejected, (*names, group))
    _refuse_none(path, good, rejected)
    return good, rejected


def _lay_out(
    table: MeasurementTable, path: Path, model: RobotModel, options: ReadOptions
) -> tuple[MeasurementTable, TableLayout]:
    """Return what each column is, and the table with joints in rows that share those of the row above."""
    columns = options.columns
    further: Places = ()
    if not columns and tell_nothing(table.names):
        table, columns, further = find_unnamed_columns(table, model)
    try:
        table, layout = _detect_or_fit(table, model, columns)
    except MeasurementError as error:
        if len(table.sheets) < 2:
            raise
        found = _joined_layouts(path, table, model, columns)
        if len(found) != 1:
            raise _other_sheets_error(table.sheets, error) from error
        table, layout = found[0]
    else:
        if (
            len(table.sheets) > 1 and not layout.is_named
        ):  # a robot's own places, perhaps: the device's stand apart
            with suppress(MeasurementError):
                found = _joined_layouts(path, table, model, columns)
                table, layout = found[0] if len(found) == 1 else (table, layout)
    if further:
        layout = replace(layout, further=further, is_named=False)
    return fill_merged_joints(table, layout.joints, (*layout.position, layout.length)), layout


def _detect_or_fit(
    table: MeasurementTable, model: RobotModel, columns: Mapping[str, Sequence[str]]
) -> tuple[MeasurementTable, TableLayout]:
    """Return what each column is; a position that no heading tells is the one that fits the robot."""
    try:
        return table, _detect(table, model, columns)
    except UnnamedPositionError as error:
        table, position, further = find_unnamed_place(table, model, error.joints, error.candidates)
        if not position:
            raise
    layout = _detect(table, model, {**columns, "position": position})
    return table, replace(layout, further=further, is_named=not further)


def _detect(table: MeasurementTable, model: RobotModel, columns: Mapping[str, Sequence[str]]) -> TableLayout:
    slides = () if model.sliding is None else model.sliding.tolist()
    return detect_layout(table.names, model.joint_names, columns, slides, table.numeric_names())


def _joined_layouts(
    path: Path, table: MeasurementTable, model: RobotModel, columns: Mapping[str, Sequence[str]]
) -> list[tuple[MeasurementTable, TableLayout]]:
    """Return the joins of a sheet with others that hold joints and readings only together."""
    found = []
    for joined in joined_tables(path, table, lambda other: _holds_both(other, model)):
        with suppress(MeasurementError):
            found.append((joined, _detect(joined, model, columns)))
    return found


def _holds_both(table: MeasurementTable, model: RobotModel) -> bool:
    """Return whether a sheet is a series of its own."""
    try:
        _detect(table, model, {})
    except MeasurementError:
        return False
    return True


def _other_sheets_error(sheets: Sequence[str], error: MeasurementError) -> MeasurementError:
    """Return the refusal of a sheet that lacks what another sheet of its workbook may hold."""
    return MeasurementError(
        make_message("sheet {sheet!r}: {error}", sheet=sheets[0], error=error.message),
        remedy=make_message(
            "The workbook has numbers in {others}, too: one sheet is read (`--sheet`), which needs joints and "
            "readings in the same rows. Where they stand apart, both sheets need a column that names each point "
            "once.",
            others=", ".join(repr(name) for name in sheets[1:]),
        ),
    )


def _find_better_columns(
    table: MeasurementTable,
    layout: TableLayout,
    good: np.typing.NDArray[np.bool_],
    arm: tuple[RobotModel, Array, Array],
    options: ReadOptions,
) -> tuple[dict[str, tuple[str, ...]], list[str]]:
    """Return columns of places and joints where the numbers show others than the headings, and what is to be said."""
    positions = np.column_stack(
        [table.column_values(name)[good] for name in layout.position or layout.joints]
    )
    refuse_nominal_places(arm[0], arm[1:], layout, positions)
    if layout.further or layout.length:
        places = (layout.position, layout.controller, *layout.further, (layout.length,))
        values = {name: table.column_values(name)[good] for names in places for name in names if name}
        if better := better_places(*arm, layout, values):
            return {"joints": layout.as_typed(layout.joints), **better}, []
    better, note = {}, ""
    if layout.position and "joints" not in options.columns:
        sets = joint_sets(table, layout.joints, good, arm[:2], options.joint_coupling)
        better, note = better_joints(arm[0], sets, positions)
    return better, [text for text in (further_places_note(layout.further), note) if text]


def _steps_of(columns: Array) -> Array:
    return np.array([find_resolution(column) for column in columns.T])


def _read_temperature(table: MeasurementTable, name: str, rows: Rows) -> Array | None:
    """Return the temperature of rows [deg C], if a column holds one."""
    return to_celsius(table.column_values(name)[rows], name) if name else None


def _as_typed(joints_rad: Array, layout: TableLayout, model: RobotModel) -> Array:
    """Return joints with the signs and zeros that were typed with their columns."""
    signs = np.array([layout.column_sign(name) for name in layout.joints])
    zeros = np.deg2rad([layout.zero_deg(name) for name in layout.joints])
    refuse_typed_zeros(zeros, model)
    typed: Array = joints_rad * signs + zeros
    return typed


def _refuse_none(path: Path, good: np.typing.NDArray[np.bool_], rejected: tuple[RejectedRow, ...]) -> None:
    if not good.any():
        text = make_message("{path} has no usable row; it has no rows.", path=path)
        if rejected:
            first = rejected[0]
            text = make_message(
                "{path} has no usable row; row {row}: {reason}.",
                path=path,
                row=first.row,
                reason=first.reason,
            )
        unread = bool(rejected) and rejected[0].reason.endswith(_NO_NUMBER)
        remedy = WRITE_PLAINLY if unread else "Name columns with `--columns`."
        raise MeasurementError(text, remedy=remedy)


def _with_readings(
    table: MeasurementTable,
    good: np.typing.NDArray[np.bool_],
    joints_rad: Array,
    inputs: tuple[TableLayout, Mapping[str, Array], RobotModel],
) -> tuple[np.typing.NDArray[np.bool_], Array, list[RejectedRow]]:
    """Return usable rows and their joints without those in which the device read nothing."""
    layout, numbers, model = inputs
    names = (layout.length,) if layout.length else layout.position
    values = np.column_stack([numbers[name][good] for name in names])
    base_flange = model.base_flange(joints_rad)
    found = no_readings(values, base_flange[:, :3, 3])
    found = {**find_nest_readings(values, base_flange), **found}
    if not found:
        return good, joints_rad, []
    rows = np.flatnonzero(good)
    silent = [
        RejectedRow(
            int(rows[at]),
            make_message(
                "line {line}: {names}: {why}", line=table.lines[rows[at]], names=", ".join(names), why=why
            ),
        )
        for at, why in found.items()
    ]
    return usable_without(good, list(found)), np.delete(joints_rad, list(found), axis=0), silent


def _without_repeats(
    table: MeasurementTable, good: np.typing.NDArray[np.bool_], joints_rad: Array, columns: Sequence[Array]
) -> tuple[np.typing.NDArray[np.bool_], Array, list[RejectedRow]]:
    """Return usable rows and their joints without copies: rows that repeat another to the last digit."""
    rows = np.flatnonzero(good)
    values = np.column_stack(columns)[rows]
    _, first, of = np.unique(values, axis=0, return_index=True, return_inverse=True)
    earlier = first[of.reshape(-1)]
    copies = np.flatnonzero(earlier != np.arange(len(rows))).tolist()
    again = [
        RejectedRow(
            int(rows[at]),
            make_message(
                "line {line} repeats line {other_line} to the last digit: it counts once",
                line=int(table.lines[rows[at]]),
                other_line=int(table.lines[rows[earlier[at]]]),
            ),
            REPEAT,
        )
        for at in copies
    ]
    return usable_without(good, copies), np.delete(joints_rad, copies, axis=0), again


def _refuse_mostly_text(path: Path, rejected: tuple[RejectedRow, ...], rows: int) -> None:
    """Refuse a file that is half words where numbers should be; a device that lost its target leaves cells empty."""
    words = [row for row in rejected if not row.reason.endswith("is empty")]
    if 2 * len(words) > rows:
        raise MeasurementError(
            make_message(
                "{count} of {rows} rows of {path} cannot be read; {reason}.",
                count=len(words),
                rows=rows,
                path=path,
                reason=words[0].reason,
            ),
            remedy="Write numbers with a decimal point and no thousands marks, or name other `--columns`.",
        )


def _read_groups(table: MeasurementTable, name: str, rows: Rows) -> Rows | None:
    if not name:
        return None
    cells = table.column_texts(name)
    codes = np.unique([cells[row] for row in rows], return_inverse=True)[1].reshape(-1)
    count = int(codes.max()) + 1
    return codes if 2 < count <= len(rows) // 2 else None
