"""How far a further reading may be from its prediction: what no parameter explains, learnt from held-out rows.

The covariance of a fit counts what noise does to its parameters. What the model lacks is not in it, and on a real
arm that is most of the error. Rows that were held out show it; so do whole regions of postures that were held out,
for postures far from the measured ones.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.calibration.uncertainty import coverage_in_space_of

_PROBABILITY = 0.95
_FEWEST_SCORES = 20  # rows: from so many on the quantile of their own scores is one of them
_GROWTHS = np.geomspace(1.0, 1e3, 61)
_FAR_SHARE = 0.99  # of the held-out rows have a parameter variance below that of a posture far from them
_INDEPENDENT = 0.5  # of the readings of held-out rows: each fit has seen most of the others
_SMALLEST_M2 = 1e-16


@dataclass(frozen=True, eq=False)
class HeldOutErrors:
    """Rows predicted by fits that have not seen them: sizes of errors, and what the fits' own doubt expects."""

    errors_m: Array  # (N,)
    variances_m2: Array  # (N,) sum over the channels, of the parameters
    own_m2: Array  # (N,) sum over the channels, of a residual model; zero without one
    channels: int  # 1 for lengths, 3 for places

    @classmethod
    def without_rows(cls, channels: int = 3) -> "HeldOutErrors":
        """Return no rows."""
        return cls(np.zeros(0), np.zeros(0), np.zeros(0), channels)

    def __len__(self) -> int:
        return len(self.errors_m)

    def select_rows(self, rows: NDArray[np.intp]) -> "HeldOutErrors":
        """Return some of the rows."""
        return HeldOutErrors(self.errors_m[rows], self.variances_m2[rows], self.own_m2[rows], self.channels)


@dataclass(frozen=True, slots=True)
class ModelError:
    """The covariance to be added to that of the parameters, and the factors to 95 % in space."""

    variance_m2: float  # a coordinate: noise of the device and what the model lacks
    growth: float  # of the parameters' variance, where what the model lacks bends them
    widening: float  # of the theoretical factor, among the measured postures
    far_widening: float  # away from them
    near_m2: float  # sum of the parameters' variances, up to which a posture counts as among them
    degrees_of_freedom: float
    rows: int
    far_rows: int
    tail_rows: int = 0  # of them, which the fit rejected: the long tail of errors

    def total_covariance(self, covariances: Array, own_m2: Array) -> Array:
        """Return the covariance of further readings (N, 3, 3) [m^2].

        Parameters
        ----------
        covariances : (N, 3, 3)
            Of the parameters alone.
        own_m2 : (N,)
            Variance a coordinate of a residual model.
        """
        total: Array = self.growth * covariances + (own_m2 + self.variance_m2)[:, None, None] * np.eye(3)
        return total

    def is_extrapolated(self, covariances: Array) -> NDArray[np.bool_]:
        """Return which postures (N,) the parameters know worse than any among the measured ones."""
        return np.asarray(np.einsum("nii->n", covariances) > self.near_m2)

    def expanded_m(self, covariances: Array, own_m2: Array, beyond: NDArray[np.bool_]) -> Array:
        """Return the radius (N,) [m] within which 95 % of further readings are; ``beyond`` names far postures."""
        total = self.total_covariance(covariances, own_m2)
        far = self.is_extrapolated(covariances) | beyond
        widening = np.where(far, max(self.widening, self.far_widening), self.widening)
        return widening * expanded_in_space(total, self.degrees_of_freedom)


def expanded_in_space(covariances: Array, degrees_of_freedom: float) -> Array:
    """Return the radius (N,) that holds 95 % of normal errors with these covariances (N, 3, 3)."""
    variances = np.maximum(np.linalg.eigvalsh(covariances), 0.0)
    factors = coverage_in_space_of(variances, degrees_of_freedom, _PROBABILITY)
    radius: Array = factors * np.sqrt(variances.sum(axis=1))
    return radius


def model_error(
    near: HeldOutErrors, far: HeldOutErrors, degrees_of_freedom: float, tail_rows: int = 0
) -> ModelError:
    r"""Learn what the model lacks from rows held out among their neighbours, and from regions held out.

    Parameters
    ----------
    near, far : HeldOutErrors
        Without mistakes; ``tail_rows`` of them are in the long tail of the arm's errors.

    Notes
    -----
    The squared error of a row is expected to be ``growth V + own + c s^2`` with c channels. Growth, at least 1, is
    where the normal likelihood of all rows is largest, with ``s^2`` always so that the rows among neighbours have
    the mean square that they have. The theoretical factor to 95 % is widened by what the scores of the rows
    themselves need (split conformal), where they are enough; with a long tail it may be narrowed as well, since the
    mean square is then that of a few rows.

    References
    ----------
    V. Vovk, A. Gammerman, G. Shafer, Algorithmic Learning in a Random World, 2005, 4.1 (inductive conformal).
    """
    if len(near):
        degrees_of_freedom = min(degrees_of_freedom, max(_INDEPENDENT * near.channels * len(near), 1.0))
    growth = _covariance_growth(near, far)
    variance = _remaining_variance(near, growth)
    least = 0.0 if tail_rows else 1.0
    return ModelError(
        variance,
        growth,
        _coverage_widening(near, growth, variance, degrees_of_freedom, least),
        _coverage_widening(far, growth, variance, degrees_of_freedom, least),
        float(np.quantile(near.variances_m2, _FAR_SHARE)) if len(near) else 0.0,
        degrees_of_freedom,
        len(near),
        len(far),
        tail_rows,
    )


def _remaining_variance(near: HeldOutErrors, growth: float) -> float:
    """Return the variance a channel that held-out rows have beyond what parameters and residual model expect."""
    if not len(near):
        return _SMALLEST_M2
    excess = near.errors_m**2 - growth * near.variances_m2 - near.own_m2
    return max(float(excess.mean()) / near.channels, _SMALLEST_M2)


def _covariance_growth(near: HeldOutErrors, far: HeldOutErrors) -> float:
    if not len(far):
        return 1.0
    costs = [
        _scatter_cost(near, g, _remaining_variance(near, g))
        + _scatter_cost(far, g, _remaining_variance(near, g))
        for g in _GROWTHS
    ]
    return float(_GROWTHS[int(np.argmin(costs))])


def _scatter_cost(rows: HeldOutErrors, growth: float, variance: float) -> float:
    """Return minus twice the log likelihood of the sizes of errors, directions taken as alike."""
    each = (growth * rows.variances_m2 + rows.own_m2) / rows.channels + variance
    return float((rows.errors_m**2 / each + rows.channels * np.log(each)).sum())


def _coverage_widening(
    rows: HeldOutErrors, growth: float, variance: float, freedom: float, least: float
) -> float:
    if len(rows) < _FEWEST_SCORES:
        return 1.0
    each = (growth * rows.variances_m2 + rows.own_m2) / rows.channels + variance
    factor = coverage_in_space_of(np.ones((1, rows.channels)), freedom, _PROBABILITY)[0]
    scores = np.sort(rows.errors_m / (factor * np.sqrt(rows.channels * each)))
    place = min(int(np.ceil((len(scores) + 1) * _PROBABILITY)), len(scores)) - 1
    return max(least, float(scores[place]))
