"""What residuals that are alike within a group do to stated uncertainties: fewer rows count than were measured.

Rows of one run share what drifts and what the model lacks. Least squares takes them for independent, and states
deviations that are too small by the square root of the design effect ``1 + (m - 1) rho``, with m rows a group
and the correlation rho of two rows of the same group.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import (
    ArmFit,
    estimate_arm,
    place_columns,
    whitened_residuals,
)
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.identification.robust import RobustFit
from cellcal.calibration.message import make_message

_BY_CHANCE = 0.01
_WORTH_SAYING = 1.05  # of a standard deviation
_AT_ONCE = 2000  # rows whose columns are held
_SHOWING = 500  # rows of a group that tell what its mean does


@dataclass(frozen=True, slots=True)
class GroupEffect:
    """The correlation of residuals within groups, and its effect on standard deviations."""

    correlation: float  # of two rows of one group
    rows_per_group: float
    widening: float  # of standard deviations, >= 1
    effective_rows: float
    degrees_of_freedom: float | None = None  # with which widened deviations are known
    said: str = ""  # for people; empty if there is nothing to say


@dataclass(frozen=True, slots=True)
class ExpectedSquares:
    """Sums of squares of residuals if rows share nothing (variance 1), and what a shared variance 1 adds to them."""

    between: float
    between_squared: float  # trace of the square of the covariance of the groups' means, each times root m
    within: float
    shared_within: float  # by the fit alone: it carries what one group shares into other rows

    @classmethod
    def without_fit(cls, channels: int, rows: int, groups: int) -> "ExpectedSquares":
        """Return them for deviations from a mean."""
        between = float(channels * (groups - 1))
        return cls(between, between, float(channels * (rows - groups)), 0.0)


def group_effect(residuals: Array, groups: Rows, expected: ExpectedSquares | None = None) -> GroupEffect:
    r"""Measure how alike whitened residuals (channels, N) are within groups (N,).

    Parameters
    ----------
    residuals : (channels, N)
        In sigmas that the fit's reduced chi square has made true; without a fit any unit will do.
    groups : (N,)
        Labels.
    expected : Expected or None
        Of residuals of a fit: `expected_of`. None: they are taken off their mean here.

    Notes
    -----
    Analysis of variance. A fit takes away from what groups differ by, and how much depends on how its columns lie:
    with columns X, covariance C and the projector P on the groups' means the sum between groups is a quadratic form
    in ``A = P (1 - X C X') P``, and has ``tr(A)^2 / tr(A^2)`` degrees of freedom. The ratio of mean squares says
    whether it could be chance. Groups of different size count with ``m = (N - sum m_i^2 / N) / (G - 1)``.

    References
    ----------
    L. Kish, Survey Sampling, 1965, 5.4 (design effect).
    F. E. Satterthwaite, An approximate distribution of estimates of variance components, 1946.
    """
    labels = np.unique(groups, return_inverse=True)[1].reshape(-1)
    sizes = np.bincount(labels).astype(float)
    count, number = float(len(labels)), len(sizes)
    alone = GroupEffect(0.0, count / max(number, 1), 1.0, count)
    if number < 3 or count - number < 3:
        return alone
    if expected is None:
        residuals = residuals - residuals.mean(axis=1, keepdims=True)
        residuals = residuals / max(float(np.sqrt((residuals**2).mean() * count / (count - 1.0))), 1e-300)
        expected = ExpectedSquares.without_fit(len(residuals), len(labels), number)
    sums = np.array([np.bincount(labels, channel) for channel in residuals])
    between = float((sums**2 / sizes).sum())
    within = max(float((residuals**2).sum()) - between, 1e-300)
    if min(expected.between, expected.within) < 1.0:
        return alone
    freedom = expected.between**2 / expected.between_squared, expected.within
    squares = between / expected.between, within / expected.within
    if scipy.special.fdtrc(*freedom, squares[0] / squares[1]) > _BY_CHANCE:
        return alone
    size = (count - float((sizes**2).sum()) / count) / (number - 1)
    expected_shared = size * expected.between_squared, expected.shared_within
    shared = (squares[0] - squares[1]) / (
        expected_shared[0] / expected.between - expected_shared[1] / expected.within
    )
    own = squares[1] - shared * expected_shared[1] / expected.within
    return _effect_of_variances((own, shared), sizes, size, (squares, freedom))


def _effect_of_variances(
    variances: tuple[float, float],
    sizes: Array,
    size: float,
    expected_shared: tuple[tuple[float, float], ...],
) -> GroupEffect:
    own, shared = variances
    count, together = float(sizes.sum()), float((sizes**2).sum() / sizes.sum())
    effect = max(own + together * shared, 1.0)
    (between, within), (few, many) = expected_shared
    share = together * shared / max(between - within, 1e-300)
    relative_variance = (share * between) ** 2 / few + ((1.0 - share) * within) ** 2 / many
    rho, widening = shared / (own + shared), float(np.sqrt(effect))
    remark = ""
    if widening > _WORTH_SAYING:
        remark = make_message(
            "residuals go together within groups (correlation {rho:.2f}): the {count:.0f} rows tell as much as "
            "{fewer:.0f} independent ones. Stated deviations are widened {widening:.2f} times.",
            rho=rho,
            count=count,
            fewer=count / effect,
            widening=widening,
        )
    freedom = (share * between + (1.0 - share) * within) ** 2 / relative_variance
    return GroupEffect(rho, size, widening, count / effect, max(freedom, 1.0), remark)


def expected_of(
    covariance: Array, columns: Callable[[Rows], Array], groups: Rows, channels: int
) -> ExpectedSquares:
    """Return the sums of squares that residuals of a fit have if rows share nothing.

    Parameters
    ----------
    covariance : (p, p)
        Of the fit.
    columns : function
        Whitened columns (p, channels, n) of some rows.
    groups : (N,)
        Labels from 0 on.
    channels : int
        Of a row.

    Notes
    -----
    Residuals of a fit with priors have the covariance ``1 - X C X'``, priors true. All traces are of p x p matrices.
    """
    sizes = np.bincount(groups)
    means, every = np.zeros_like(covariance), np.zeros_like(covariance)
    for rows, starts, stand_for in _whole_groups(groups, sizes):
        some = columns(rows) * np.sqrt(stand_for)
        sums = np.add.reduceat(some * np.sqrt(stand_for), starts, axis=2) / np.sqrt(
            sizes[groups[rows[starts]]]
        )
        flat, whole = sums.reshape(len(sums), -1), some.reshape(len(some), -1)
        means += flat @ flat.T
        every += whole @ whole.T
    absorbed, learnt = covariance @ means, covariance @ every
    taken, twice = float(np.trace(absorbed)), float(np.sum(absorbed * absorbed.T))
    between = channels * len(sizes) - taken
    size = len(groups) / len(sizes)
    return ExpectedSquares(
        between,
        max(between - taken + twice, 1e-3 * max(between, 1.0)),
        channels * len(groups) - float(np.trace(learnt)) - between,
        size * max(float(np.sum(absorbed * learnt.T)) - twice, 0.0),
    )


def _whole_groups(groups: Rows, sizes: Rows) -> Iterator[tuple[Rows, Rows, Array]]:
    """Yield rows of some groups at a time, where each group starts, and for how many each row stands.

    Of large groups some rows show what the others do.
    """
    order = np.argsort(groups, kind="stable")
    rank = np.arange(len(groups)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    shown = order[rank % -(-sizes // _SHOWING)[groups[order]] == 0]
    labels = groups[shown]
    counts = np.bincount(labels)
    ends = np.cumsum(counts)
    first = 0
    while first < len(sizes):
        begin = int(ends[first - 1]) if first else 0
        last = max(int(np.searchsorted(ends, begin + _AT_ONCE, side="right")), first + 1)
        starts = ends[first:last] - counts[first:last] - begin
        rows = shown[begin : ends[last - 1]]
        yield rows, starts, (sizes / counts)[groups[rows]]
        first = last


def widen_fit(robust: RobustFit, groups: Rows) -> tuple[RobustFit, GroupEffect]:
    """Return a fit with the covariance and the degrees of freedom that its groups allow; its estimate stays."""
    is_kept = np.ones(len(robust.problem.observations), dtype=bool)
    is_kept[robust.rejected] = False
    rows, fit = np.flatnonzero(is_kept), robust.fit
    labels = np.unique(groups[rows], return_inverse=True)[1].reshape(-1)
    residuals = whitened_residuals(fit.state, robust.problem)[:, rows]

    def columns_of(some: Rows) -> Array:
        return place_columns(fit.layout, fit.state, robust.problem.select_rows(rows[some]))[0]

    expected = expected_of(fit.covariance, columns_of, labels, len(residuals))
    effect = group_effect(residuals, labels, expected)
    if effect.widening == 1.0 or not len(fit.layout):
        return robust, effect
    factor = effect.widening
    problem = replace(robust.problem, observations=robust.problem.observations.scale_sigma(factor, factor))
    wide = estimate_arm(fit.layout, fit.state, problem, is_kept.astype(float))
    widened_fit: ArmFit = replace(fit, covariance=wide.covariance)
    freedom = min(robust.degrees_of_freedom, effect.degrees_of_freedom or np.inf)
    return replace(robust, fit=widened_fit, degrees_of_freedom=freedom), effect
