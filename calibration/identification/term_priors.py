"""Priors of joint terms, widened where few rows show that sag, ripple or gear errors are larger than usual."""

from dataclasses import replace

import numpy as np

from cellcal.calibration.identification.estimator import ArmFit
from cellcal.calibration.identification.parameters import ParameterLayout, Priors, term_parameters

_PRIOR_OF_ROLE = {"gravity": "sag_rad_per_m", "harmonic": "ripple_rad", "gear": "gear_ratio"}
FEW_ROWS = 60  # up to here priors speak beside the rows
AVERAGED_ROWS = 120  # up to here a misfit is bent into the parameters more than residuals show
_CLEARLY_LARGER = 1.15  # times the prior: less hardly changes a stated deviation
_FEWEST = 0.5  # determined coefficients: fewer show no size
_LARGEST = 5.0  # times the prior, in one step


def widen_term_priors(fit: ArmFit, priors: Priors) -> Priors:
    """Return the priors with each kind of joint term as large as the fit shows it; never smaller than given.

    With few rows a prior that is too tight keeps coefficients near zero and states deviations as small as itself.
    The size of a kind is the root of its coefficients' squares over the number of them that the rows determine.

    References
    ----------
    D. J. C. MacKay, Bayesian interpolation, Neural Computation 4 (1992) 415: re-estimation of the size of a prior
    from the number of well-determined parameters.
    """
    squares = (fit.deviations / fit.layout.prior_sigmas) ** 2
    determined = 1.0 - np.diag(fit.covariance) / fit.layout.prior_sigmas**2
    wider = {}
    for role, name in _PRIOR_OF_ROLE.items():
        of_role = [i for i, parameter in enumerate(fit.layout.parameters) if parameter.role == role]
        size = float(np.sqrt(squares[of_role].sum() / max(determined[of_role].sum(), _FEWEST)))
        if size > _CLEARLY_LARGER:
            wider[name] = min(size, _LARGEST) * float(getattr(priors, name))
    return replace(priors, **wider)


def with_term_priors(fit: ArmFit, priors: Priors) -> ParameterLayout:
    """Return the layout of a fit whose joint terms have these priors."""
    others = fit.layout.parameters[: len(fit.layout) - fit.layout.terms]
    return replace(fit.layout, parameters=(*others, *term_parameters(fit.state.terms, priors)))
