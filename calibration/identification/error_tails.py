"""Whether rows that a fit rejected are mistakes, or the long tail of what the arm itself does.

A fit leaves both out, since neither tells anything about parameters. A further reading, however, meets the tail as
often as the rows did. Mistakes (a hidden target, a number that was typed wrong) may have any size; the tail of an
arm becomes rarer steadily, from the bulk of its errors on.
"""

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.geometry import Array

_FREEDOMS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 15.0, 30.0)
_ROUNDS = 60
MANY_REJECTED = 0.07  # of the rows: in good series up to 6 % are targets that were hidden or typing errors
_DECISIVE = (
    6.0  # of log likelihood: mistakes from ten deviations on never came as far, in 3000 simulated series
)
_LIKELY = 2.0  # where more rows are rejected than mistakes make
_MISTAKE_DECADES = 3.0  # over which a mistake's size is anywhere
_FALSE_ALARMS = 0.05  # rows of the tail called mistakes, per series
_SMALLEST = 1e-6


def tail_reach(deviations: Array, channels: int, rejected: int) -> float:
    """Return up to how many deviations a row belongs to a long tail; zero if there is none.

    Parameters
    ----------
    deviations : (N,)
        Sizes of all rows' residuals over their channels, in deviations of the good ones.
    rejected : int
        How many of them the fit left out.

    Notes
    -----
    Student's t in space is compared with normal errors among which are mistakes, whose logarithm of size is uniform.
    Of lengths (one channel) both look alike: mostly no tail is told there.
    """
    sizes = np.maximum(deviations, _SMALLEST)
    tails = [_fit_tail(sizes, channels, freedom) for freedom in _FREEDOMS]
    best = int(np.argmax([likelihood for likelihood, _ in tails]))
    needed = _LIKELY if rejected > MANY_REJECTED * len(sizes) else _DECISIVE
    if tails[best][0] - _mistaken_likelihood(sizes, channels) < needed:
        return 0.0
    ratio = scipy.special.fdtri(channels, _FREEDOMS[best], 1.0 - _FALSE_ALARMS / len(sizes))
    return float(tails[best][1] * np.sqrt(channels * ratio))


def _fit_tail(sizes: Array, channels: int, freedom: float) -> tuple[float, float]:
    """Return the log likelihood of Student's t, and its scale."""
    scale = float(np.median(sizes)) / np.sqrt(channels)
    for _ in range(_ROUNDS):
        weights = (freedom + channels) / (freedom + (sizes / scale) ** 2)
        scale = float(np.sqrt((weights * sizes**2).mean() / channels))
    gamma = scipy.special.gammaln
    constant = gamma((freedom + channels) / 2) - gamma(freedom / 2) - channels / 2 * np.log(freedom * np.pi)
    log_density = constant - (freedom + channels) / 2 * np.log1p((sizes / scale) ** 2 / freedom)
    return float((log_density + _log_shell(sizes, channels, scale)).sum()), scale


def _mistaken_likelihood(sizes: Array, channels: int) -> float:
    """Return the log likelihood of normal errors with mistakes among them, at their best scale and share."""
    scale, share = float(np.median(sizes)) / np.sqrt(channels), 0.05
    mistaken = -np.log(sizes) - np.log(_MISTAKE_DECADES * np.log(10.0))
    for _ in range(_ROUNDS):
        good = _log_normal(sizes, channels, scale)
        is_mistake = scipy.special.expit(np.log(share / (1.0 - share)) + mistaken - good)
        share = float(np.clip(is_mistake.mean(), 1e-4, 0.5))
        weight = 1.0 - is_mistake
        scale = float(np.sqrt((weight * sizes**2).sum() / (channels * weight.sum())))
    good = np.log1p(-share) + _log_normal(sizes, channels, scale)
    return float(np.logaddexp(good, np.log(share) + mistaken).sum())


def _log_normal(sizes: Array, channels: int, scale: float) -> Array:
    normal_density: Array = -channels / 2 * np.log(2.0 * np.pi) - (sizes / scale) ** 2 / 2
    return normal_density + _log_shell(sizes, channels, scale)


def _log_shell(sizes: Array, channels: int, scale: float) -> Array:
    """Return the logarithm of a sphere's surface: from a density in space to that of its size."""
    surface = np.log(2.0) + channels / 2 * np.log(np.pi) - scipy.special.gammaln(channels / 2)
    shell: Array = surface + (channels - 1) * np.log(sizes) - channels * np.log(scale)
    return shell
