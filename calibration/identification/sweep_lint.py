"""Residuals against each joint's angle: what follows a joint is no noise, and says where to look."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.group_effect import group_effect
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import make_message

_BINS = 12
_FEWEST_PER_BIN = 8
_FEWEST_ROWS = 48
_NARROWEST_RAD = float(np.deg2rad(5.0))
_DEGREES = float(np.degrees(1.0))
_BY_CHANCE = 1e-3  # in all joints and directions together
_EXPLAINED = 0.1  # of the residuals' square
_SMALLEST_M = 2e-5
_SHAPE = 0.75  # of what the bins explain


@dataclass(frozen=True, slots=True)
class _JointSweep:
    joint: int
    channel: int
    middles_rad: Array
    means_m: Array
    edges_rad: Array
    share: float  # of the residuals' square


def sweep_lint(
    joints_rad: Array,
    left_m: Array,
    groups: Rows,
    joint_names: Sequence[str],
    *,
    lengths: bool = False,
    slides: Sequence[bool] = (),
) -> list[Lint]:
    """Find joints whose angle tells the residual of a fit.

    Parameters
    ----------
    joints_rad : (N, n)
        Of the rows that were fitted.
    left_m : (channels, N)
        Measured minus predicted [m].
    slides : (n,)
        Which joints slide [m]; none means that all turn.
    groups : (N,)
        Rows that share drifts: they count as fewer.

    Notes
    -----
    Up to twelve bins of equal counts per joint; analysis of variance between them, corrected for what rows of a
    group share, Bonferroni for the number of looks. One note a joint, about the direction that shows it most.
    """
    count = joints_rad.shape[0]
    if count < _FEWEST_ROWS:
        return []
    sizes = np.maximum(np.sqrt(np.mean(left_m**2, axis=1, keepdims=True)), 1e-12)
    effect = group_effect(left_m / sizes, groups).widening ** 2
    looks = joints_rad.shape[1] * len(left_m)
    found = []
    for joint in range(joints_rad.shape[1]):
        bins = _bin_rows(joints_rad[:, joint], count / effect)
        if bins is None:
            continue
        sweeps = [
            _examine_sweep(joints_rad[:, joint], left_m[c], bins, effect, (joint, c))
            for c in range(len(left_m))
        ]
        significant = [
            sweep for sweep, chance in sweeps if chance * looks < _BY_CHANCE and sweep.share > _EXPLAINED
        ]
        if significant and np.ptp(max(significant, key=_sweep_range).means_m) > _SMALLEST_M:
            unit = ("mm", 1e3) if slides and slides[joint] else ("deg", _DEGREES)
            found.append(
                _sweep_finding(max(significant, key=_sweep_range), joint_names[joint], unit, lengths=lengths)
            )
    return found


def _sweep_range(sweep: _JointSweep) -> float:
    return float(np.ptp(sweep.means_m))


def _bin_rows(angle: Array, effective_rows: float) -> Rows | None:
    """Return the bin of every row, with equal angles together; None where the joint hardly moved."""
    number = min(_BINS, int(effective_rows) // _FEWEST_PER_BIN)
    if number < 3:
        return None
    edges = np.unique(np.quantile(angle, np.linspace(0, 1, number + 1)[1:-1]))
    bins = np.unique(np.searchsorted(edges, angle, side="right"), return_inverse=True)[1].reshape(-1)
    few = np.bincount(bins).min() < 3
    return None if np.ptp(angle) < _NARROWEST_RAD or bins.max() < 2 or few else bins


def _examine_sweep(
    angle: Array, residuals: Array, bins: Rows, effect: float, at: tuple[int, int]
) -> tuple[_JointSweep, float]:
    """Return what the bins show, and the probability that chance shows as much."""
    sizes = np.bincount(bins)
    means = np.bincount(bins, residuals) / sizes
    total = float(((residuals - residuals.mean()) ** 2).sum())
    between = float((sizes * (means - residuals.mean()) ** 2).sum())
    freedom = len(sizes) - 1, max((len(residuals) - len(sizes)) / effect, 3.0)
    ratio = between / freedom[0] / max((total - between) / (len(residuals) - len(sizes)), 1e-300) / effect
    order = np.array([[angle[bins == b].min(), angle[bins == b].max()] for b in range(len(sizes))])
    middles = np.bincount(bins, angle) / sizes
    share = between / max(float((residuals**2).sum()), 1e-300)
    return _JointSweep(*at, middles, means, order, share), float(scipy.special.fdtrc(*freedom, ratio))


def _sweep_finding(sweep: _JointSweep, name: str, shown: tuple[str, float], *, lengths: bool) -> Lint:
    unit, scale = shown
    means, middles, edges = sweep.means_m * 1e3, sweep.middles_rad * scale, sweep.edges_rad * scale
    spread = float(((means - means.mean()) ** 2).sum())
    line = np.polyval(np.polyfit(middles, means, 1), middles)
    steps = [
        sum(float(((part - part.mean()) ** 2).sum()) for part in (means[:i], means[i:]))
        for i in range(1, len(means))
    ]
    cut = int(np.argmin(steps)) + 1
    if float(((means - line) ** 2).sum()) < (1 - _SHAPE) * spread:
        shape = make_message(
            "a trend from {first:+.3f} mm at {low:.0f} {unit} to {last:+.3f} mm at {high:.0f} {unit}",
            first=means[0],
            low=middles[0],
            last=means[-1],
            high=middles[-1],
            unit=unit,
        )
    elif min(steps) < (1 - _SHAPE) * spread:
        shape = make_message(
            "a step near {place:.0f} {unit}, from {before:+.3f} to {after:+.3f} mm",
            place=(edges[cut - 1, 1] + edges[cut, 0]) / 2,
            unit=unit,
            before=means[:cut].mean(),
            after=means[cut:].mean(),
        )
    else:
        worst = int(np.argmax(np.abs(means)))
        shape = make_message(
            "a wave of {height:.3f} mm, furthest off ({worst:+.3f} mm) between {low:.0f} and {high:.0f} {unit}",
            height=np.ptp(means),
            worst=means[worst],
            low=edges[worst, 0],
            high=edges[worst, 1],
            unit=unit,
        )
    along = "the wire" if lengths else "xyz"[sweep.channel]
    message = make_message(
        "residuals along {along} follow {name}: {shape}. The model lacks something there, or {name} was not where "
        "the file says.",
        along=along,
        name=name,
        shape=shape,
    )
    return Lint("sweep", message)
