"""Residuals that go with temperature, or with the order of measuring: how much, and how surely."""

from dataclasses import dataclass

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import make_message

_BY_CHANCE = 0.01
_FEWEST_ROWS = 30
_FEWEST_GROUPS = 5
_SMALLEST_M = 2e-5  # over the whole range
_WARM_K = 2.0


@dataclass(frozen=True, eq=False)
class ResidualDrift:
    """The dependence of a residual on a quantity that should not matter."""

    slope: Array  # (channels,) m per unit
    sigma: Array  # (channels,), from groups
    by_chance: float  # probability of the largest slope over its deviation, all channels counted
    total_m: float  # over the range of the quantity, of channels that depend on it surely, if any do


def fit_drift(quantity: Array, left_m: Array, groups: Rows) -> ResidualDrift | None:
    """Regress residuals (channels, N) [m] on a quantity (N,); None if there is too little to tell.

    Notes
    -----
    Deviations of the slopes come from sums over groups, so that rows of one run do not count as independent.

    References
    ----------
    A. C. Cameron, D. L. Miller, A practitioner's guide to cluster-robust inference, 2015, II.
    """
    labels = np.unique(groups, return_inverse=True)[1].reshape(-1)
    number = int(labels.max(initial=-1)) + 1
    centred = quantity - quantity.mean() if len(quantity) else quantity
    square = float(centred @ centred)
    if len(quantity) < _FEWEST_ROWS or number < _FEWEST_GROUPS or square == 0.0:
        return None
    centred_m = left_m - left_m.mean(axis=1, keepdims=True)
    slope = centred_m @ centred / square
    scores = np.array(
        [np.bincount(labels, centred * (c - s * centred)) for c, s in zip(centred_m, slope, strict=True)]
    )
    sigma = np.sqrt((scores**2).sum(axis=1) * number / (number - 1)) / square
    ratio = np.abs(slope) / np.maximum(sigma, 1e-300)
    each = np.minimum(2.0 * (1.0 - scipy.special.stdtr(number - 1, ratio)) * len(slope), 1.0)
    # Sure and large in one channel: attitudes without noise follow anything surely, by nanometres.
    is_significant = each < _BY_CHANCE
    size = float(np.linalg.norm(slope[is_significant] if is_significant.any() else slope))
    return ResidualDrift(slope, sigma, float(each.min()), size * float(np.ptp(quantity)))


def temperature_drift(temperature: Array | None, left_m: Array, groups: Rows) -> list[Lint]:
    """Say how residuals go with the temperature column, if there is one and it moved.

    Parameters
    ----------
    temperature : (N,) or None
        Of the fitted rows [deg C]; cells that are empty take no part.
    left_m : (channels, N)
        Measured minus predicted [m].
    groups : (N,)
        Rows that share drifts.
    """
    if temperature is None or not np.isfinite(temperature).any():
        return []
    has_temperature = np.isfinite(temperature)
    low, high = float(temperature[has_temperature].min()), float(temperature[has_temperature].max())
    moved = make_message(
        "the temperature moved from {low:.1f} to {high:.1f} °C over the series", low=low, high=high
    )
    drift = fit_drift(temperature[has_temperature], left_m[:, has_temperature], groups[has_temperature])
    if drift is not None and drift.by_chance < _BY_CHANCE and drift.total_m > _SMALLEST_M:
        size, sigma = float(np.linalg.norm(drift.slope)) * 1e3, float(np.linalg.norm(drift.sigma)) * 1e3
        return [
            Lint(
                "temperature",
                make_message(
                    "{moved}, and residuals go with it: {size:.3f} mm per degree (sigma {sigma:.3f}), {total:.2f} mm "
                    "in all. Warm the arm up first, or measure at one temperature.",
                    moved=moved,
                    size=size,
                    sigma=sigma,
                    total=drift.total_m * 1e3,
                ),
            )
        ]
    if high - low < _WARM_K:
        return []
    steady = make_message(
        "{moved}; residuals do not follow it more than chance would make them.", moved=moved
    )
    return [Lint("temperature", steady)]


def order_drift(left_m: Array, groups: Rows) -> list[Lint]:
    """Say whether residuals (channels, N) [m] wander off from the first row to the last."""
    drift = fit_drift(np.arange(left_m.shape[1], dtype=float), left_m, groups)
    rms = float(np.sqrt(np.mean((left_m**2).sum(axis=0)))) if left_m.size else 0.0
    if drift is None or drift.by_chance > _BY_CHANCE or drift.total_m < max(_SMALLEST_M, 0.2 * rms):
        return []
    return [
        Lint(
            "order",
            make_message(
                "residuals wander by {total:.2f} mm from the first row to the last: device or arm moved slowly, or "
                "warmed up. Come back to a reference posture now and then.",
                total=drift.total_m * 1e3,
            ),
        )
    ]
