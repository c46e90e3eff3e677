"""Acceptance on the standard deviation of joint offsets: met, missed or undecided, and what would help."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads a part of it when that is first used

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit
from cellcal.calibration.identification.identifiability import NotIdentified, not_identified
from cellcal.calibration.identification.robust import RobustFit
from cellcal.calibration.identification.tip_uncertainty import offset_slopes
from cellcal.calibration.uncertainty import Verdict

_ENDLESS = 1e6  # times the rows that were measured
_PROBABILITY = 0.95


@dataclass(frozen=True, slots=True)
class AcceptedOffset:
    """One joint offset against the limit."""

    parameter: str
    sigma_rad: float
    verdict: Verdict
    more: str  # what would help; empty if it passes


@dataclass(frozen=True, slots=True)
class OffsetAcceptance:
    """All offsets against the limit; the verdict is that of the worst."""

    verdict: Verdict
    limit_rad: float
    offsets: tuple[AcceptedOffset, ...]
    rule: str


@dataclass(frozen=True, eq=False)
class OffsetEvidence:
    """Evidence about an arm's offsets: a fit, from how many rows, and what hides those it cannot determine."""

    fit: ArmFit
    rows: int
    degrees_of_freedom: float
    hidden: tuple[NotIdentified, ...]


def accept_offsets(robust: RobustFit, limit_rad: float, names: Sequence[str] = ()) -> OffsetAcceptance:
    """Judge the offsets of a fit by one device: see `judge_offsets`; its sigmas are those that residuals show."""
    rows = len(robust.problem.observations) - len(robust.rejected)
    evidence = OffsetEvidence(robust.fit, rows, robust.degrees_of_freedom, not_identified(robust.fit))
    return judge_offsets(evidence, limit_rad, names)


def judge_offsets(evidence: OffsetEvidence, limit_rad: float, names: Sequence[str] = ()) -> OffsetAcceptance:
    r"""Judge the standard deviations of joint offsets against a limit.

    Parameters
    ----------
    known : OffsetEvidence
        Its covariance belongs to sigmas that the residuals show.
    limit_rad : float
        Largest accepted standard deviation of an offset [rad].
    names : sequence of str
        Offsets that count; none means all free ones.

    Returns
    -------
    OffsetAcceptance
        PASS if even the upper 95 % limit of every deviation keeps the limit, FAIL if the lower limit of one does
        not, else UNDECIDED.

    Raises
    ------
    CalibrationError
        The limit is no positive angle, or there is no such offset in the fit.

    Notes
    -----
    Joints that slide have no angle to be judged.
    Offsets are those of a table of four numbers a joint (`calibration.identification.tip_uncertainty`).
    A deviation from residuals with nu degrees of freedom is known to ``sqrt(nu / chi2)``. Further poses are taken
    to be like those measured: information grows with their number, and what it never reaches, these postures and
    this instrument do not show.
    """
    if not (np.isfinite(limit_rad) and limit_rad > 0):
        raise CalibrationError("the accepted deviation is a positive angle.", code="usage")
    fit = evidence.fit
    slopes = offset_slopes(fit)
    turning = {p.name for p in fit.layout.parameters if p.unit == "rad"}
    free = [name for name in slopes if name in turning]
    judged_names = list(names) or free
    missing = [name for name in judged_names if name not in free]
    if missing or not judged_names:
        raise CalibrationError(
            f"{missing[0] if missing else 'no joint offset'} was not fitted, so nothing can be accepted.",
            remedy=f"Fitted: {', '.join(free) or 'none'}. Ask for `--level 1` or higher, or free the offsets.",
        )
    freedom = max(evidence.degrees_of_freedom, 1.0)
    low = float(np.sqrt(freedom / scipy.special.chdtri(freedom, 1.0 - _PROBABILITY)))
    high = float(np.sqrt(freedom / scipy.special.chdtri(freedom, _PROBABILITY)))
    moved = np.array([slopes[name] for name in judged_names])
    sigma = np.sqrt(np.einsum("kp,pq,kq->k", moved, fit.covariance, moved))
    least, needed = _more_poses_needed(fit, moved, limit_rad / high, evidence.rows)
    judged = []
    for i, name in enumerate(judged_names):
        verdict = Verdict.UNDECIDED
        if sigma[i] * high <= limit_rad:
            verdict = Verdict.PASS
        elif sigma[i] * min(low, 1.0) > limit_rad:
            verdict = Verdict.FAIL
        more = "" if verdict is Verdict.PASS else _suggest_remedy(evidence, name, float(least[i]), needed[i])
        judged.append(AcceptedOffset(name, float(sigma[i]), verdict, more))
    verdicts = [item.verdict for item in judged]
    worst = next(v for v in (Verdict.FAIL, Verdict.UNDECIDED, Verdict.PASS) if v in verdicts)
    rule = (
        f"passed if the upper 95 % limit of the deviation ({high:.2f} times it, {freedom:.0f} degrees of freedom) "
        "keeps the limit"
    )
    return OffsetAcceptance(worst, limit_rad, tuple(judged), rule)


def _more_poses_needed(
    fit: ArmFit, moved: Array, sigma_rad: float, rows: int
) -> tuple[Array, list[int | None]]:
    """Return each offset's deviation after endless poses like these, and how many more make it small enough."""
    prior = fit.layout.prior_sigmas
    values, vectors = np.linalg.eigh(fit.covariance / np.outer(prior, prior))
    informed = 1.0 / np.clip(values, 1e-15, 1.0) - 1.0  # in prior deviations, of the data alone
    parts = ((moved * prior) @ vectors) ** 2

    def deviations_after(times: float) -> Array:
        found: Array = np.sqrt(parts @ (1.0 / (1.0 + times * informed)))
        return found

    least = deviations_after(_ENDLESS)
    needed: list[int | None] = []
    for i in range(len(moved)):
        if least[i] > sigma_rad:
            needed.append(None)
            continue
        few, many = 1.0, _ENDLESS
        while many - few > 1e-4 * few:
            middle = np.sqrt(few * many)
            few, many = (few, middle) if deviations_after(middle)[i] <= sigma_rad else (middle, many)
        needed.append(max(int(np.ceil((many - 1.0) * rows)), 1))
    return least, needed


def _suggest_remedy(evidence: OffsetEvidence, name: str, least_rad: float, more: int | None) -> str:
    if more is not None:
        return f"about {more} more poses like these"
    hidden = next((item for item in evidence.hidden if item.parameter == name), None)
    if hidden is not None and hidden.partner:
        return f"not reachable with this set-up: hidden behind {hidden.partner}; {hidden.cure}"
    if hidden is not None:
        return f"not reachable with this set-up; {hidden.cure}"
    return f"not reachable: endless poses like these leave {np.rad2deg(least_rad):.4f} deg"
