"""What few rows say about what a model lacks: deviations averaged over what may be behind the residuals.

With 8 to 120 rows a fit bends its parameters until sag, ripple, play of the gears or a target that was put on again
hardly show in the residuals; scaled by those, deviations promise too much. So the rows are looked at as drawn from
many models: noise of any size, and beside it each kind of effect, absent, small or large, and fitted ripple of the
usual size or larger. The probability of the rows under each model weighs what it says about
the parameters.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.arm.joint_terms import JointTerm, gravity_terms, harmonic_terms
from cellcal.calibration.arm.kinematics import chain_frames, cross_product
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import FitProblem, place_columns
from cellcal.calibration.identification.layouts import make_layout, with_further
from cellcal.calibration.identification.observations import Observations, Rows
from cellcal.calibration.identification.parameters import GEOMETRY, ArmState, Parameter, Priors
from cellcal.calibration.identification.robust import RobustFit

AVERAGED_ROWS = 120  # up to here a fit bends its parameters more than its residuals show
_NOISES = np.geomspace(0.125, 8.0, 13)  # of the deviation that the residuals show
_LEAST_NOISE = 0.2  # of the stated deviation: fewer rows than unknowns leave no residuals that show one
KINDS = ("joints", "play", "order")
# Of each kind of effect, of what is usual; a device that was moved may have been moved by decimetres.
_SIZES = ((0.0, 0.5, 2.0), (0.0, 0.5, 2.0), (0.0, 0.5, 2.0, 20.0, 200.0))
# Times the prior of ripple: a tight one predicts other rows of real arms best, and promises too much.
_RIPPLE_SIZES = (1.0, 5.0)
_ABSENT = 0.5  # probability beforehand that a kind of effect is not there
_RIPPLE_RAD = float(np.deg2rad(0.02))
_SAG_RAD_PER_M = float(np.deg2rad(0.1))
_BENDING_RAD_PER_M = float(np.deg2rad(0.05))
_PLAY_RAD = float(np.deg2rad(0.02))
_MOST_SPREAD_M = 3e-4  # of device and target, over the whole series
_ORDERS = (1, 2, 3, 4)
_ABOUT_X = ("alpha", "rx")
_PLACES = ("base", "anchor", "tool")


@dataclass(frozen=True, eq=False)
class UnmodelledEffects:
    """Effects in the rows that the parameters do not describe."""

    covariance: Array  # (p, p) of the parameters about their estimate
    probability: tuple[float, ...]  # that an effect of each of `KINDS` is there
    noise_m: float  # deviation of the noise alone, in places or lengths


def average_over_misfits(robust: RobustFit, stated: Observations) -> UnmodelledEffects:
    r"""Return what the kept rows of a fit say, averaged over what may be behind their residuals.

    Parameters
    ----------
    robust : RobustFit
        Not widened for groups.
    stated : Observations
        The same rows with their sigmas as they are stated.

    Notes
    -----
    With whitened columns X of the parameters (in prior deviations), residuals r and covariance V of a model, the rows
    have the density of ``N(r + X x, V + X X')`` linearised at the estimate. Moments of the parameters are taken about
    the estimate: where models with an effect would move it, that is in its deviation.

    References
    ----------
    J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, Bayesian Model Averaging, Statist. Sci. 14 (1999) 382.
    """
    is_kept = np.ones(len(robust.problem.observations), dtype=bool)
    is_kept[robust.rejected] = False
    rows = np.flatnonzero(is_kept)
    fit, problem = robust.fit, robust.problem.select_rows(rows)
    usual_m = float(np.median(problem.observations.sigma_m))
    raised = max(1.0, _LEAST_NOISE * float(np.median(stated.sigma_m)) / usual_m)
    columns, whitened = place_columns(fit.layout, fit.state, problem)
    priors = fit.layout.prior_sigmas
    scaled = (columns.reshape(len(columns), -1) * priors[:, None]).T
    away = fit.deviations / priors
    effects = _effect_covariances(fit.state, problem, rows, frozenset(p.name for p in fit.layout.parameters))
    posteriors = []
    for sizes in product(*_SIZES):
        turned = _PrincipalAxes.along_effect(scaled, whitened.reshape(-1), _mix_effects(effects, sizes))
        posteriors += [
            (sizes, n, *_mixture_posterior(turned, away, (raised * n) ** 2, widths))
            for n, widths in product(_NOISES, _prior_widths(fit.layout.parameters))
        ]
    chances = np.array([each[4] + _log_prior(each[0]) for each in posteriors])
    weights = np.exp(chances - chances.max())
    weights /= weights.sum()
    moment = sum(w * (e[2] + np.outer(e[3], e[3])) for w, e in zip(weights, posteriors, strict=True))
    there = [
        float(sum(w for w, e in zip(weights, posteriors, strict=True) if e[0][k] > 0))
        for k in range(len(KINDS))
    ]
    noise = raised * float(sum(w * e[1] for w, e in zip(weights, posteriors, strict=True)))
    covariance = np.asarray(moment) * np.outer(priors, priors)
    return UnmodelledEffects(covariance, tuple(there), noise * usual_m)


def _prior_widths(parameters: tuple[Parameter, ...]) -> list[Array]:
    """Return how wide priors may be, times those of the fit (p,)."""
    is_ripple = np.array([parameter.role == "harmonic" for parameter in parameters])
    return [
        np.where(is_ripple, size, 1.0) for size in (_RIPPLE_SIZES if is_ripple.any() else _RIPPLE_SIZES[:1])
    ]


def _log_prior(sizes: tuple[float, ...]) -> float:
    """Return the logarithm of the probability beforehand."""
    each = [
        _ABSENT if size == 0 else (1.0 - _ABSENT) / (len(possible) - 1)
        for size, possible in zip(sizes, _SIZES, strict=True)
    ]
    return float(np.log(each).sum())


def _mix_effects(effects: tuple[Array, ...], sizes: tuple[float, ...]) -> Array:
    mixed: Array = sum(
        (size**2 * effect for size, effect in zip(sizes, effects, strict=True)), np.zeros_like(effects[0])
    )
    return mixed


@dataclass(frozen=True, eq=False)
class _PrincipalAxes:
    """Columns and residuals along the principal axes of an effect, in which noise of any size changes nothing."""

    columns: Array  # (c N, p)
    residuals: Array  # (c N,)
    variances: Array  # (c N,) of the effect

    @classmethod
    def along_effect(cls, columns: Array, residuals: Array, effect: Array) -> "_PrincipalAxes":
        if not effect.any():
            return cls(columns, residuals, np.zeros(len(residuals)))
        variances, axes = np.linalg.eigh(effect)
        return cls(axes.T @ columns, axes.T @ residuals, np.maximum(variances, 0.0))


def _mixture_posterior(
    turned: _PrincipalAxes, away: Array, noise: float, widths: Array
) -> tuple[Array, Array, float]:
    """Return covariance and shift of the parameters, and the log density of the rows (but for a constant).

    By the determinant lemma of the information of the parameters and the variances of the rows. All in deviations of
    the fit's priors; these are as wide as ``widths`` (p,) says.
    """
    weights = 1.0 / (turned.variances + noise)
    white = turned.columns * weights[:, None]
    factor = _information_factor(turned.columns, weights, widths)
    expected = away / widths**2
    gradient = white.T @ turned.residuals - expected
    covariance = scipy.linalg.cho_solve(factor, np.eye(len(widths)))
    shift = covariance @ gradient
    square = float(turned.residuals @ (turned.residuals * weights) + away @ expected - gradient @ shift)
    volume = 2.0 * float(np.log(np.diag(factor[0])).sum() + np.log(widths).sum()) - float(
        np.log(weights).sum()
    )
    return covariance, shift, -0.5 * (square + volume)


def _information_factor(columns: Array, weights: Array, widths: Array) -> tuple[Array, bool]:
    """Return the triangle of the parameters' information, and whether it is the lower one.

    Rows that are far more precise than the priors leave squares that are not positive by rounding; then the triangle
    is found without squares.
    """
    information = np.diag(widths**-2.0) + columns.T @ (columns * weights[:, None])
    try:
        return scipy.linalg.cho_factor(information, lower=True)  # type: ignore[no-any-return]
    except np.linalg.LinAlgError:
        triangle = np.linalg.qr(
            np.vstack([np.diag(1.0 / widths), columns * np.sqrt(weights)[:, None]]), mode="r"
        )
        return triangle * np.sign(np.diag(triangle))[:, None], False


def _effect_covariances(
    state: ArmState, problem: FitProblem, order: Rows, fitted: frozenset[str]
) -> tuple[Array, ...]:
    """Return the covariance of the rows' channels (c N, c N) that each kind of effect of the usual size has."""
    nominal, observations = state.nominal, problem.observations
    terms = tuple(_further_terms(state))
    wide = replace(
        state, terms=(*state.terms, *terms), coefficients=np.append(state.coefficients, np.zeros(len(terms)))
    )
    layout = make_layout(nominal, observations.kind, len(state.devices), level=GEOMETRY, terms=wide.terms)
    layout = with_further(layout, len(state.further), Priors())
    columns, _ = place_columns(layout, wide, FitProblem.from_observations(wide, observations))
    parameters = layout.parameters
    sag = [_SAG_RAD_PER_M if t.kind == "gravity" else _RIPPLE_RAD for t in terms]
    shared = list(columns[len(parameters) - len(terms) :] * np.array(sag)[:, None, None]) if terms else []
    for i, parameter in enumerate(parameters):
        if parameter.role == "geometry" and parameter.unit == "rad":
            shared.append(
                columns[i] * (_BENDING_RAD_PER_M * _bending_levers(wide, observations.joints_rad, parameter))
            )
        if parameter.role == "geometry" and parameter.name not in fitted:
            shared.append(columns[i] * parameter.prior)
    play = [columns[i] * _PLAY_RAD for i, p in enumerate(parameters) if p.role == "offset"]
    moved = [
        columns[i] * _MOST_SPREAD_M for i, p in enumerate(parameters) if p.unit == "m" and p.role in _PLACES
    ]
    rank = np.argsort(np.argsort(order)) / max(len(order) - 1, 1)
    wander = np.minimum(rank[:, None], rank[None])
    return (
        _channel_covariance(shared, None),
        _channel_covariance(play, np.eye(len(observations))),
        _channel_covariance(moved, wander),
    )


def _further_terms(state: ArmState) -> Iterator[JointTerm]:
    term_names = {term.name for term in state.terms}
    for term in (*gravity_terms(state.nominal), *harmonic_terms(state.nominal, _ORDERS)):
        if term.name not in term_names:
            yield term


def _bending_levers(state: ArmState, joints_rad: Array, parameter: Parameter) -> Array:
    """Return the lever (N,) [m] of the tip's weight about the axis that a turning of a placement has."""
    rotations, origins = chain_frames(state.arm_model, joints_rad)
    frame = parameter.joint + (1 if state.nominal.dh is not None else 0)
    axis = rotations[frame, :, 0 if parameter.name.endswith(_ABOUT_X) else 1]
    lever = origins[-1] - origins[frame]
    down = np.array(state.nominal.gravity_in_base)[:, None] * np.ones_like(lever)
    moment: Array = (cross_product(lever, down) * axis).sum(axis=0)
    return moment


def _channel_covariance(columns: list[Array], by_rows: Array | None) -> Array:
    """Return the covariance of channels (c N, c N) from columns (c, N); rows go together as ``by_rows`` says."""
    some = np.array(columns)
    flat = some.reshape(len(some), -1)
    covariance: Array = flat.T @ flat
    if by_rows is None:
        return covariance
    channels = some.shape[1]
    return covariance * np.tile(by_rows, (channels, channels))
