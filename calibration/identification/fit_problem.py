"""Observations prepared for fits, and in which blocks of rows they are worked on."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from cellcal.calibration.arm.joint_terms import JointTerm, term_values
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Observations, Rows
from cellcal.calibration.identification.parameters import ArmState

_BLOCK = 2048  # postures at once: large enough for BLAS, small enough for the cache
_MOST_CACHED = 10_000_000  # values of joint terms: 80 MB

Block: TypeAlias = tuple[int, Rows | slice]  # mounting and its rows
Span: TypeAlias = tuple[Block, ...]  # blocks whose rows follow each other


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Observations with everything about them that does not change while the parameters do."""

    observations: Observations
    arm: RobotModel  # nominal
    terms: tuple[JointTerm, ...]
    cached_values: Array | None  # (K, N) values of the joint terms; None: too many, made again block by block
    angles_rad: Array  # (n, N): what the joints add to the angles of the nominal arm
    blocks: tuple[Block, ...]
    root: Array | None = None  # (N,) of each row's weight; None weighs all rows alike

    @cached_property
    def joined_blocks(self) -> tuple[Span, ...]:
        """Blocks that are worked on together: the mountings of short series follow each other in the rows."""
        return tuple(_join_blocks(self.blocks))

    def spans_at(self, state: ArmState) -> tuple[Span, ...]:
        """Return the blocks that are worked on together; each target is at the end of a chain of its own."""
        return tuple((block,) for block in self.blocks) if state.further else self.joined_blocks

    @classmethod
    def from_observations(cls, state: ArmState, observations: Observations) -> "FitProblem":
        """Prepare the observations for states with the same nominal arm and joint terms."""
        cached_values = None
        if len(state.terms) * len(observations) <= _MOST_CACHED:
            cached_values = term_values(state.nominal, observations.joints_rad, state.terms)
        angles = state.nominal.joint_coupling @ observations.joints_rad.T
        return cls(
            observations,
            state.nominal,
            state.terms,
            cached_values,
            angles,
            tuple(_iterate_blocks(observations)),
        )

    def term_values_of(self, rows: Rows | slice) -> Array:
        """Return the values of the joint terms in some rows (K, n)."""
        if self.cached_values is not None:
            return self.cached_values[:, rows]
        return term_values(self.arm, self.observations.joints_rad[rows], self.terms)

    def select_rows(self, rows: Rows) -> "FitProblem":
        """Return the same for some of the rows."""
        taken = self.observations.select_rows(rows)
        root = None if self.root is None else self.root[rows]
        cached_values = self.term_values_of(rows) if len(self.terms) * len(taken) <= _MOST_CACHED else None
        angles = self.angles_rad[:, rows]
        return FitProblem(
            taken, self.arm, self.terms, cached_values, angles, tuple(_iterate_blocks(taken)), root
        )

    def channel_scales(self, rows: Rows | slice) -> Array:
        """Return what makes the channels of rows count alike: root of the weight over sigma (channels or 1, N)."""
        scales = self.observations.inverse_sigmas(rows)
        return scales if self.root is None else scales * self.root[rows]


def _iterate_blocks(observations: Observations) -> Iterator[Block]:
    for mounting in range(int(observations.mounting.max(initial=0)) + 1):
        rows = np.flatnonzero(observations.mounting == mounting)
        for start in range(0, len(rows), _BLOCK):
            yield mounting, _as_slice(rows[start : start + _BLOCK])


def _as_slice(rows: Rows) -> Rows | slice:
    """Return rows that follow each other as a slice, which is looked at and not copied."""
    first, last = int(rows[0]), int(rows[-1])
    return slice(first, last + 1) if last - first + 1 == len(rows) else rows


def _join_blocks(blocks: tuple[Block, ...]) -> Iterator[Span]:
    """Yield blocks together that follow each other in the rows and are no more than one block's rows in all."""
    span: list[Block] = []
    for block in blocks:
        if span and not _continues(span, block[1]):
            yield tuple(span)
            span = []
        span.append(block)
    if span:
        yield tuple(span)


def _continues(span: list[Block], rows: Rows | slice) -> bool:
    first, last = span[0][1], span[-1][1]
    if not (isinstance(rows, slice) and isinstance(first, slice) and isinstance(last, slice)):
        return False
    return bool(rows.start == last.stop and rows.stop - first.start <= _BLOCK)


def places_in_span(span: Span) -> Iterator[slice]:
    """Yield where the rows of each block of a span are in its arrays."""
    start = 0
    for _, rows in span:
        count = rows.stop - rows.start if isinstance(rows, slice) else len(rows)
        yield slice(start, start + count)
        start += count


def rows_of_span(span: Span) -> Rows | slice:
    """Return the rows of all blocks of a span."""
    first, last = span[0][1], span[-1][1]
    return slice(first.start, last.stop) if isinstance(first, slice) and isinstance(last, slice) else first
