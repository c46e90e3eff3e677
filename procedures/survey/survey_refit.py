"""The lengths of a survey once more, some of them left out: what if, of a finished run."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pydantic import TypeAdapter

from cellcal.calibration.message import make_message
from cellcal.calibration.wires.network_fit import WireNetwork, length_misses
from cellcal.procedures.refit import (
    LEFT_OUT,
    MEASURED_AGAIN,
    FitPoint,
    PointMiss,
    Refit,
    RefitError,
    RefitResult,
    Use,
    misses_of_lengths,
)
from cellcal.procedures.run_history import Finding
from cellcal.procedures.steps.length import LengthCapture
from cellcal.procedures.survey.survey import Captures, Survey, SurveyPlan, SurveyRules, SurveyState

LEAST_AT_A_SPOT = 3
_NO_WEIGHT_M = 1.0  # a deviation with which a length tells nothing
_STATE: TypeAdapter[SurveyState] = TypeAdapter(SurveyState)
_PLAN: TypeAdapter[SurveyPlan] = TypeAdapter(SurveyPlan)
_CAPTURE: TypeAdapter[LengthCapture] = TypeAdapter(LengthCapture)


@dataclass(frozen=True, slots=True)
class TakenLength:
    """One length: its step, at which spot, and why it was set aside; empty where it was not."""

    step: str
    spot: int
    capture: LengthCapture
    aside: str = ""


def survey_of(found: Mapping[str, Any], rules: SurveyRules) -> Survey:
    """Return the survey of a run from its findings."""
    state, plan = found["read the robot"], found["plan the poses"]
    return Survey(_STATE.validate_python(state), _PLAN.validate_python(plan), rules)


def lengths_of(findings: Sequence[Finding]) -> tuple[TakenLength, ...]:
    """Return all lengths of a run in their order.

    One that was contradicted was taken again just after a look; where no length follows a look, and no choice, it was
    left out.
    """
    taken: list[TakenLength] = []
    recorded = next(f.value["recorded"] for f in findings if f.step == "read the robot")
    first = int(recorded is not None)  # the record's lengths come before all spots
    spot, doubted = -1, None
    for finding in findings:
        if finding.step.startswith("move the wire "):
            spot += 1
        elif finding.step.startswith("choose a pose "):
            doubted = None
        elif finding.step.startswith("look at the lengths "):
            if doubted is not None:
                taken[doubted] = replace(taken[doubted], aside=LEFT_OUT)
            doubted = _worst_length(taken, finding.value, first)
        elif finding.step.startswith("capture "):
            capture = _CAPTURE.validate_python(finding.value)
            if doubted is None:
                taken.append(TakenLength(finding.step, spot, capture))
                continue
            taken.append(replace(taken[doubted], aside=MEASURED_AGAIN))
            taken[doubted] = TakenLength(finding.step, spot, capture)
            doubted = None
    return tuple(taken)


def _worst_length(taken: Sequence[TakenLength], network: Mapping[str, Any], first: int) -> int | None:
    """Return which length a look found worst; None where it is one of the record's."""
    spot = network["worst_mounting"] - first
    standing = [k for k, each in enumerate(taken) if each.spot == spot and not each.aside]
    return standing[network["worst_capture"]] if standing else None


def refit_lengths(
    survey: Survey, findings: Sequence[Finding], solve: Callable[[Captures], tuple[RefitResult, WireNetwork]]
) -> Refit:
    """Return the lengths of a survey as points of a fit; ``solve`` is the procedure's own, of the lengths used."""
    taken = lengths_of(findings)
    points = tuple(FitPoint(t.step, not t.aside, t.aside) for t in taken)

    def fit_again(use: Use) -> RefitResult:
        captures = _captures_by_spot(survey, tuple(t for t, used in zip(taken, use, strict=True) if used))
        for number, spot in enumerate(captures, 1):
            if len(spot) < LEAST_AT_A_SPOT:
                raise RefitError(
                    make_message(
                        "{spot_count} lengths at spot {number} are too few to place it.",
                        spot_count=len(spot),
                        number=number,
                    ),
                    remedy=make_message(
                        "Keep {least_at_a_spot} or more at each spot.", least_at_a_spot=LEAST_AT_A_SPOT
                    ),
                    code="review.too_few",
                )
        found, network = solve(captures)
        return replace(found, misses=_point_misses(survey, taken, use, network))

    return Refit("wire", points, LEAST_AT_A_SPOT * len(survey.plan.spots), "origin", fit_again)


def _captures_by_spot(survey: Survey, taken: Sequence[TakenLength]) -> Captures:
    spots = range(len(survey.plan.spots))
    return tuple(tuple(t.capture for t in taken if t.spot == spot) for spot in spots)


def _point_misses(
    survey: Survey, taken: Sequence[TakenLength], use: Use, network: WireNetwork
) -> tuple[PointMiss, ...]:
    """Return what every length misses the fit by; those left out take part without any weight."""
    weighed = [
        t if used else replace(t, capture=replace(t.capture, sigma_m=_NO_WEIGHT_M))
        for t, used in zip(taken, use, strict=True)
    ]
    found = length_misses(
        survey.nominal_model(),
        survey.wire_network_prior(),
        survey.make_mountings(_captures_by_spot(survey, weighed)),
    )
    recorded = survey.state.recorded
    first = 0 if recorded is None else len(recorded.lengths_m)
    by_spot = sorted(range(len(taken)), key=lambda k: taken[k].spot)  # as the mountings have them
    residuals = dict(zip(by_spot, found[first:].tolist(), strict=True))
    worst = -1
    if not network.is_consistent():
        at = network.worst_mounting - (recorded is not None)
        standing = [k for k in by_spot if use[k] and taken[k].spot == at]
        worst = standing[network.worst_capture] if standing else -1
    return misses_of_lengths([residuals[k] for k in range(len(taken))], use, worst)
