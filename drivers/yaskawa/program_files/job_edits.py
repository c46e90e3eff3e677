"""New coordinates into a job: which bytes become what."""

import re
from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import values_from
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.numbers import NumberFormat
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, PositionChange, Positions
from cellcal.drivers.yaskawa.program_files.job_axis_rows import BASE_ROWS, STATION_ROWS
from cellcal.drivers.yaskawa.program_files.job_columns import PULSES, USUAL, decimals_of, table_of
from cellcal.drivers.yaskawa.program_files.job_external import ROW_UNITS
from cellcal.drivers.yaskawa.program_files.job_text import JobRow

RATIOS_NEEDED = (
    "Pulses per degree are needed to know where these points are: from RC.PRM or ALL.PRM of the controller, or the "
    "project file."
)
_EXTERNAL_DIGITS = 4
_LARGEST_MM, _LARGEST_PULSES = 1e6, 2**31 - 1
_PULSES = re.compile(r"-?\d+(?:,-?\d+)*")
_FORMATS = {digits: ",".join(["%.3f"] * 3 + [f"%.{digits}f"] * 3) for digits in USUAL}
Edit = tuple[int, str, str]  # where, what stands there, what shall


class ChangeableProgram(Protocol):
    """The part of a program that a change needs."""

    @property
    def file(self) -> str: ...
    @property
    def positions(self) -> Positions: ...
    @property
    def rows(self) -> tuple[JobRow, ...]: ...
    @property
    def pulses_per_rad(self) -> tuple[float, ...] | None: ...
    @property
    def alone(self) -> Mapping[str, int]: ...
    def external_row(self, row: int, kinds: tuple[str, ...]) -> JobRow | None: ...


def edits_of(program: ChangeableProgram, change: PositionChange) -> list[Edit]:
    """Return the edits, in the order of the file.

    Raises
    ------
    ProgramFileError
        Rows that are not there, coordinates that a position cannot take, another configuration or frame.
    """
    rows = np.asarray(change.rows, dtype=np.int64)
    _refuse_shapes(program, change, rows)
    _refuse_texts(program, rows, change)
    edits = [
        *_pose_edits(program, rows, change.frame_tip),
        *_joint_edits(program, rows, change.joints),
        *_external_edits(program, rows, change.external),
    ]
    return sorted(set(edits))  # two points may share a row of base or station axes


def _refuse_shapes(program: ChangeableProgram, change: PositionChange, rows: NDArray[np.int64]) -> None:
    count, positions = len(rows), program.positions
    if rows.ndim != 1 or len(np.unique(rows)) != count or ((rows < 0) | (rows >= len(positions))).any():
        raise ProgramFileError(program.file, "the change names rows that are not there, or one twice.")
    for values, shape in (
        (change.frame_tip, (count, 4, 4)),
        (change.joints, (count, positions.joints.shape[1])),
        (change.external, (count, len(positions.external_columns))),
    ):
        if values is not None and np.shape(values) != shape:
            raise ProgramFileError(
                program.file,
                make_message(
                    "the change brings {found_shape} coordinates in place of {expected_shape}.",
                    found_shape=np.shape(values),
                    expected_shape=shape,
                ),
            )


def _refuse_texts(program: ChangeableProgram, rows: NDArray[np.int64], change: PositionChange) -> None:
    positions = program.positions
    for texts, old, what in (
        (change.configurations, positions.configurations, "configuration"),
        (change.user_frames, positions.user_frames, "user frame"),
    ):
        if texts is None:
            continue
        if len(texts) != len(rows):
            raise ProgramFileError(
                program.file,
                make_message(
                    "the change brings {text_count} texts for {count} positions.",
                    text_count=len(texts),
                    count=len(rows),
                ),
            )
        for row, text in zip(rows.tolist(), texts, strict=True):
            if text != (old[row] or ""):
                raise ProgramFileError(
                    program.file,
                    make_message(
                        "{names} would need another {what} ({text}); a job says it once for many positions.",
                        names=positions.names[row],
                        what=what,
                        text=text,
                    ),
                    line=int(positions.lines[row]),
                    remedy="Teach this position on the controller.",
                )


def _given_entries(
    program: ChangeableProgram, rows: NDArray[np.int64], values: Array, kind: str
) -> NDArray[np.int64]:
    """Return which entries of a change bring coordinates; they must be finite and for positions of that kind."""
    flat = np.asarray(values, dtype=float).reshape(len(rows), -1)
    entries = np.flatnonzero(~np.isnan(flat).all(axis=1)) if flat.size else np.zeros(0, dtype=np.int64)
    kinds = program.positions.kinds
    bad = np.isinf(flat).any(axis=1) | (np.isnan(flat).any(axis=1) & (kind == CARTESIAN))
    for row, broken in zip(rows[entries].tolist(), bad[entries].tolist(), strict=True):
        if kinds[row] != kind:
            raise ProgramFileError(
                program.file,
                make_message(
                    "{names} holds {kinds} and cannot take {kind} coordinates.",
                    names=program.positions.names[row],
                    kinds=kinds[row],
                    kind=kind,
                ),
                line=program.rows[row].line,
                remedy=RATIOS_NEEDED if kinds[row] == PULSES else "Leave this position out of the change.",
            )
        if broken:
            raise ProgramFileError(
                program.file,
                make_message("{names}: a coordinate is not finite.", names=program.positions.names[row]),
                line=program.rows[row].line,
                remedy="Leave this position out of the change.",
            )
    return entries


def _pose_edits(program: ChangeableProgram, rows: NDArray[np.int64], poses: Array | None) -> list[Edit]:
    if poses is None:
        return []
    entries = _given_entries(program, rows, poses, CARTESIAN)
    if not len(entries):
        return []
    new, places = np.asarray(poses, dtype=float)[entries], rows[entries]
    old = program.positions.frame_tip[places]
    try:
        angles = np.degrees(values_from("yaskawa_rpy", new[:, :3, :3]))
    except CalibrationError as refused:
        raise ProgramFileError(
            program.file,
            make_message(
                "the change brings a pose that is none: {refused_message}.", refused_message=refused.message
            ),
        ) from None
    job_rows = [program.rows[row] for row in places.tolist()]
    written = table_of(job_rows, 6)
    chord = np.linalg.norm((new - old)[:, :3, :3].reshape(-1, 9), axis=1) / np.sqrt(2.0)
    alike = chord < 0.5 * program.positions.resolution_rad[places]
    values = np.hstack([1e3 * new[:, :3, 3], np.where(alike[:, None], written[:, 3:], angles)])
    digits = np.array([decimals_of(row) for row in job_rows]).repeat(3, axis=1)
    return _number_edits(program, job_rows, values, digits, written)


def _joint_edits(program: ChangeableProgram, rows: NDArray[np.int64], joints: Array | None) -> list[Edit]:
    if joints is None:
        return []
    entries = _given_entries(program, rows, joints, JOINTS)
    job_rows = [program.rows[row] for row in rows[entries].tolist()]
    angles = np.asarray(joints, dtype=float)[entries]
    written = table_of(job_rows, angles.shape[1])
    for row, wrong in zip(
        job_rows, (np.isnan(angles) != np.isnan(written)).any(axis=1).tolist(), strict=True
    ):
        if wrong:
            raise ProgramFileError(
                program.file,
                make_message(
                    "{row_kind}{row_number} needs {count} finite angles.",
                    row_kind=row.kind,
                    row_number=row.number,
                    count=row.text.count(",") + 1,
                ),
                line=row.line,
                remedy="Give an angle for each axis that the position holds.",
            )
    pulsed = np.array([row.state.mode == "PULSE" for row in job_rows], dtype=bool).reshape(len(job_rows), 1)
    ratios = np.pad(np.array(program.pulses_per_rad or ()), (0, 8))[: angles.shape[1]]
    values = np.where(pulsed, angles * ratios, np.degrees(angles))
    digits = np.where(pulsed, 0, np.array([decimals_of(row)[1] for row in job_rows]).reshape(-1, 1))
    return _number_edits(program, job_rows, values, np.broadcast_to(digits, values.shape), written)


def _external_edits(
    program: ChangeableProgram, rows: NDArray[np.int64], external: Array | None
) -> list[Edit]:
    """Return the edits of base and station axes, which stand in rows of their own."""
    if external is None:
        return []
    columns, edits = program.positions.external_columns, []
    for row, values in zip(rows.tolist(), external, strict=True):
        for name, of_kind in (("B", BASE_ROWS), ("S", STATION_ROWS)):
            numbers = [
                value
                for column, value in zip(columns, values.tolist(), strict=True)
                if column.name[0] == name
            ]
            if np.isnan(numbers).all():
                continue
            for alone in (each for each in program.alone if each[:2] in of_kind):
                raise ProgramFileError(
                    program.file,
                    make_message(
                        "the axes go to {row} without the robot, and stay there as they are.", row=alone
                    ),
                    line=program.alone[alone],
                    remedy="Give the motion a position of the robot, or correct the row by hand.",
                )
            beside = program.external_row(row, of_kind)
            if beside is None:
                raise ProgramFileError(
                    program.file,
                    make_message(
                        "{names} has no row of its base or station axes.", names=program.positions.names[row]
                    ),
                    line=program.rows[row].line,
                    remedy="Leave this position out of the change.",
                )
            unit = ROW_UNITS.get(beside.state.mode, 1.0)
            written = [value / unit for value in numbers[: beside.text.count(",") + 1]]
            digits = [0 if beside.state.mode == "PULSE" else _EXTERNAL_DIGITS] * len(written)
            edits += _one_by_one(beside, written, digits)
    return edits


def _number_edits(
    program: ChangeableProgram, rows: list[JobRow], values: Array, digits: NDArray[np.int64], written: Array
) -> list[Edit]:
    """Return the edits that make rows say values; a number that says its value already keeps its text."""
    _refuse_large(program, rows, values)
    steps = 10.0**-digits
    same = np.abs(values - written) <= 0.5 * steps * (1 - 1e-9)
    rounded = np.where(same, written, np.round(values / steps) * steps + 0.0)
    edits: list[Edit] = []
    for row, numbers, places in zip(rows, rounded.tolist(), digits.tolist(), strict=True):
        text = _whole_row(row, numbers, places[-1])
        if text is None:
            edits += _one_by_one(row, numbers, places)
        elif text != row.text:
            edits.append((row.start, row.text, text))
    return edits


def _refuse_large(program: ChangeableProgram, rows: list[JobRow], values: Array) -> None:
    limits = np.array([_LARGEST_PULSES if row.state.mode == "PULSE" else _LARGEST_MM for row in rows])
    for i in np.flatnonzero((np.abs(values) > limits[:, None]).any(axis=1))[:1].tolist():
        raise ProgramFileError(
            program.file,
            make_message(
                "{rows_kind}{rows_number} cannot take {nanmax:.3f}.",
                rows_kind=rows[i].kind,
                rows_number=rows[i].number,
                nanmax=np.nanmax(np.abs(values[i])),
            ),
            line=rows[i].line,
            remedy="Check the change: lengths are metres, angles radians.",
        )


def _whole_row(row: JobRow, numbers: list[float], digits: int) -> str | None:
    """Return the row in a controller's own format; None where it is not written in that."""
    if row.state.mode == "PULSE":
        plain = _PULSES.fullmatch(row.text) is not None
        present = numbers[: row.text.count(",") + 1]
        return ",".join([str(round(number)) for number in present]) if plain else None
    if row.state.mode != "RECTAN" or digits not in USUAL or not USUAL[digits].fullmatch(row.text):
        return None
    return _FORMATS[digits] % tuple(numbers)


def _one_by_one(row: JobRow, numbers: list[float], digits: list[int]) -> list[Edit]:
    edits, at = [], row.start
    for piece, value, decimals in zip(row.text.split(","), numbers, digits, strict=False):
        old = piece.strip()
        new = _write_value(old, value, decimals)
        if new != old:
            edits.append((at + len(piece) - len(piece.lstrip()), old, new))
        at += len(piece) + 1
    return edits


def _write_value(old: str, value: float, decimals: int) -> str:
    """Write a value with some decimals in the old one's clothes; a number that says it already stays."""
    if value == float(old):
        return old
    text = f"{value:.{decimals}f}"
    if old[0] not in "+." and not old.startswith("-."):
        return text
    form = NumberFormat.from_text(old)
    text = f"+{text}" if form.plus and not text.startswith("-") else text
    return (
        text.replace("0.", ".", 1) if not form.leading_zero and text.lstrip("+-").startswith("0.") else text
    )
