"""Many listings read or changed together: what is of fixed width in columns, any other one alone."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, is_rigid
from cellcal.drivers.fanuc.program_files.ls_digits import Characters, Flags, written_digits
from cellcal.drivers.fanuc.program_files.ls_fixed import (
    FixedPatterns,
    FixedRecords,
    ListingBody,
    Places,
    RecordPattern,
    join_files,
    records_at,
)
from cellcal.drivers.fanuc.program_files.ls_numbers import LEAST_DECIMALS
from cellcal.drivers.fanuc.program_files.ls_orientation import new_coordinates
from cellcal.drivers.fanuc.program_files.ls_positions import decimal_resolutions, poses_of
from cellcal.drivers.programs.positions import CARTESIAN, PositionChange, Positions

_AT_ONCE = 16_384
Word = TypeVar("Word", str, str | None)
FixedRead: TypeAlias = tuple[
    Positions, Places, FixedPatterns
]  # positions, where their coordinates begin, how they are written


def read_fixed(bodies: Sequence[ListingBody]) -> list[FixedRead | None]:
    """Return of each listing its positions, the offsets of their coordinates and how they are written.

    None for a listing that holds anything but records of fixed width, each number once.
    """
    records = FixedRecords(bodies)
    patterns, of = tuple(records.patterns), records.pattern_of
    poses, digits = poses_of(records.values, records.coordinate_decimals())
    resolution, groups = decimal_resolutions(digits), records.motion_groups()
    names = [f"P[{number}]" for number in records.numbers.tolist()]
    frames = _record_words([_frame_name(pattern.user_frame) for pattern in patterns], of)
    tools = _record_words([_frame_name(pattern.tool) for pattern in patterns], of)
    texts = _record_words([pattern.configuration.decode("cp437") for pattern in patterns], of)
    lines, none = _record_lines(records), np.zeros((len(of), 0))
    complete, styles = records.is_complete().tolist(), records.number_styles()
    found: list[FixedRead | None] = []
    for number, (first, beyond) in enumerate(pairwise(records.bounds.tolist())):
        if not complete[number]:
            found.append(None)
            continue
        its = slice(first, beyond)
        positions = Positions(
            names=tuple(names[its]),
            kinds=(CARTESIAN,) * (beyond - first),
            lines=lines[its],
            groups=groups[its],
            frame_tip=poses[its],
            joints=none[its],
            external=none[its],
            user_frames=tuple(frames[its]),
            tools=tuple(tools[its]),
            configurations=tuple(texts[its]),
            resolution_m=resolution[its, 0],
            resolution_rad=resolution[its, 1],
        )
        found.append((positions, records.offsets[its], FixedPatterns(patterns, of[its], styles[number])))
    return found


def _record_words(words: Sequence[Word], of: NDArray[np.int16]) -> list[Word]:
    """Return each record's word; whatever for a record without a pattern, which is not used."""
    return list(np.array([*words, ""], dtype=object)[of].tolist())


def _frame_name(text: bytes) -> str | None:
    return None if text == b"F" else text.decode("cp437")


def _record_lines(records: FixedRecords) -> Places:
    """Return the line of each record in its file, from 1."""
    breaks = np.flatnonzero(records.characters == ord("\n"))
    before = np.searchsorted(breaks, records.shifts)[records.of]
    found: Places = np.searchsorted(breaks, records.starts + records.shifts[records.of]) - before + 1
    return found


@dataclass(frozen=True, eq=False)
class RecordRewrite:
    """Records of fixed width, K of them changed, in a listing."""

    data: bytes
    opens: Places  # (K,) where the texts of those changed begin
    patterns: tuple[RecordPattern, ...]
    of: NDArray[np.int16]  # (K,) which pattern
    leading_zero: bool
    frame_tip: Array  # (K, 4, 4)


def plan_rewrite(data: bytes, read: FixedRead | None, change: PositionChange) -> RecordRewrite | None:
    """Return what is to be written into fields of fixed width; None for a change that takes more than that."""
    more = change.joints, change.configurations, change.user_frames, change.external
    if read is None or change.frame_tip is None or any(each is not None for each in more):
        return None
    positions, offsets, fixed = read
    rows, poses = np.asarray(change.rows), np.asarray(change.frame_tip, dtype=float)
    rows_valid = rows.ndim == 1 and len(rows) and rows.min() >= 0 and rows.max() < len(positions)
    if (
        not rows_valid
        or poses.shape != (len(rows), 4, 4)
        or not (fixed.style.padded and (np.diff(rows) > 0).all())
    ):
        return None
    used = set(fixed.of[rows].tolist())
    if min(int(fixed.patterns[each].coordinate_decimals.min()) for each in used) < LEAST_DECIMALS:
        return None  # a new value has more digits than its field
    return RecordRewrite(data, offsets[rows], fixed.patterns, fixed.of[rows], fixed.style.leading_zero, poses)


def rewrite_listings(some: Sequence[RecordRewrite]) -> list[bytes | None]:
    """Return the listings with their new coordinates; None where a number does not fit or a pose is none."""
    if not some:
        return []
    characters, shifts = join_files([one.data for one in some])
    characters = characters.copy()
    counts = [len(one.of) for one in some]
    whose = np.repeat(np.arange(len(some)), counts)
    work = _RewriteRows(
        np.concatenate([one.opens for one in some]) + shifts[whose],
        np.concatenate([one.frame_tip for one in some]),
        np.repeat([one.leading_zero for one in some], counts),
    )
    good = np.zeros(len(whose), dtype=bool)
    for pattern, rows in _by_pattern(some):
        for first in range(0, len(rows), _AT_ONCE):
            part = rows[first : first + _AT_ONCE]
            good[part] = _rewrite_records(characters, pattern, work.select_rows(part))
    bad = np.bincount(whose, ~good, minlength=len(some)) > 0
    edges = [*shifts.tolist(), len(characters)]
    return [
        None if failed else characters[first:beyond].tobytes()
        for failed, (first, beyond) in zip(bad.tolist(), pairwise(edges), strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _RewriteRows:
    opens: Places
    frame_tip: Array
    leading_zero: Flags

    def select_rows(self, rows: NDArray[np.intp]) -> "_RewriteRows":
        return _RewriteRows(self.opens[rows], self.frame_tip[rows], self.leading_zero[rows])


def _by_pattern(some: Sequence[RecordRewrite]) -> Iterator[tuple[RecordPattern, NDArray[np.intp]]]:
    numbers: dict[RecordPattern, int] = {}
    parts = []
    for one in some:
        its = [numbers.setdefault(pattern, len(numbers)) for pattern in one.patterns]
        parts.append(np.array(its)[one.of])
    of = np.concatenate(parts)
    for pattern, number in numbers.items():
        yield pattern, np.flatnonzero(of == number)


def _rewrite_records(characters: Characters, pattern: RecordPattern, rows: _RewriteRows) -> Flags:
    """Write new coordinates into records of one pattern, and tell which could take theirs."""
    if not len(rows.opens) or not is_rigid(rows.frame_tip):
        return np.zeros(len(rows.opens), dtype=bool)
    texts = records_at(characters, rows.opens, len(pattern.text))
    count = len(rows.opens)
    old = np.empty((6, count))
    for which, digits in pattern.read_fields(texts):
        old[which] = digits.values.reshape(-1, count)
    decimals = np.broadcast_to(pattern.coordinate_decimals, (count, 6))
    requested, others = new_coordinates(rows.frame_tip, old.T, decimals)
    new, differs = requested.T, others.T
    good = np.ones(count, dtype=bool)
    for which, (width, point), places in pattern.fields_by_shape:
        values, needs_change = new[which].reshape(-1), differs[which].reshape(-1)
        fields, fits = texts[places].reshape(width, -1), np.ones(len(values), dtype=bool)
        leading_zero = np.tile(rows.leading_zero, len(which))
        fields[:, needs_change], fits[needs_change] = written_digits(
            values[needs_change], (width, point), leading_zero[needs_change]
        )
        good &= fits.reshape(-1, count).all(axis=0)
        texts[places] = fields.reshape(*places.shape, count)
    window = sliding_window_view(characters, len(pattern.text), writeable=True)
    window[rows.opens[good]] = texts.T[good]
    return good
