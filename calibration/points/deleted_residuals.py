"""What each point's residual would be if it had not been fitted, and which point the others contradict most."""

from dataclasses import dataclass

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.geometry import Array

_ROUNDING_M2 = 1e-18  # points that agree to a nanometre are all alike
_SPARE = 1e-6  # of a point's own residual: below, the fit cannot do without it


@dataclass(frozen=True, slots=True)
class DeletedResiduals:
    """Deleted residuals of points with three coordinates each."""

    sizes_m: tuple[float, ...]  # empty where a point cannot be spared
    stray: int  # the point that the others contradict most, counted from 0 …
    probability: float  # … and how probable a worse one is among points that are all alike


def deleted_residuals(orthonormal: Array, residuals: Array) -> DeletedResiduals:
    """Look at each point of a least-squares fit as if it had been left out.

    A point is judged by its own three residuals against the scatter that is left without it, as one of n.

    Parameters
    ----------
    orthonormal : (n, 3, p)
        A basis of the design's columns: its left singular vectors.
    residuals : (n, 3)
        Of the fit [m].

    References
    ----------
    R. D. Cook, S. Weisberg, Residuals and Influence in Regression, 1982, section 2.2.
    """
    n, unknowns = len(residuals), orthonormal.shape[2]
    freedom = 3 * n - unknowns - 3
    remaining = np.eye(3) - orthonormal @ orthonormal.transpose(0, 2, 1)
    if freedom < 1 or np.linalg.eigvalsh(remaining)[:, 0].min() < _SPARE:
        return DeletedResiduals((), int(np.linalg.norm(residuals, axis=1).argmax()), 1.0)
    deleted = np.linalg.solve(remaining, residuals[..., None])[..., 0]
    own = np.einsum("ni,ni->n", residuals, deleted)
    stray = int(own.argmax())
    rest = max(float((residuals**2).sum() - own[stray]), _ROUNDING_M2) / freedom
    probability = min(n * float(scipy.special.fdtrc(3.0, freedom, own[stray] / 3.0 / rest)), 1.0)
    return DeletedResiduals(tuple(float(v) for v in np.linalg.norm(deleted, axis=1)), stray, probability)
