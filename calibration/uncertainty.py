"""Coverage factors, and the rule that turns a value with an uncertainty into a verdict."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy  # loads a part of it when that is first used: 0.4 s

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message


class Verdict(StrEnum):
    """The statement that is justified about a limit. UNDECIDED means: measure more."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"


@dataclass(frozen=True, slots=True)
class Decision:
    """A verdict with everything that led to it; ``rule`` is a sentence for the certificate."""

    verdict: Verdict
    value: float
    standard_uncertainty: float
    guard_band: float
    limit: float
    rule: str


def coverage_factor(degrees_of_freedom: float = float("inf"), probability: float = 0.95) -> float:
    """Return the two-sided Student factor k: 2.45 for 6 degrees of freedom at 95 %.

    With unlimited degrees of freedom and 95 % it is the conventional k = 2 rather than 1.96.

    References: JCGM 100:2008, Guide to the expression of uncertainty in measurement, G.3 and table G.2.
    """
    _require_that(
        degrees_of_freedom > 0 and 0 < probability < 1, "coverage needs degrees of freedom > 0 and 0 < p < 1"
    )
    if np.isinf(degrees_of_freedom):
        return 2.0 if probability == 0.95 else float(scipy.special.ndtri(0.5 + probability / 2.0))
    return float(scipy.special.stdtrit(degrees_of_freedom, 0.5 + probability / 2.0))


def coverage_in_space(
    variances: Sequence[float], degrees_of_freedom: float = float("inf"), probability: float = 0.95
) -> float:
    r"""Return k such that a vector's error is no longer than ``k sqrt(sum of variances)`` with this probability.

    A sum of squares with unequal variances is nearly ``g chi2(h)``, ``h = (sum v)^2 / sum v^2``; with variances that
    share one scale, estimated from the residuals, ``k^2`` is the quantile of ``F(h, degrees of freedom)``. Exact
    for one direction (Student's factor) and for equal variances (Hotelling).

    Parameters
    ----------
    variances : n numbers >= 0
        Along the principal axes of the covariance; not all zero.
    degrees_of_freedom : float
        Of the scale of the variances [1].

    Raises
    ------
    CalibrationError
        Variances that are negative, not finite or all zero; degrees of freedom <= 0.

    References
    ----------
    F. E. Satterthwaite, Biometrics Bulletin 2 (1946) 110; G. E. P. Box, Ann. Math. Stat. 25 (1954) 290.
    """
    return float(
        coverage_in_space_of(np.asarray([variances], dtype=float), degrees_of_freedom, probability)[0]
    )


def coverage_in_space_of(
    variances: Array, degrees_of_freedom: float = float("inf"), probability: float = 0.95
) -> Array:
    """Return `coverage_in_space` of many vectors (N,), from variances (N, n) along their principal axes."""
    v = np.asarray(variances, dtype=float)
    sound = bool(np.isfinite(v).all()) and bool((v >= 0).all()) and bool((v.sum(axis=-1) > 0).all())
    _require_that(sound, "coverage needs variances >= 0, one of them above")
    _require_that(
        degrees_of_freedom > 0 and 0 < probability < 1, "coverage needs degrees of freedom > 0 and 0 < p < 1"
    )
    directions = v.sum(axis=-1) ** 2 / (v**2).sum(axis=-1)
    if np.isinf(degrees_of_freedom):
        return np.asarray(np.sqrt(scipy.special.chdtri(directions, 1.0 - probability) / directions))
    return np.asarray(np.sqrt(scipy.special.fdtri(directions, degrees_of_freedom, probability)))


def effective_degrees_of_freedom(components: Sequence[tuple[float, float]]) -> float:
    """Return the Welch-Satterthwaite degrees of freedom of (standard uncertainty, degrees of freedom) pairs.

    References: JCGM 100:2008, Guide to the expression of uncertainty in measurement, G.4.1.
    """
    total = sum(u * u for u, _ in components)
    spread = sum(u**4 / dof for u, dof in components if np.isfinite(dof))
    return float("inf") if spread == 0.0 else total * total / spread


def chi_square_limit(degrees_of_freedom: float, probability: float = 0.999) -> float:
    """Return the value that chi square exceeds with probability ``1 - probability``."""
    _require_that(degrees_of_freedom > 0, "chi square needs at least one degree of freedom")
    return float(scipy.special.chdtri(degrees_of_freedom, 1.0 - probability))


def decide_conformity(
    value: float, standard_uncertainty: float, limit: float, *, degrees_of_freedom: float = float("inf")
) -> Decision:
    r"""Judge a value against an upper limit: conformity and non-conformity must both be proved.

    PASS if ``x + g <= L``, FAIL if ``x - g > L``, otherwise UNDECIDED. The guard band is ``g = k u`` with the
    one-sided 95 % factor (1.645, or Student's for few degrees of freedom).

    Parameters
    ----------
    value : float
        Magnitude x that must not exceed the limit, in any unit.
    standard_uncertainty : float
        u of the value, in the same unit, >= 0.
    limit : float
        L, in the same unit.
    degrees_of_freedom : float
        Of the uncertainty [1].

    Returns
    -------
    Decision
        The verdict and the rule in words.

    Raises
    ------
    CalibrationError
        An input is not finite or the uncertainty is negative.

    References
    ----------
    ISO 14253-1, decision rules for verifying conformity or nonconformity with specifications.
    """
    finite = bool(np.isfinite([value, standard_uncertainty, limit]).all())
    _require_that(
        finite and standard_uncertainty >= 0, "a decision needs finite numbers and an uncertainty >= 0"
    )
    _require_that(degrees_of_freedom > 0, "a decision needs at least one degree of freedom")
    unlimited = np.isinf(degrees_of_freedom)
    factor = (
        float(scipy.special.ndtri(0.95))
        if unlimited
        else float(scipy.special.stdtrit(degrees_of_freedom, 0.95))
    )
    guard_band_width = factor * standard_uncertainty
    rule = make_message(
        "proved at 95 % one-sided: guard band {factor:.2f} u (after ISO 14253-1)", factor=factor
    )
    verdict = Verdict.UNDECIDED
    if value + guard_band_width <= limit:
        verdict = Verdict.PASS
    elif value - guard_band_width > limit:
        verdict = Verdict.FAIL
    return Decision(verdict, value, standard_uncertainty, guard_band_width, limit, rule)


def _require_that(holds: bool, message: str) -> None:
    if not holds:
        raise CalibrationError(message)
