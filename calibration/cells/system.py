"""The rows of a cell against its unknowns: residuals and derivatives, series by series, in blocks of postures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.arm.kinematics import (
    frames_of_placements,
    independent_columns,
    twists_by_independent_columns,
)
from cellcal.calibration.cells.cell import CellSeries
from cellcal.calibration.cells.contact_observations import BarLengths, CellObservations
from cellcal.calibration.cells.state import ArmAlongRoute, CellFrames, CellLayout, CellState, FrameRoute
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import PoseObservations, Rows, TipFrames
from cellcal.calibration.identification.parameters import ArmState

_BLOCK = 2048  # postures at once


@dataclass(frozen=True, eq=False)
class PreparedPostures:
    """Quantities of the rows' joints that do not depend on the unknowns."""

    values: Array  # (K, N) of the joint terms
    angles_rad: Array  # (n, N): what the joints add to the angles of the arm

    @classmethod
    def from_joints(cls, arm: ArmState, joints_rad: Array) -> "PreparedPostures":
        """Prepare postures for states with the same nominal arm and joint terms."""
        return cls(term_values(arm.nominal, joints_rad, arm.terms), arm.nominal.joint_coupling @ joints_rad.T)

    def select_rows(self, rows: Rows) -> "PreparedPostures":
        """Return some of them."""
        return PreparedPostures(self.values[:, rows], self.angles_rad[:, rows])


@dataclass(frozen=True, eq=False)
class SeriesRows:
    """The rows of one series, ready for any state of the cell."""

    name: str
    observations: CellObservations
    routes: tuple[FrameRoute, ...]  # by mounting
    device: int
    ends: tuple[PreparedPostures, ...]  # one; two for a bar
    whitener: Array | None  # (N, c, c): makes channels in their sigmas independent

    def __len__(self) -> int:
        return len(self.observations)

    def select_rows(self, rows: Rows) -> "SeriesRows":
        """Return some of the rows."""
        return replace(
            self,
            observations=self.observations.select_rows(rows),
            ends=tuple(end.select_rows(rows) for end in self.ends),
            whitener=None if self.whitener is None else self.whitener[rows],
        )

    def scale_sigmas(self, factors: Array) -> "SeriesRows":
        """Return the rows with sigmas of lengths, and of attitudes, multiplied by factors (1 or 2,)."""
        return replace(self, observations=self.observations.scale_sigma(*(float(f) for f in factors)))

    def iterate_blocks(self) -> Iterator[tuple[int, Rows]]:
        """Yield the mountings and rows of each block."""
        mounting = self.observations.mounting
        for number in range(len(self.routes)):
            rows = np.flatnonzero(mounting == number)
            for start in range(0, len(rows), _BLOCK):
                yield number, rows[start : start + _BLOCK]

    def whiten_values(self, values: Array, rows: Rows) -> Array:
        """Return values (…, channels, N) in their sigmas with covariances taken out."""
        if self.whitener is None:
            return values
        white: Array = np.einsum("nij,...jn->...in", self.whitener[rows], values)
        return white


@dataclass(frozen=True, eq=False)
class CellProblem:
    """All series of a cell."""

    series: tuple[SeriesRows, ...]

    @classmethod
    def from_frames(cls, frames: CellFrames, state: CellState) -> "CellProblem":
        """Prepare every series for states with the same arms and joint terms."""
        return cls(tuple(_series_rows(frames, state, series) for series in frames.cell.series))

    def select_rows(self, rows: Sequence[Rows]) -> "CellProblem":
        """Return some rows of every series."""
        return CellProblem(tuple(s.select_rows(some) for s, some in zip(self.series, rows, strict=True)))

    def with_terms_of(self, state: CellState) -> "CellProblem":
        """Return the same rows for arms with other joint terms."""
        return CellProblem(
            tuple(
                replace(s, ends=_prepare_ends(state.arms[s.routes[0].arm], s.observations))
                for s in self.series
            )
        )


def _series_rows(frames: CellFrames, state: CellState, series: CellSeries) -> SeriesRows:
    observations = series.observations
    mountings = range(len(frames.cell.find_device(series.device).places))
    routes = tuple(frames.find_route(series.target, series.device, mounting) for mounting in mountings)
    return SeriesRows(
        series.name,
        observations,
        routes,
        frames.device_number(series.device),
        _prepare_ends(state.arms[routes[0].arm], observations),
        None if series.covariance is None else _whitening_matrices(observations, series.covariance),
    )


def _prepare_ends(arm: ArmState, observations: CellObservations) -> tuple[PreparedPostures, ...]:
    first = PreparedPostures.from_joints(arm, observations.joints_rad)
    return (
        (first, PreparedPostures.from_joints(arm, observations.other_joints_rad))
        if isinstance(observations, BarLengths)
        else (first,)
    )


def _whitening_matrices(observations: CellObservations, covariance: Array) -> Array:
    scales = [observations.sigma_m] * min(observations.channels, 3)
    if isinstance(observations, PoseObservations):
        scales += [observations.sigma_rad] * 3
    size = np.stack(scales, axis=1)
    return np.linalg.inv(np.linalg.cholesky(covariance / (size[:, :, None] * size[:, None, :])))


@dataclass(frozen=True, eq=False)
class RouteChain:
    """A route at one state, and what each unknown does along it."""

    along: ArmAlongRoute
    tangent: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (p, P + K + D), by independent columns

    @classmethod
    def along_route(
        cls, layout: CellLayout, state: CellState, route: FrameRoute, device: int, own: tuple[str, ...]
    ) -> "RouteChain":
        """Return the chain of a route with the derivatives by all free unknowns."""
        along = state.along_route(route, device)
        tangent = layout.tangent_rows(state, route, device, own)
        twists = 6 * len(along.placements)
        arm = tangent[:, :twists] @ twists_by_independent_columns(along.placements)
        return cls(along, np.concatenate([arm, tangent[:, twists:]], axis=1))

    def compute_frames(self, postures: PreparedPostures, rows: Rows) -> tuple[Array, Array]:
        """Return rotations and origins of every frame, components first."""
        arm = self.along.arm
        angles = postures.angles_rad[:, rows] + arm.arm_model.theta0_rad[:, None]
        for term, coefficient, values in zip(arm.terms, arm.coefficients, postures.values, strict=True):
            angles[term.joint] += coefficient * values[rows]
        return frames_of_placements(self.along.placements, angles, sliding=arm.arm_model.sliding)

    def motion_columns(
        self, postures: PreparedPostures, rows: Rows, *, turning: bool
    ) -> tuple[TipFrames, Array, Array | None]:
        """Return the tip, and how it moves and turns (P + K, 3, N) with independent columns and terms."""
        rotations, origins = self.compute_frames(postures, rows)
        n, count, terms = len(rotations) - 1, len(rows), self.along.arm.terms
        size = 4 * n + 6
        linear = np.empty((size + len(terms), 3, count))
        independent_columns(rotations, origins, out=linear[:size])
        parts = [linear]
        if turning:
            angular = np.zeros_like(linear)
            angular[: 4 * n].reshape(n, 4, 3, count)[:, 2:] = rotations[:-1].swapaxes(1, 2)[:, :2]
            angular[size - 3 : size] = rotations[-1].swapaxes(0, 1)
            parts.append(angular)
        if terms:
            twists = self.along.arm.arm_model.joint_twists
            turns = twists_by_independent_columns(self.along.placements)[
                [6 * term.joint + twists[term.joint] for term in terms]
            ]
            for part in parts:
                part[size:] = np.tensordot(turns, part[:size], axes=1) * postures.values[:, rows][:, None]
        return (origins[-1], rotations[-1]), linear, parts[1] if turning else None


def series_residuals(series: SeriesRows, state: CellState) -> Array:
    """Return measured minus predicted of every row (channels, N), in sigmas, with covariances taken out."""
    white_residuals = np.empty((series.observations.channels, len(series)))
    for mounting, rows in series.iterate_blocks():
        chain = RouteChain(state.along_route(series.routes[mounting], series.device))
        frames = [chain.compute_frames(end, rows) for end in series.ends]
        place = frames[0][1][-1] if len(frames) == 1 else frames[0][1][-1] - frames[1][1][-1]
        tip = place, frames[0][0][-1]
        raw = series.observations.compute_residuals(tip, chain.along.device, rows)
        white_residuals[:, rows] = series.whiten_values(raw, rows)
    return white_residuals


def errors_m(series: SeriesRows, state: CellState) -> Array:
    """Return the size of the position or length error of every row (N,) [m]."""
    plain = replace(series, whitener=None)
    sizes: Array = series.observations.errors_m(series_residuals(plain, state))
    return sizes


def series_chains(layout: CellLayout, state: CellState, series: SeriesRows) -> list[RouteChain]:
    """Return the chains of a series' mountings with their derivatives."""
    own = series.observations.scalars
    return [RouteChain.along_route(layout, state, route, series.device, own) for route in series.routes]


def white_system(series: SeriesRows, chain: RouteChain, rows: Rows) -> Array:
    """Return the white columns of a block and, in the last row, its residuals (P + K + D + 1, channels, N)."""
    observations, device = series.observations, chain.along.device
    tip, linear, angular = chain.motion_columns(series.ends[0], rows, turning=observations.needs_rotation)
    if len(series.ends) > 1:
        second = chain.motion_columns(series.ends[1], rows, turning=False)
        tip, linear = (tip[0] - second[0][0], tip[1]), linear - second[1]
    own = (
        observations.own_columns(tip, device)[-len(observations.scalars) :]
        if observations.scalars
        else observations.own_columns(tip, device)
    )
    columns = np.concatenate(
        [observations.project_motions(linear, angular, tip, device), own]
    ) * observations.inverse_sigmas(rows)
    return series.whiten_values(
        np.concatenate([columns, observations.compute_residuals(tip, device, rows)[None]]), rows
    )


def whole_columns(layout: CellLayout, state: CellState, series: SeriesRows) -> tuple[Array, Array]:
    """Return the white columns of all unknowns (p, channels, N) and the residuals (channels, N)."""
    every = np.zeros((len(layout), series.observations.channels, len(series)))
    white_residuals = np.empty((series.observations.channels, len(series)))
    by_mounting = series_chains(layout, state, series)
    for mounting, rows in series.iterate_blocks():
        block = white_system(series, by_mounting[mounting], rows)
        every[:, :, rows] = np.tensordot(by_mounting[mounting].tangent, block[:-1], axes=1)
        white_residuals[:, rows] = block[-1]
    return every, white_residuals
