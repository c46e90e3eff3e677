"""Columns of positions from records: texts in mm and degrees become metres and radians."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.fanuc.program_files.ls_external import ExternalUnits, note_units, with_external_columns
from cellcal.drivers.fanuc.program_files.ls_numbers import LEAST_DECIMALS, all_decimals, kept_decimals
from cellcal.drivers.fanuc.program_files.ls_records import (
    AxisText,
    CoordinateForm,
    ListingFile,
    PositionRecord,
    is_configuration,
    is_number,
    read_records,
)
from cellcal.drivers.fanuc.program_files.ls_usual import usual_records
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, NO_NUMBER, UNREAD, UNTAUGHT, Positions

_BLOCK = 20_000
_SCALE = {b"mm": 1e-3, b"deg": np.pi / 180.0}
REMOTE = "remote"  # of a tool that stands in the cell: not moved
_KIND = {
    CoordinateForm.CARTESIAN: CARTESIAN,
    CoordinateForm.JOINTS: JOINTS,
    CoordinateForm.UNTAUGHT: UNTAUGHT,
    CoordinateForm.BROKEN: UNREAD,
    CoordinateForm.REMOTE: REMOTE,
}
_NO_CONFIGURATION = "its configuration {text!r} is none such as 'N U T, 0, 0, 0', and it is not read"
_DIGITS_UNSAID = 3  # $LUPS_DIGIT as it leaves the factory


def axis_value_si(axis: AxisText) -> float:
    """Return an axis' value [rad or m], NaN where it is not taught or no number."""
    return float(axis.text) * _SCALE[axis.unit] if is_number(axis.text) else float("nan")


@dataclass
class _RecordColumns:
    """Columns that grow while the records are read, block by block, so that texts do not pile up."""

    numbers: list[int] = field(default_factory=list)
    groups: list[int] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)
    user_frames: list[str | None] = field(default_factory=list)
    tools: list[str | None] = field(default_factory=list)
    configurations: list[str] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    joints: list[Array] = field(default_factory=list)
    external: list[Array] = field(default_factory=list)
    units: ExternalUnits = field(default_factory=dict)  # of external axes, by name
    resolutions: list[Array] = field(default_factory=list)


def positions_of(
    place: ListingFile, start: int, end: int
) -> tuple[Positions, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Return the positions between two offsets, and for each the offset of its coordinates in the file.

    Raises
    ------
    ProgramFileError
        Something is not understood, or a position stands in the file twice.
    """
    columns = _usual_columns(place, start, end) or _read_columns(place, read_records(place, start, end))
    _refuse_twice(place, columns)
    return _assemble_positions(columns), np.array(columns.offsets, dtype=np.int64)


def _usual_columns(place: ListingFile, start: int, end: int) -> _RecordColumns | None:
    """Return the columns of a file whose positions are all written as usual."""
    columns, words = _RecordColumns(), dict[bytes, str]()
    breaks = np.flatnonzero(np.frombuffer(place.data, dtype=np.uint8) == ord("\n"))
    for block in usual_records(place, start, end):
        if block is None:
            return None
        columns.lines += (np.searchsorted(breaks, block.number_at) + 1).tolist()
        columns.numbers += block.position_numbers
        columns.groups += block.motion_groups
        columns.kinds += [CARTESIAN] * len(block)
        columns.offsets += block.coordinate_offsets.tolist()
        columns.user_frames += [_frame_name(text, words) for text in block.user_frames]
        columns.tools += [_frame_name(text, words) for text in block.tool_texts]
        columns.configurations += [_decode_word(text, words) for text in block.configuration_texts]
        poses, digits = poses_of(*block.values_and_decimals())
        columns.poses.append(poses)
        columns.joints.append(np.zeros((len(block), 0)))
        columns.external.append(np.zeros((len(block), 0)))
        columns.resolutions.append(decimal_resolutions(digits))
    return columns


def _read_columns(place: ListingFile, found: Iterable[PositionRecord]) -> _RecordColumns:
    columns, rest, line, at = _RecordColumns(), iter(found), 1, 0
    words: dict[bytes, str] = {}
    while block := list(islice(rest, _BLOCK)):
        for record in block:
            line += place.data.count(b"\n", at, record.start)
            at = record.start
            columns.lines.append(line)
        columns.numbers += [record.number for record in block]
        columns.groups += [record.group for record in block]
        columns.kinds += [_KIND[record.form] for record in block]
        columns.offsets += [record.offset for record in block]
        columns.user_frames += [_frame_name(record.user_frame, words) for record in block]
        columns.tools += [_frame_name(record.tool, words) for record in block]
        columns.configurations += [_decode_word(record.configuration, words) for record in block]
        _add_numbers(columns, block)
    return columns


def _decode_word(text: bytes, words: dict[bytes, str]) -> str:
    if text not in words:
        words[text] = text.decode("cp437")
    return words[text]


def _frame_name(text: bytes, words: dict[bytes, str]) -> str | None:
    return None if text == b"F" else _decode_word(text, words)


def _add_numbers(columns: _RecordColumns, block: Sequence[PositionRecord]) -> None:
    taught = np.array([record.form is CoordinateForm.CARTESIAN for record in block])
    texts = [text for record in block if record.form is CoordinateForm.CARTESIAN for text in record.cartesian]
    values = np.array(list(map(float, texts))).reshape(-1, 6)
    poses = np.full((len(block), 4, 4), np.nan)
    digits = np.full((len(block), 2), _DIGITS_UNSAID)
    poses[taught], digits[taught] = poses_of(values, all_decimals(texts).reshape(-1, 6))
    columns.poses.append(poses)
    columns.joints.append(_axis_values(block, b"J"))
    columns.external.append(_axis_values(block, b"E"))
    note_units(columns.units, block)
    _axis_digits(block, digits)
    columns.resolutions.append(decimal_resolutions(digits))


def poses_of(values: Array, places: Array) -> tuple[Array, Array]:
    """Return poses (N, 4, 4) and the decimals (N, 2) of lengths and angles, from (N, 6) in mm and deg."""
    poses = homogeneous_matrix(rotation_from("fanuc_wpr", np.radians(values[:, 3:])), 1e-3 * values[:, :3])
    return poses, np.column_stack([places[:, :3].min(axis=1), places[:, 3:].min(axis=1)])


def decimal_resolutions(digits: NDArray[np.number]) -> Array:
    """Return one unit of the last decimal that a new value gets (N, 2) [m, rad]."""
    found: Array = 10.0 ** -np.maximum(digits.astype(float), LEAST_DECIMALS) * [1e-3, np.pi / 180.0]
    return found


def _axis_values(block: Sequence[PositionRecord], letter: bytes) -> Array:
    found = [(i, axis) for i, record in enumerate(block) for axis in record.axes if axis.letter == letter]
    values = np.full((len(block), max((axis.number for _, axis in found), default=0)), np.nan)
    for i, axis in found:
        if block[i].form not in (CoordinateForm.UNTAUGHT, CoordinateForm.BROKEN):
            values[i, axis.number - 1] = axis_value_si(axis)
    return values


def _axis_digits(
    block: Sequence[PositionRecord], digits: np.ndarray[tuple[int, int], np.dtype[np.int64]]
) -> None:
    for i, record in enumerate(block):
        if record.form is CoordinateForm.JOINTS:
            for column, unit in enumerate((b"mm", b"deg")):
                digit_texts = [
                    kept_decimals(axis.text)
                    for axis in record.axes
                    if axis.unit == unit and axis.letter == b"J"
                ]
                digits[i, column] = min(digit_texts, default=_DIGITS_UNSAID)


def _refuse_twice(place: ListingFile, columns: _RecordColumns) -> None:
    keys = np.array(columns.numbers, dtype=np.int64) * 16 + np.array(columns.groups, dtype=np.int64)
    unique, first = np.unique(keys, return_index=True)
    if len(unique) < len(keys):
        row = int(np.setdiff1d(np.arange(len(keys)), first)[0])
        raise place.error_at(
            columns.offsets[row],
            make_message(
                "P[{numbers}] stands here a second time, in group {groups}.",
                numbers=columns.numbers[row],
                groups=columns.groups[row],
            ),
            "Remove one of the two.",
        )


def _assemble_positions(columns: _RecordColumns) -> Positions:
    count = len(columns.numbers)
    resolution = np.concatenate(columns.resolutions) if count else np.zeros((0, 2))
    positions = Positions(
        names=tuple(f"P[{number}]" for number in columns.numbers),
        kinds=tuple(columns.kinds),
        lines=np.array(columns.lines, dtype=np.int64),
        groups=np.array(columns.groups, dtype=np.int64),
        frame_tip=np.concatenate(columns.poses) if count else np.zeros((0, 4, 4)),
        joints=_side_by_side(columns.joints, count),
        external=_side_by_side(columns.external, count),
        user_frames=tuple(columns.user_frames),
        tools=tuple(columns.tools),
        configurations=tuple(columns.configurations),
        resolution_m=resolution[:, 0],
        resolution_rad=resolution[:, 1],
        barred={
            row: NO_NUMBER if is_configuration(text) else make_message(_NO_CONFIGURATION, text=text)
            for row, (kind, text) in enumerate(zip(columns.kinds, columns.configurations, strict=True))
            if kind == UNREAD
        },
    )
    return with_external_columns(positions, columns.units)


def _side_by_side(blocks: Sequence[Array], count: int) -> Array:
    """Return all blocks under each other, as wide as the widest."""
    whole = np.full((count, max((block.shape[1] for block in blocks), default=0)), np.nan)
    starts = chain([0], np.cumsum([len(block) for block in blocks], dtype=int))
    for start, block in zip(starts, blocks, strict=False):
        whole[start : start + len(block), : block.shape[1]] = block
    return whole
