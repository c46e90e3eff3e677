"""Temperature as a regressor: what a series shifts by a degree is taken out, if rows that were held out gain by it.

Arm, stand and floor grow together, and one series cannot tell whose growth it sees. What it can tell is by how much
readings shift with the temperature beside them: three numbers for places, one for lengths. Readings are brought to
the mean temperature of the series; all that is stated is at that temperature.
"""

from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.cross_validation import Grouping, assign_folds, compare_models
from cellcal.calibration.identification.drift_lint import fit_drift
from cellcal.calibration.identification.estimator import FitProblem, estimate_arm, whitened_residuals
from cellcal.calibration.identification.frame_fits import fit_frames
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.observations import LengthObservations, Observations, Rows
from cellcal.calibration.identification.parameters import GEOMETRY, ArmState, ParameterLayout
from cellcal.calibration.message import make_message

_BY_CHANCE = 0.01
_SMALLEST_M = 2e-5  # over the whole range
_FOLDS = 5
_ROUNDS = 3  # of slopes and arm in turn: what one took from the other comes back


@dataclass(frozen=True, eq=False)
class TemperatureEffect:
    """The shift of readings by a degree, in the device's frame, and the temperature to which they were brought."""

    slopes: Array  # (channels,) [m/K]
    at: float  # [deg C]
    total_m: float  # over the range of the series
    reason: str

    def remove_effect(self, observations: Observations, temperature: Array) -> Observations:
        """Return rows as they would have been read at ``at``; where no temperature is known (NaN) they stay."""
        warmer = np.where(np.isfinite(temperature), temperature - self.at, 0.0)
        if isinstance(observations, LengthObservations):
            return replace(observations, lengths_m=observations.lengths_m - self.slopes[0] * warmer)
        return replace(observations, positions_m=observations.positions_m - warmer[:, None] * self.slopes)


def temperature_effect(
    model: RobotModel, observations: Observations, temperature: Array | None, grouping: Grouping
) -> TemperatureEffect | None:
    """Return what a temperature beside every row explains, or None where held-out rows gain nothing by it.

    Parameters
    ----------
    model : RobotModel
        Nominal; its geometry is fitted, so that the temperature is not blamed for the arm.
    observations : Observations
        Of one mounting of the device.
    temperature : (N,) or None
        [deg C]; every row's, or nothing is done.
    grouping : Grouping
        Rows that share what drifts: they are held out together.
    """
    if temperature is None or not len(observations) or not np.isfinite(temperature).all():
        return None
    warmer = temperature - temperature.mean()
    start = fit_frames(model, observations, ()).state
    layout = make_layout(model, observations.kind, 1, level=GEOMETRY)
    drift = fit_drift(warmer, _left_m(layout, start, observations), grouping.groups)
    if drift is None or drift.by_chance > _BY_CHANCE or drift.total_m < _SMALLEST_M:
        return None
    folds = assign_folds(grouping, _FOLDS, 0)
    plain, regressed = np.zeros(len(observations)), np.zeros(len(observations))
    for fold in range(int(folds.max()) + 1):
        training, held_rows = np.flatnonzero(folds != fold), np.flatnonzero(folds == fold)
        for errors, rounds in ((plain, 0), (regressed, _ROUNDS)):
            errors[held_rows] = _held_out(layout, start, observations, (warmer, training, held_rows), rounds)
    gain = compare_models(
        ("without temperature", plain), ("with temperature", regressed), grouping.groups, least_gain=0.005
    )
    if not gain.better:
        return None
    slopes = _fit_slopes(layout, start, observations, warmer, _ROUNDS)
    return TemperatureEffect(
        slopes,
        float(temperature.mean()),
        float(np.linalg.norm(slopes) * np.ptp(temperature)),
        gain.reason,
    )


def temperature_note(effect: TemperatureEffect | None) -> list[Lint]:
    """Say what was taken out."""
    if effect is None:
        return []
    return [
        Lint(
            "temperature",
            make_message(
                "readings shift by {slope:.3f} mm per degree, {total:.2f} mm in all: taken out, all results are at "
                "{at:.1f} °C ({reason}). At another temperature they are off by as much.",
                slope=np.linalg.norm(effect.slopes) * 1e3,
                total=effect.total_m * 1e3,
                at=effect.at,
                reason=effect.reason,
            ),
        )
    ]


def _left_m(layout: ParameterLayout, start: ArmState, observations: Observations) -> Array:
    """Return what a fit leaves over (channels of places or lengths, N) [m]."""
    problem = FitProblem.from_observations(start, observations)
    state = estimate_arm(layout, start, problem, from_afar=True).state
    residuals_m: Array = whitened_residuals(state, problem)[:3] * observations.sigma_m
    return residuals_m


def _fit_slopes(
    layout: ParameterLayout, start: ArmState, observations: Observations, warmer: Array, rounds: int
) -> Array:
    channels = 1 if observations.kind == "length" else 3
    slopes = np.zeros(channels)
    centred = warmer - warmer.mean()
    for _ in range(rounds):
        there = TemperatureEffect(slopes, 0.0, 0.0, "").remove_effect(observations, warmer)
        slopes = slopes + _left_m(layout, start, there) @ centred / float(centred @ centred)
    return slopes


def _held_out(
    layout: ParameterLayout,
    start: ArmState,
    observations: Observations,
    parts: tuple[Array, Rows, Rows],
    rounds: int,
) -> Array:
    """Return the errors (n,) [m] of rows by arm and slopes of the others."""
    warmer, training, held_rows = parts
    slopes = _fit_slopes(layout, start, observations.select_rows(training), warmer[training], rounds)
    effect = TemperatureEffect(slopes, 0.0, 0.0, "")
    fitted = effect.remove_effect(observations.select_rows(training), warmer[training])
    state = estimate_arm(layout, start, FitProblem.from_observations(start, fitted), from_afar=True).state
    rows = effect.remove_effect(observations.select_rows(held_rows), warmer[held_rows])
    problem = FitProblem.from_observations(state, rows)
    errors: Array = problem.observations.errors_m(whitened_residuals(state, problem))
    return errors
