"""Fits of places, and of geometry, to one series with different breaks: each is made once, from a near one."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import (
    ArmFit,
    FitProblem,
    approach_minimum,
    estimate_arm,
    place_columns,
)
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.misfit_fit import motion_of
from cellcal.calibration.identification.observations import Observations, Rows, with_mounting
from cellcal.calibration.identification.parameters import FRAMES, GEOMETRY, ArmState

SHORTEST_MOUNTING = 12  # rows
_FAR_WORSE = 4.0
_FITS = 0.01  # of the motion: no mirror image of the places leaves as little
_READINGS_PER_UNKNOWN = 2


def mounting_of(count: int, breaks: Sequence[int]) -> Rows:
    """Return the mounting of every row of a series with these breaks."""
    return np.searchsorted(np.sort(np.asarray(breaks, dtype=np.intp)), np.arange(count), side="right")


def mount_at_breaks(observations: Observations, breaks: Sequence[int]) -> Observations:
    """Return the rows with the mountings that these breaks divide them into."""
    return with_mounting(observations, mounting_of(len(observations), breaks))


def fit_frames(model: RobotModel, observations: Observations, breaks: Sequence[int]) -> ArmFit:
    """Fit places of devices and tool to the nominal arm, from the best of all starts.

    A start that leads some of the rows to a far worse place is not followed with all of them.
    """
    mounted = mount_at_breaks(observations, breaks)
    starts = first_guess(model, mounted)
    layout = make_layout(model, mounted.kind, len(starts[0].devices), level=FRAMES)
    problem = FitProblem.from_observations(starts[0], mounted)
    near = [approach_minimum(layout, start, problem) for start in starts]
    least = min(fit.cost for fit in near)
    fits = [estimate_arm(layout, fit.state, problem) for fit in near if fit.cost <= _FAR_WORSE * least]
    return min(fits, key=lambda fit: fit.cost)


class FrameFits:
    """Fits of places to the nominal arm for different breaks of one series, each made once."""

    def __init__(self, model: RobotModel, observations: Observations) -> None:
        self.model, self.observations = model, observations
        self._fits: dict[tuple[int, ...], ArmFit] = {}
        self._linear: dict[tuple[int, ...], tuple[ArmFit, Array, Array]] = {}
        self._with_geometry: dict[tuple[int, ...], tuple[ArmFit, Array, Array]] = {}

    def fit_breaks(self, breaks: Sequence[int]) -> ArmFit:
        """Return `fit_frames` with these breaks, in any order."""
        key = tuple(sorted(breaks))
        if key not in self._fits:
            near = next(filter(None, (self._places_from(known, key) for known in reversed(self._fits))), None)
            self._fits[key] = (
                fit_frames(self.model, self.observations, key)
                if near is None
                else self._fit_places(near, key)
            )
        return self._fits[key]

    def linearise_breaks(self, breaks: Sequence[int]) -> tuple[ArmFit, Array, Array]:
        """Return the fit with these breaks, its columns (p, m, N) and its residuals (m, N)."""
        key = tuple(sorted(breaks))
        if key not in self._linear:
            fit = self.fit_breaks(key)
            self._linear[key] = (fit, *_linearise_fit(fit, self.observations, key))
        return self._linear[key]

    def _places_from(self, known: tuple[int, ...], breaks: tuple[int, ...]) -> ArmState | None:
        """Return the places of a fit whose breaks differ by one, with each mounting where its middle row was.

        None where the breaks differ by more, or where the rows did not fit: that may be the wrong of two mirror
        images.
        """
        if len({*known} - {*breaks}) > 1 or len({*breaks} - {*known}) > 1:
            return None
        fit, count = self._fits[known], len(self.observations)
        sigma_m = float(np.median(self.observations.sigma_m))
        if sigma_m * np.sqrt(fit.cost / (count * self.observations.channels)) > _FITS * self._motion_m:
            return None
        edges = np.array([0, *breaks, count])
        mountings = mounting_of(count, known)[(edges[:-1] + edges[1:]) // 2]
        return replace(fit.state, devices=tuple(fit.state.devices[mounting] for mounting in mountings))

    def _fit_places(self, start: ArmState, breaks: tuple[int, ...]) -> ArmFit:
        mounted = mount_at_breaks(self.observations, breaks)
        layout = make_layout(self.model, mounted.kind, len(start.devices), level=FRAMES)
        return estimate_arm(layout, start, FitProblem.from_observations(start, mounted), from_afar=True)

    @cached_property
    def _motion_m(self) -> float:
        return motion_of(self.model, self.observations)

    def carry_geometry(self, breaks: Sequence[int]) -> bool:
        """Return whether there are rows enough to fit the geometry with these breaks."""
        count, kind = len(self.observations), self.observations.kind
        unknowns = len(make_layout(self.model, kind, len(breaks) + 1, level=GEOMETRY))
        readings = count * self.observations.channels
        return count >= 4 * SHORTEST_MOUNTING and readings >= _READINGS_PER_UNKNOWN * unknowns

    def fit_geometry(self, breaks: Sequence[int]) -> tuple[ArmFit, Array, Array]:
        """Return a plain fit of the geometry with these breaks, its columns (p, m, N) and its residuals (m, N)."""
        key = tuple(sorted(breaks))
        if key not in self._with_geometry:
            frames = self.fit_breaks(key).state
            mounted = mount_at_breaks(self.observations, key)
            layout = make_layout(self.model, mounted.kind, len(key) + 1, level=GEOMETRY)
            fit = estimate_arm(layout, frames, FitProblem.from_observations(frames, mounted))
            self._with_geometry[key] = (fit, *_linearise_fit(fit, self.observations, key))
        return self._with_geometry[key]


def _linearise_fit(fit: ArmFit, observations: Observations, breaks: Sequence[int]) -> tuple[Array, Array]:
    """Return the columns (p, m, N) and residuals (m, N) of a fit with these breaks."""
    mounted = mount_at_breaks(observations, breaks)
    return place_columns(fit.layout, fit.state, FitProblem.from_observations(fit.state, mounted))
