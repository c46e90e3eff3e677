"""Text of a program with the places of its numbers: new numbers go in, every other byte stays."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from math import floor, isfinite, log10
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.line_numbers import LineNumbers
from cellcal.drivers.programs.numbers import NumberFormat
from cellcal.drivers.programs.positions import PositionChange, Positions

Edit = tuple[int, int, str]  # from, to, what stands there from now on

_PLAIN = re.compile(r"-?\d+(?:\.\d+)?")
_LONGEST_NUMBER = 40  # characters; no controller writes more
_LARGEST = 1e7  # mm or degrees; no robot goes there
_MOST_DIGITS = 15


class ProgramText:
    """A program's bytes as text, one character a byte, and where its lines begin."""

    def __init__(self, name: str, data: bytes) -> None:
        if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise ProgramFileError(
                name, "this is UTF-16.", remedy="Save it as the controller writes it: ANSI."
            )
        self.name = name
        self.data = data
        self.text = data.decode("latin-1")

    @cached_property
    def lines(self) -> LineNumbers:
        """The lines of the text."""
        return LineNumbers(self.text)

    def line_of(self, place: int) -> int:
        """Return the line, from 1, of a place in the text."""
        return self.lines.line_of(place)

    def error_at(self, place: int, message: str, *, remedy: str = "") -> ProgramFileError:
        """Return an error that says where in the file."""
        line, column = self.line_of(place), self.lines.column_of(place)
        return ProgramFileError(self.name, message, line=line, column=column, remedy=remedy)

    def parse_number(self, place: int, text: str) -> float:
        """Return a number's value.

        Raises
        ------
        ProgramFileError
            It is longer or larger than any that a controller writes.
        """
        value = float(text)
        if not abs(value) < _LARGEST or len(text) > _LONGEST_NUMBER:
            raise self.error_at(
                place,
                make_message("no robot has the coordinate {text}.", text=text[:20]),
                remedy="Correct the number.",
            )
        return value

    def apply_edits(self, edits: Iterable[Edit]) -> bytes:
        """Return the bytes with some spans written anew; the spans do not overlap."""
        pieces, after = [], 0
        for start, end, text in sorted(edits):
            pieces += [self.text[after:start], text]
            after = end
        return "".join([*pieces, self.text[after:]]).encode("latin-1")


def decimals_of(text: str) -> int:
    """Return how many decimals a number gives, its exponent counted."""
    mantissa, _, power = text.lower().partition("e")
    return len(mantissa.partition(".")[2]) - int(power or 0)


def finest_decimals(texts: Iterable[str], least: int) -> int:
    """Return the decimals that coordinates of one kind share: those of the finest, at least ``least``."""
    most = least
    for text in texts:
        point = text.find(".")
        plain = "e" not in text and "E" not in text
        decimals = (len(text) - point - 1 if point >= 0 else 0) if plain else decimals_of(text)
        most = decimals if decimals > most else most
    return min(most, _MOST_DIGITS)


def write_number(text: str, value: float, decimals: int) -> str:
    """Write a value as a language with free numbers may: in the old one's style, to at least ``decimals``.

    Makers of such languages print a coordinate that is zero as ``0`` and a round one without decimals, so the
    decimals of one number say nothing about what it may become. A number that says the value already stays.
    """
    if abs(value - float(text)) <= 0.5 * 10.0**-decimals * (1 - 1e-9):
        return text
    if _PLAIN.fullmatch(text):  # nearly all are
        digits = min(max(len(text.partition(".")[2]), decimals), _MOST_DIGITS)
        return f"{round(value, digits) + 0.0:.{digits}f}"  # no -0.000
    form = NumberFormat.from_text(text)
    digits = max(form.decimals, decimals + (floor(log10(abs(value))) if form.exponent and value else 0), 0)
    digits = min(digits, _MOST_DIGITS)
    rounded = value if form.exponent else round(value, digits) + 0.0
    return replace(form, decimals=digits, point=form.point or digits > 0).write_value(rounded)


@dataclass(frozen=True, slots=True)
class RequestedChange:
    """A change in the units of the file, row by row, as lists: a million rows are gone through one by one."""

    has_pose: list[bool]
    has_joints: list[bool]
    place_mm: list[list[float]]
    moved_mm: list[float]  # the largest of x, y and z
    turned: list[float]  # the largest of the rotation's elements
    joints_deg: list[list[float]]
    has_external: list[bool]
    external: list[list[float]]  # numbers as they stand in a file that writes mm and deg alike

    @classmethod
    def from_change(cls, positions: Positions, rows: NDArray[np.int64], change: PositionChange) -> Self:
        """Compare a change with what is there."""
        nothing = np.full((len(rows), 4, 4), np.nan)
        poses = nothing if change.frame_tip is None else change.frame_tip
        joints = np.full((len(rows), 1), np.nan) if change.joints is None else change.joints
        step = np.abs(poses - positions.frame_tip[rows])
        external = np.full((len(rows), 1), np.nan) if change.external is None else change.external
        return cls(
            has_pose=np.asarray(np.isfinite(poses).any(axis=(1, 2))).tolist(),
            has_joints=np.asarray(np.isfinite(joints).any(axis=1)).tolist(),
            place_mm=(poses[:, :3, 3] * 1e3).tolist(),
            moved_mm=(step[:, :3, 3].max(axis=1) * 1e3).tolist(),
            turned=step[:, :3, :3].max(axis=(1, 2)).tolist(),
            joints_deg=np.rad2deg(joints).tolist(),
            has_external=np.asarray(np.isfinite(external).any(axis=1)).tolist(),
            external=(external * 1e3).tolist(),
        )


def checked_rows(name: str, positions: Positions, change: PositionChange) -> NDArray[np.int64]:
    """Return a change's rows after looking at the shapes of all it brings.

    Raises
    ------
    ProgramFileError
        Rows that are not there or stand twice, another count or shape, a number that is not finite.
    """
    rows = np.asarray(change.rows, dtype=np.int64)
    count = len(rows)
    if rows.ndim != 1 or len(np.unique(rows)) != count or ((rows < 0) | (rows >= len(positions))).any():
        raise ProgramFileError(name, "the change names rows that are not there, or one twice.")
    for values, shape in (
        (change.frame_tip, (count, 4, 4)),
        (change.joints, (count, positions.joints.shape[1])),
        (change.external, (count, len(positions.external_columns))),
    ):
        if values is not None and (values.shape != shape or np.isinf(values).any()):
            raise ProgramFileError(
                name,
                make_message(
                    "the change brings {found_shape} coordinates in place of {expected_shape}.",
                    found_shape=values.shape,
                    expected_shape=shape,
                ),
            )
    for texts in (change.configurations, change.user_frames):
        if texts is not None and len(texts) != count:
            raise ProgramFileError(
                name,
                make_message(
                    "the change brings {text_count} texts for {count} positions.",
                    text_count=len(texts),
                    count=count,
                ),
            )
    if change.frame_tip is not None and not _poses_or_nothing(change.frame_tip):
        raise ProgramFileError(name, "the change brings a pose that is no finite rigid transform.")
    return rows


def _poses_or_nothing(poses: NDArray[np.float64]) -> bool:
    given_poses = poses[~np.isnan(poses).all(axis=(1, 2))]
    if not len(given_poses):
        return True
    rotation = given_poses[:, :3, :3]
    defect = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max()
    return bool(
        isfinite(defect)
        and defect < 1e-6
        and np.isfinite(given_poses).all()
        and (np.linalg.det(rotation) > 0).all()
    )


def unique_names(names: Iterable[str], lines: NDArray[np.int64]) -> tuple[str, ...]:
    """Return names that differ: a second ``XP1`` is ``XP1@42`` after its line, a third there ``XP1@42.2``."""
    used_names: set[str] = set()
    result = []
    for name, line in zip(names, lines.tolist(), strict=True):
        own, number = name, 1
        while own.lower() in used_names:
            own = f"{name}@{line}" if number == 1 else f"{name}@{line}.{number}"
            number += 1
        used_names.add(own.lower())
        result.append(own)
    return tuple(result)
