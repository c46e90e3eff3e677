"""Records of fixed width, of many listings at once: a controller writes nearly all of a million positions so.

Two records of one length that differ in nothing but the digits of their coordinates are read by one pattern, found
in the first of them by the grammar. A listing with any other record is told apart and read record by record.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.drivers.fanuc.program_files.ls_digits import Characters, DigitFields, Flags, read_digits
from cellcal.drivers.fanuc.program_files.ls_grammar import CARTESIAN, CLOSE, CONFIGURATION, HEAD_ALONE
from cellcal.drivers.fanuc.program_files.ls_numbers import NumberStyle
from cellcal.drivers.fanuc.program_files.ls_records import ListingFile

Places = NDArray[np.int64]
_MOST_PATTERNS = 256  # frames, tools and configurations of a line
_MOST_ODD = 64
_LONGEST = 600  # characters of a record
_WIDEST = 15  # of a coordinate: its digits are a double's
_AT_ONCE = 16_384
NO_PATTERN = -1
_BLANKS = b" \t\r\n"
_PLAIN = re.compile(rb" +-?\d*\.\d+")


@dataclass(frozen=True, eq=False)
class RecordPattern:
    """A record as it stands in the file: what is fixed in it, and where its six coordinates are."""

    text: Characters
    group: int
    user_frame: bytes
    tool: bytes
    configuration: bytes
    fields: tuple[tuple[int, int, int], ...]  # of X Y Z W P R: first column, width, column of the point in it

    @classmethod
    def from_text(cls, text: bytes) -> "RecordPattern | None":
        """Return the pattern of a record's text behind its brace; None where it is of another sort."""
        found = CARTESIAN.match(text)
        close = None if found is None else CLOSE.match(text, found.end())
        if found is None or close is None or text[close.end() :].strip(_BLANKS) or found["extended"]:
            return None
        group, user_frame, tool, configuration, *values = found.groups(b"")[:10]
        if not CONFIGURATION.fullmatch(configuration.decode("cp437")) or not all(map(_is_plain, values)):
            return None
        fields = tuple((found.start(5 + i), len(value), value.index(b".")) for i, value in enumerate(values))
        characters = np.frombuffer(text, dtype=np.uint8)
        return cls(characters, int(group or 1), user_frame, tool, configuration, fields)

    @cached_property
    def is_fixed(self) -> Flags:
        """Return which characters are alike in all records: those of no coordinate, and its point."""
        found = np.ones(len(self.text), dtype=bool)
        for first, width, point in self.fields:
            found[first : first + width] = False
            found[first + point] = True
        return found

    @cached_property
    def coordinate_decimals(self) -> Array:
        """Return how many decimals each coordinate has, (6,)."""
        return np.array([width - point - 1 for _, width, point in self.fields], dtype=float)

    @cached_property
    def fields_by_shape(self) -> tuple[tuple[list[int], tuple[int, int], NDArray[np.intp]], ...]:
        """The fields of one shape: which (k,), their width and point, and where their characters are (width, k)."""
        found = []
        for width, point in dict.fromkeys((width, point) for _, width, point in self.fields):
            which = [i for i, field in enumerate(self.fields) if field[1:] == (width, point)]
            firsts = np.array([self.fields[i][0] for i in which])
            found.append((which, (width, point), np.arange(width)[:, None] + firsts))
        return tuple(found)

    def read_fields(self, texts: Characters) -> Iterator[tuple[list[int], DigitFields]]:
        """Yield fields of records (length, N), and what they say, (k N,), one field's after the other."""
        for which, (width, point), places in self.fields_by_shape:
            yield which, read_digits(texts[places].reshape(width, -1), point)


@dataclass(frozen=True, eq=False)
class FixedPatterns:
    """The forms of a listing's records, each in a pattern."""

    patterns: tuple[RecordPattern, ...]
    of: NDArray[np.int16]  # (N,) which
    style: NumberStyle


@dataclass(frozen=True, eq=False)
class ListingBody:
    """The records of a listing."""

    place: ListingFile
    start: int
    end: int


class FixedRecords:
    """The N records of some listings, one after the other."""

    def __init__(self, bodies: Sequence[ListingBody]) -> None:
        heads = [_record_heads(body) for body in bodies]
        counts = [len(found) for found in heads]
        self.bounds = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self.of = np.repeat(np.arange(len(bodies)), counts)
        columns = np.array([head for found in heads for head in found], dtype=np.int64).reshape(-1, 3)
        self.starts, self.offsets, self.numbers = columns.T
        self.characters, self.shifts = join_files([body.place.data for body in bodies])
        self._lengths = self._record_ends([body.end for body in bodies]) - self.offsets
        self.whole = np.array(list(map(_begins_with_a_record, bodies, heads)), dtype=bool)
        self.patterns: list[RecordPattern] = []
        self._odd = 0
        self.pattern_of = np.full(len(columns), NO_PATTERN, dtype=np.int16)
        self.values = np.zeros((len(columns), 6))
        self._marks = np.zeros((3, len(columns)), dtype=bool)  # wide, bare, full
        self._match_records()

    def is_complete(self) -> Flags:
        """Return for each listing whether all its records are of fixed width."""
        odd = np.bincount(self.of, self.pattern_of == NO_PATTERN, minlength=len(self.whole))
        keys = (self.of * 10 + self._of_patterns([p.group for p in self.patterns])) * 100_000 + self.numbers
        twice = np.ones(len(keys), dtype=bool)
        twice[np.unique(keys, return_index=True)[1]] = False
        found: Flags = self.whole & (odd == 0) & (np.bincount(self.of, twice, minlength=len(self.whole)) == 0)
        return found

    def number_styles(self) -> list[NumberStyle]:
        """Return how each listing writes its numbers."""
        count = len(self.whole)
        wide, bare, full = (np.bincount(self.of, mark, minlength=count) > 0 for mark in self._marks)
        return [NumberStyle(*style) for style in zip(wide.tolist(), (full & ~bare).tolist(), strict=True)]

    def coordinate_decimals(self) -> Array:
        """Return how many decimals each coordinate has, (N, 6)."""
        found = np.array([pattern.coordinate_decimals for pattern in self.patterns]).reshape(-1, 6)
        return found[self.pattern_of] if len(found) else np.zeros((len(self.of), 6))

    def motion_groups(self) -> NDArray[np.int64]:
        """Return the motion groups (N,)."""
        return self._of_patterns([pattern.group for pattern in self.patterns])

    def _of_patterns(self, values: Sequence[int]) -> NDArray[np.int64]:
        return np.array([*values, 0], dtype=np.int64)[self.pattern_of]

    def _record_ends(self, bodies: Sequence[int]) -> Places:
        """Return where each record's text ends: at the next one's head, or with the body."""
        found = np.append(self.starts[1:], 0)
        last = self.bounds[1:][np.diff(self.bounds) > 0] - 1
        found[last] = np.array(bodies, dtype=np.int64)[self.of[last]]
        return np.asarray(found, dtype=np.int64)

    def _match_records(self) -> None:
        lengths, which = np.unique(self._lengths, return_inverse=True)
        for i, length in enumerate(lengths.tolist()):
            if 0 < length <= _LONGEST:
                rows = np.flatnonzero(which == i)
                for first in range(0, len(rows), _AT_ONCE):
                    self._match_length(rows[first : first + _AT_ONCE], length)

    def _match_length(self, rows: NDArray[np.intp], length: int) -> None:
        """Give records of one length their pattern: those known, then that of the first that is left."""
        texts = records_at(self.characters, (self.offsets + self.shifts[self.of])[rows], length)
        pattern_numbers = [
            number for number, pattern in enumerate(self.patterns) if len(pattern.text) == length
        ]
        while len(rows):
            number = pattern_numbers.pop(0) if pattern_numbers else self._new_pattern(texts[:, 0].tobytes())
            if number == NO_PATTERN:  # untaught, joints, two groups: this record only, while they are few
                self._odd += 1
                if self._odd > _MOST_ODD:
                    return
                rows, texts = rows[1:], texts[:, 1:]
                continue
            pattern = self.patterns[number]
            same = (texts[pattern.is_fixed] == pattern.text[pattern.is_fixed, None]).all(axis=0)
            self._read_records(rows[same], texts if same.all() else texts[:, same], number)
            rows, texts = rows[~same], texts[:, ~same]

    def _new_pattern(self, text: bytes) -> int:
        pattern = RecordPattern.from_text(text) if len(self.patterns) < _MOST_PATTERNS else None
        if pattern is None:
            return NO_PATTERN
        self.patterns.append(pattern)
        return len(self.patterns) - 1

    def _read_records(self, rows: NDArray[np.intp], texts: Characters, number: int) -> None:
        plain = np.ones(len(rows), dtype=bool)
        for which, digits in self.patterns[number].read_fields(texts):
            shape = len(which), len(rows)
            self.values[rows[:, None], which] = digits.values.reshape(shape).T
            plain &= digits.plain.reshape(shape).all(axis=0)
            for mark, flags in zip(self._marks, (digits.wide, digits.bare, digits.full), strict=True):
                mark[rows] |= flags.reshape(shape).any(axis=0)
        self.pattern_of[rows[plain]] = number


def join_files(parts: Sequence[bytes]) -> tuple[Characters, Places]:
    """Return files one after the other, and where each begins."""
    sizes = np.cumsum([0, *map(len, parts)])
    return np.frombuffer(parts[0] if len(parts) == 1 else b"".join(parts), dtype=np.uint8), sizes[:-1]


def records_at(characters: Characters, opens: Places, length: int) -> Characters:
    """Return the texts (length, N) that begin at these places."""
    return np.ascontiguousarray(sliding_window_view(characters, length)[opens].T)


def _record_heads(body: ListingBody) -> list[tuple[int, int, int]]:
    """Return where each head begins and ends, and the number in it."""
    found = HEAD_ALONE.finditer(body.place.data, body.start, body.end)
    return [(*head.span(), int(head[1])) for head in found]


def _begins_with_a_record(body: ListingBody, heads: Sequence[tuple[int, int, int]]) -> bool:
    first = heads[0][0] if heads else body.end
    return not body.place.data[body.start : first].strip(_BLANKS)


def _is_plain(value: bytes) -> bool:
    return len(value) <= _WIDEST and _PLAIN.fullmatch(value) is not None
