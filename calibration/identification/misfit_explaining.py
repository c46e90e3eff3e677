"""Readings of the rows by which they fit: every known cause, ranked by quick fits and then really fitted."""

from collections.abc import Sequence
from dataclasses import replace

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitScore, describe_cause
from cellcal.calibration.identification.misfit_fit import fit_quickly, motion_of
from cellcal.calibration.identification.misfit_hypotheses import FileNames
from cellcal.calibration.identification.misfit_ranking import MisfitCandidate, coarse_candidates
from cellcal.calibration.identification.misfit_zeros import with_fitted_zeros
from cellcal.calibration.identification.observations import Observations
from cellcal.calibration.identification.quick_fit import spread_rows

MOST_ROWS = 80
DECISIVE = 3.0  # times better must the rows fit with a cause
ALIKE = 1.6  # times the best score: these causes cannot be told apart
ALIKE_M = 2e-4
_GROSS = 0.015  # of the motion: nothing is calibrated by such a fit
_GROSS_M = 5e-3
_MOST_CAUSES = 4
_KINDS = (
    "unit",
    "angle unit",
    "slide unit",
    "slide",
    "screw",
    "lag",
    "zero",
    "scale",
    "turn",
    "mirror",
    "coupling",
    "sign",
    "home",
    "order",
    "rows",
    "model",
    "device",
    "column",
)


def gross_m(motion_m: float) -> float:
    """Return what rows leave at least that no arm explains [m]."""
    return max(_GROSS * motion_m, _GROSS_M)


def explaining_causes(
    model: RobotModel,
    observations: Observations,
    limit_m: float,
    names: FileNames,
    others: Sequence[RobotModel],
) -> tuple[MisfitCause, ...]:
    """Return the causes that explain the rows, the simplest first; all of them fit alike."""
    candidates = coarse_candidates(
        model, observations, spread_rows(len(observations), MOST_ROWS), names, others
    )
    found: list[tuple[MisfitCandidate, MisfitScore]] = []
    for candidate in candidates:
        fitted = fit_quickly(candidate.model, candidate.observations, limit_m=limit_m * candidate.scale)
        if fitted.score_m / candidate.scale <= limit_m and _is_plausible(candidate, fitted):
            found.append(
                (replace(candidate, reading=with_fitted_zeros(candidate.reading, fitted, names)), fitted)
            )
    if not found:
        return ()
    best = min(fitted.score_m / candidate.scale for candidate, fitted in found)
    alike = [
        (candidate, fitted)
        for candidate, fitted in found
        if fitted.score_m / candidate.scale <= ALIKE * best + ALIKE_M and candidate.part_count
    ]
    alike.sort(
        key=lambda pair: (
            pair[0].goes_beyond_limits,
            pair[0].part_count,
            _KINDS.index(pair[0].kinds[-1]),
            pair[1].score_m,
        )
    )
    causes: dict[str, MisfitCause] = {}
    for candidate, fitted in alike:
        cause = describe_cause(candidate, fitted)
        if candidate.part_count <= alike[0][0].part_count + 1:
            causes.setdefault(cause.says, cause)
    return tuple(causes.values())[:_MOST_CAUSES]


def _is_plausible(candidate: MisfitCandidate, fitted: MisfitScore) -> bool:
    motion_m = motion_of(candidate.model, candidate.observations)
    return fitted.score_m <= gross_m(motion_m)
