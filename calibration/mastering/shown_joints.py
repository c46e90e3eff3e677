"""Joints as a controller shows them, where its interaction matrix tells the angles of the links.

FANUC's interaction matrix gives link angles: joint 2 is counted the other way there, and where the motor of joint 3
follows the sum J3 + J2, the matrix gives that sum. The pendant, position files and this product count joints as
shown.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array

_SECOND, _THIRD = 1, 2
_THREE_AXES = 3


@dataclass(frozen=True, slots=True)
class JointConvention:
    """Relation of shown joints to link angles: signs first, then J2 is taken from joint 3 where that is coupled."""

    signs: tuple[int, ...]
    third_follows_second: bool

    def to_shown_matrix(self, radians_per_count: Array) -> Array:
        """Return shown joint [rad] per count, from the link angle per count."""
        matrix: Array = np.array(self.signs, dtype=float)[:, np.newaxis] * np.asarray(
            radians_per_count, dtype=float
        )
        if self.third_follows_second:
            matrix[_THIRD] -= matrix[_SECOND]
        return matrix

    def shown_from_links(self, links_rad: Sequence[float]) -> tuple[float, ...]:
        """Return shown joints from link angles [rad]."""
        return tuple(
            float(v) for v in self.to_shown_matrix(np.diag(np.asarray(links_rad, dtype=float))).sum(1)
        )


@dataclass(frozen=True, slots=True)
class ConventionSearch:
    """The conventions that reproduce the shown joints; ``misses_rad`` are those of the nearest one."""

    matching: tuple[JointConvention, ...]
    misses_rad: tuple[float, ...]


def find_conventions(
    radians_per_count: Array,
    signs: Sequence[Sequence[int]],
    moved_counts: Sequence[int],
    shown_rad: Sequence[float],
    tolerance_rad: float,
) -> ConventionSearch:
    """Return every convention under which counts since joint zero give the joints that are shown.

    ``signs`` are the sets of signs that come into question, the likeliest first.
    """
    matching, nearest = [], np.full(len(shown_rad), np.inf)
    for convention in list_conventions(signs):
        joints = convention.to_shown_matrix(radians_per_count) @ np.asarray(moved_counts, dtype=float)
        misses = joints - np.asarray(shown_rad, dtype=float)
        if np.isfinite(misses).all() and float(np.abs(misses).max()) <= tolerance_rad:
            matching.append(convention)
        if float(np.abs(misses).max()) < float(np.abs(nearest).max()):
            nearest = misses
    return ConventionSearch(tuple(matching), tuple(float(miss) for miss in nearest))


def list_conventions(signs: Sequence[Sequence[int]]) -> Iterator[JointConvention]:
    """Return every convention with one of these sets of signs, the likeliest first."""
    for each in dict.fromkeys(tuple(row) for row in signs):
        if len(each) >= _THREE_AXES:
            yield JointConvention(each, third_follows_second=True)
        yield JointConvention(each, third_follows_second=False)
