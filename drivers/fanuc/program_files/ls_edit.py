"""New coordinates written into the spans of the old ones."""

import re
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, is_rigid
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_external import external_edits
from cellcal.drivers.fanuc.program_files.ls_grammar import (
    CARTESIAN,
    CONFIGURATION,
    FIELD,
    JOINTS,
    UNTAUGHT_CARTESIAN,
    UNTAUGHT_JOINTS,
)
from cellcal.drivers.fanuc.program_files.ls_numbers import (
    LARGEST,
    LEAST_DECIMALS,
    NumberStyle,
    all_decimals,
    kept_decimals,
)
from cellcal.drivers.fanuc.program_files.ls_orientation import new_coordinates
from cellcal.drivers.fanuc.program_files.ls_positions import REMOTE
from cellcal.drivers.fanuc.program_files.ls_records import ListingFile
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN as CARTESIAN_KIND
from cellcal.drivers.programs.positions import JOINTS as JOINTS_KIND
from cellcal.drivers.programs.positions import PositionChange, Positions

Edit = tuple[int, int, bytes]  # from, to, what stands there then
_BLOCK = 5000  # positions whose new texts are in memory at once
_PER_UNIT = {b"mm": 1e3, b"deg": 180.0 / np.pi}


def edit_listing(
    place: ListingFile,
    body: tuple[int, int],
    positions: Positions,
    offsets: NDArray[np.int64],
    change: PositionChange,
) -> bytes:
    """Return the file with the change; `LsProgram.changed` says what it raises."""
    rows = _checked_rows(place, positions, change)
    blocks = RecordTexts(place, body, positions, offsets)
    in_order = np.argsort(offsets[rows], kind="stable")
    pieces, at = [], 0
    for first in range(0, len(rows), _BLOCK):
        edits = sorted(_make_edits(blocks, _select_changes(change, in_order[first : first + _BLOCK])))
        new = []
        for start, end, text in edits:
            new += [place.data[at:start], text]
            at = end
        pieces.append(b"".join(new))
    return b"".join([*pieces, place.data[at:]])


def _select_changes(change: PositionChange, chosen: NDArray[np.int64]) -> PositionChange:
    return PositionChange(
        np.asarray(change.rows, dtype=np.int64)[chosen],
        None if change.frame_tip is None else np.asarray(change.frame_tip, dtype=float)[chosen],
        None if change.joints is None else np.asarray(change.joints, dtype=float)[chosen],
        None if change.configurations is None else [change.configurations[i] for i in chosen],
        None if change.user_frames is None else [change.user_frames[i] for i in chosen],
        None if change.external is None else np.asarray(change.external, dtype=float)[chosen],
    )


def _make_edits(blocks: "RecordTexts", change: PositionChange) -> Iterator[Edit]:
    if change.frame_tip is not None:
        yield from _pose_edits(blocks, change.rows, change.frame_tip)
    if change.joints is not None:
        yield from _joint_edits(blocks, change.rows, change.joints)
    if change.configurations is not None:
        yield from _configuration_edits(blocks, change.rows, change.configurations)
    if change.external is not None:
        yield from external_edits(blocks, change.rows, change.external)
    if change.user_frames is not None:
        yield from _user_frames(blocks, change.rows, change.user_frames)


class RecordTexts:
    """The text of each position again, to find the spans of its numbers."""

    def __init__(
        self, place: ListingFile, body: tuple[int, int], positions: Positions, offsets: NDArray[np.int64]
    ) -> None:
        self.place, self.body, self.positions, self.offsets = place, body, positions, offsets
        self.style = NumberStyle.from_listing(place.data, *body)

    def match_cartesian(self, row: int) -> re.Match[bytes]:
        """Return the text of a taught Cartesian position: groups 5 to 10 are its numbers."""
        at, end = int(self.offsets[row]), self.body[1]
        found = CARTESIAN.match(self.place.data, at, end) or UNTAUGHT_CARTESIAN.match(
            self.place.data, at, end
        )
        if found is None or self.positions.kinds[row] != CARTESIAN_KIND:
            raise self.row_error(
                row, make_message("is {kinds}, and takes no pose.", kinds=self.positions.kinds[row])
            )
        return found

    def match_joints(self, row: int) -> re.Match[bytes]:
        """Return the text of a taught joint position: group 5 holds its joints."""
        at, end = int(self.offsets[row]), self.body[1]
        found = JOINTS.match(self.place.data, at, end) or UNTAUGHT_JOINTS.match(self.place.data, at, end)
        if found is None or self.positions.kinds[row] != JOINTS_KIND:
            raise self.row_error(
                row, make_message("is {kinds}, and takes no joints.", kinds=self.positions.kinds[row])
            )
        return found

    def match_any_form(self, row: int) -> re.Match[bytes]:
        """Return the text of a position in whatever form: groups 1 to 4 are GP, UF, UT and CONFIG."""
        if self.positions.kinds[row] == REMOTE:
            raise self.row_error(row, make_message("is {kinds}, and takes no pose.", kinds=REMOTE))
        at, end = int(self.offsets[row]), self.body[1]
        for pattern in (CARTESIAN, JOINTS, UNTAUGHT_CARTESIAN, UNTAUGHT_JOINTS):
            if found := pattern.match(self.place.data, at, end):
                return found
        raise self.row_error(row, "is not where it was.")

    def row_error(self, row: int, message: str, remedy: str = "") -> ProgramFileError:
        where = self.positions
        return ProgramFileError(
            self.place.file,
            make_message(
                "{names} of group {groups} {message}",
                names=where.names[row],
                groups=where.groups[row],
                message=message,
            ),
            line=int(where.lines[row]),
            column=1,
            remedy=remedy,
        )

    def write_number(self, row: int, old: bytes, value: float) -> bytes:
        """Return a new number in the file's style."""
        if not abs(value) < LARGEST:
            raise self.row_error(
                row,
                make_message("cannot hold the number {value:g}.", value=value),
                "Check the frame and the shift.",
            )
        return self.style.write_value(old, value)


def _checked_rows(place: ListingFile, positions: Positions, change: PositionChange) -> NDArray[np.int64]:
    rows = np.asarray(change.rows, dtype=np.int64)
    inside = (rows >= 0) & (rows < len(positions))
    if rows.ndim != 1 or not inside.all() or len(np.unique(rows)) < len(rows):
        raise ProgramFileError(place.file, "the rows of a change must be positions of this file, each once.")
    columns = (
        change.frame_tip,
        change.joints,
        change.configurations,
        change.user_frames,
        change.external,
    )
    if any(values is not None and len(values) != len(rows) for values in columns):
        raise ProgramFileError(place.file, "a change must have one value for each of its rows.")
    return rows


def _pose_edits(blocks: RecordTexts, rows: NDArray[np.int64], frame_tip: Array) -> Iterator[Edit]:
    if frame_tip.shape != (len(rows), 4, 4):
        raise ProgramFileError(
            blocks.place.file,
            make_message("poses must be 4 x 4 matrices, not {shape}.", shape=frame_tip.shape),
        )
    is_given = ~np.isnan(frame_tip).all(axis=(1, 2))
    rows, frame_tip = rows[is_given], frame_tip[is_given]
    if not len(rows):
        return
    _check_rigid(blocks, rows, frame_tip)
    found = [blocks.match_cartesian(int(row)) for row in rows]
    texts = [text for block in found for text in block.groups()[4:10]]
    old = np.array(list(map(float, texts))).reshape(-1, 6)
    places = np.maximum(all_decimals(texts).reshape(-1, 6), LEAST_DECIMALS)
    new, differs = new_coordinates(frame_tip, old, places)
    for row, block, values, others in zip(rows.tolist(), found, new.tolist(), differs.tolist(), strict=True):
        for field in range(6):
            if others[field]:
                start, end = block.span(5 + field)
                yield start, end, blocks.write_number(row, block[5 + field], values[field])


def _check_rigid(blocks: RecordTexts, rows: NDArray[np.int64], frame_tip: Array) -> None:
    if is_rigid(frame_tip):
        return
    for row, pose in zip(rows, frame_tip, strict=True):
        if not is_rigid(pose):
            raise blocks.row_error(int(row), "is given a pose that is no finite, rigid transform.")


def _joint_edits(blocks: RecordTexts, rows: NDArray[np.int64], joints: Array) -> Iterator[Edit]:
    if joints.ndim != 2:
        raise ProgramFileError(
            blocks.place.file,
            make_message("joints must be rows of numbers, not {shape}.", shape=joints.shape),
        )
    for row, values in zip(rows.tolist(), joints, strict=True):
        if np.isnan(values).all():
            continue
        block = blocks.match_joints(row)
        fields = list(FIELD.finditer(block[5]))
        requested = values[: len(fields)]
        if (
            len(requested) < len(fields)
            or not np.isfinite(requested).all()
            or np.isfinite(values[len(fields) :]).any()
        ):
            raise blocks.row_error(
                row,
                make_message(
                    "has {field_count} joints and wants as many finite numbers.", field_count=len(fields)
                ),
            )
        for found, value in zip(fields, requested.tolist(), strict=True):
            new = value * _PER_UNIT[found[4]]
            if abs(new - float(found[3])) > 0.5 * 10.0 ** -kept_decimals(found[3]) * (1 - 1e-9):
                start = block.start(5)
                yield start + found.start(3), start + found.end(3), blocks.write_number(row, found[3], new)


def _configuration_edits(
    blocks: RecordTexts, rows: NDArray[np.int64], configurations: Sequence[str]
) -> Iterator[Edit]:
    for row, text in zip(rows.tolist(), configurations, strict=True):
        if text == blocks.positions.configurations[row]:
            continue
        start, end = blocks.match_any_form(row).span(4)
        if start < 0 or not text or CONFIGURATION.fullmatch(text) is None:
            raise blocks.row_error(
                row,
                make_message("cannot take the configuration {text!r}.", text=text),
                "Write it as 'N U T, 0, 0, 0'.",
            )
        yield start, end, text.encode()


def _user_frames(blocks: RecordTexts, rows: NDArray[np.int64], user_frames: Sequence[str]) -> Iterator[Edit]:
    for row, text in zip(rows.tolist(), user_frames, strict=True):
        if text == blocks.positions.user_frames[row]:
            continue
        if re.fullmatch(r"[0-9]{1,3}", text) is None:
            raise blocks.row_error(
                row,
                make_message("cannot take the user frame {text!r}.", text=text),
                "A user frame is a number.",
            )
        start, end = blocks.match_any_form(row).span(2)
        yield start, end, text.encode()
