"""What must hold before lost turns are accepted: the gate's conditions, and how stories compete."""

from cellcal.calibration.mastering.turn_hypotheses import Hypothesis
from cellcal.calibration.mastering.turn_results import GateCheck
from cellcal.calibration.message import make_message
from cellcal.calibration.uncertainty import chi_square_limit

SUCCESS_PROBABILITY = 0.9999
RATIO = 3.0
_CHANGE_LIKELIER = 3.0  # log of the evidence ratio at which a change of geometry blocks whole turns


def integer_checks(hypothesis: Hypothesis) -> list[GateCheck]:
    """Return the conditions on the whole turns of a story: probability, distance of the next best, rounding."""
    fix = hypothesis.fix
    ratio = min(fix.distance_ratio, 1e6)
    chance = make_message(
        "the chance that all whole turns are right is {success_probability:.6f}",
        success_probability=fix.success_probability,
    )
    further = f"{ratio:.0f}" if ratio >= 100.0 else f"{ratio:.3g}"
    rounding = "search and rounding agree" if hypothesis.rounded_same else "search and rounding disagree"
    return [
        GateCheck(
            "success probability",
            fix.success_probability > SUCCESS_PROBABILITY,
            fix.success_probability,
            SUCCESS_PROBABILITY,
            chance,
        ),
        GateCheck(
            "ratio",
            ratio > RATIO,
            ratio,
            RATIO,
            make_message("the next best turns are {further} times further away", further=further),
        ),
        GateCheck("rounding", hypothesis.rounded_same, float(hypothesis.rounded_same), 1.0, rounding),
    ]


def chi_limit(hypothesis: Hypothesis) -> float:
    """Return the 99.9 % limit of a story's chi square."""
    return chi_square_limit(max(hypothesis.degrees_of_freedom, 1))


def is_blocking_whole_turns(rival: Hypothesis, whole: Hypothesis) -> bool:
    """Return whether a rival forbids to accept whole turns: a fraction of a turn does once it is likelier."""
    margin = _CHANGE_LIKELIER if rival.kind == "geometry" else 0.0
    return rival.log_evidence > whole.log_evidence + margin


def is_explained(hypothesis: Hypothesis) -> bool:
    """Return whether a story leaves no more than 99.9 % of the residuals that it allows."""
    return hypothesis.chi_square <= chi_limit(hypothesis)


def consequence_of(hypothesis: Hypothesis) -> tuple[str, tuple[int, ...]]:
    """Return what a story leads to: stories with the same consequence do not compete."""
    if hypothesis.kind in ("turns", "equipment"):
        return "turns", tuple(round(t) for t in hypothesis.turns)
    return hypothesis.kind, hypothesis.real_axes if hypothesis.kind == "motor" else ()
