"""How many poses an acceptance needs, known before measuring; or why it cannot be reached, and what would help."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.identifiability import parameter_correlations
from cellcal.calibration.message import make_message
from cellcal.calibration.poses.measurement_poses import DesignCriterion, PosePlan, choose_poses
from cellcal.calibration.poses.measurement_prediction import (
    AccuracyPrediction,
    MeasurementPrediction,
    TestPoses,
    predict_accuracy,
)

_ENDLESS = 1e6  # repetitions of every candidate


@dataclass(frozen=True, slots=True)
class AcceptanceLimits:
    """How well each quantity must be known: standard deviations in SI; ``None`` does not matter.

    The margin divides the limits: predictions hold for the sigma that the instrument was said to have, and for
    an arm that the model can describe.
    """

    tip_rms_m: float | None = None
    tip_max_m: float | None = None
    offset_rad: float | None = None  # every joint offset, those that cannot be known included
    offsets_of: tuple[str, ...] = ()  # only these offsets, by name; all of them if empty
    margin: float = 1.2

    def __post_init__(self) -> None:
        limits = [v for v in (self.tip_rms_m, self.tip_max_m, self.offset_rad) if v is not None]
        if not limits or not all(np.isfinite(v) and v > 0 for v in limits) or not self.margin >= 1:
            raise CalibrationError(
                "an acceptance has at least one finite limit above zero, and a margin >= 1"
            )


@dataclass(frozen=True, slots=True)
class AcceptanceGap:
    """One limit that is not kept: what was predicted, and what is allowed with the margin."""

    what: str
    unit: str
    predicted: float
    allowed: float


@dataclass(frozen=True, eq=False)
class Sufficiency:
    """The smallest plan that meets an acceptance; or ``plan`` None and the reason."""

    plan: PosePlan | None
    prediction: AccuracyPrediction  # of the plan, or of the most that was tried
    reason: str
    after: MeasurementPrediction  # once they are measured


def acceptance_gaps(
    prediction: AccuracyPrediction, acceptance: AcceptanceLimits
) -> tuple[AcceptanceGap, ...]:
    """Return every limit that a prediction does not keep, worst first."""
    found = []
    for what, value, limit in (
        ("tool point rms", prediction.tip_rms_m, acceptance.tip_rms_m),
        ("tool point at the worst test pose", prediction.tip_max_m, acceptance.tip_max_m),
    ):
        if limit is not None and value > limit / acceptance.margin:
            found.append(AcceptanceGap(what, "m", value, limit / acceptance.margin))
    if acceptance.offset_rad is not None:
        allowed = acceptance.offset_rad / acceptance.margin
        found += [
            AcceptanceGap(name, "rad", sigma, allowed)
            for name, sigma in _offset_sigmas(prediction, acceptance)
            if sigma > allowed
        ]
    return tuple(sorted(found, key=lambda gap: -gap.predicted / gap.allowed))


def enough_poses(
    prediction: MeasurementPrediction,
    candidates_rad: Array,
    acceptance: AcceptanceLimits,
    tests: TestPoses,
    *,
    most: int = 100,
    criterion: DesignCriterion | None = None,
) -> Sufficiency:
    """Find the smallest number of poses whose best choice is predicted to meet an acceptance.

    Parameters
    ----------
    prediction : MeasurementPrediction
        From nominal, or from a fit onward: then the poses are those still to be measured, perhaps none.
    candidates_rad : (C, n)
        Postures that can be measured [rad].
    acceptance : Acceptance
        Limits with their margin.
    tests : TestPoses
        Where the tool point counts.
    most : int
        The largest number of poses to consider.
    criterion : Criterion, optional
        Default: offsets if only they are limited, else the test poses.

    Notes
    -----
    The number is found by bisection: a good choice of more poses is not worse.
    """
    candidates = np.asarray(candidates_rad, dtype=float)
    now = predict_accuracy(prediction, tests)
    if not acceptance_gaps(now, acceptance):
        plan = PosePlan((), candidates[:0], DesignCriterion.TEST_POSES, now, prediction)
        return Sufficiency(plan, now, "what is known already is enough", prediction)
    only_offsets = acceptance.tip_rms_m is None and acceptance.tip_max_m is None
    chosen_by = criterion or (DesignCriterion.OFFSETS if only_offsets else DesignCriterion.TEST_POSES)
    most = min(most, len(candidates))

    def plan_of(k: int, starts: int = 1) -> PosePlan:
        return choose_poses(prediction, candidates, k, tests, criterion=chosen_by, starts=starts)

    last = plan_of(most)
    missing = acceptance_gaps(last.prediction, acceptance)
    if missing:
        words = explain_shortfall(missing[0], prediction, candidates, acceptance, tests)
        return Sufficiency(None, last.prediction, f"not reachable with {most} poses: {words}", last.after)
    short, enough = 0, most
    while enough - short > 1:
        k = (short + enough) // 2
        plan = plan_of(k)
        if acceptance_gaps(plan.prediction, acceptance):
            short = k
        else:
            enough, last = k, plan
    last = plan_of(enough, starts=3)
    words = make_message(
        "{enough} poses are predicted to be enough, with a margin of {margin:g}",
        enough=enough,
        margin=acceptance.margin,
    )
    return Sufficiency(last, last.prediction, words, last.after)


def explain_shortfall(
    gap: AcceptanceGap,
    prediction: MeasurementPrediction,
    candidates: Array,
    acceptance: AcceptanceLimits,
    tests: TestPoses,
) -> str:
    """Say what stands in the way: too few poses, an instrument too coarse, or something that no pose shows."""
    scale, unit = (1e3, "mm") if gap.unit == "m" else (float(np.rad2deg(1.0)), "deg")
    words = f"{gap.what} {gap.predicted * scale:.3g} {unit}, allowed {gap.allowed * scale:.3g} {unit}"
    every = prediction.with_measured(candidates)
    remaining = {item.what: item for item in acceptance_gaps(predict_accuracy(every, tests), acceptance)}
    if gap.what not in remaining:
        return f"{words}; all candidates together would reach it: measure more poses, or each more than once"
    endless = prediction.with_measured(candidates, times=_ENDLESS)
    if gap.what in {item.what for item in acceptance_gaps(predict_accuracy(endless, tests), acceptance)}:
        return f"{words}, because {_hidden_behind(gap.what, endless)}"
    ratio = remaining[gap.what].predicted / remaining[gap.what].allowed
    return (
        f"{words}, because the instrument is too coarse or the candidates reach too little: "
        f"even all {len(candidates)} candidates leave {ratio:.2g} times what is allowed"
    )


def _hidden_behind(what: str, endless: MeasurementPrediction) -> str:
    """Say what a quantity hides behind that no number of measurements would bring out."""
    fit = endless.as_fit()
    not_identified = next((item for item in endless.not_identified() if item.parameter == what), None)
    if not_identified is not None:
        behind = f"hides behind {not_identified.partner}" if not_identified.partner else "does not show"
        return f"{what} {behind}: {not_identified.cure}"
    names = [parameter.name for parameter in fit.layout.parameters]
    if what not in names:
        return f"parameters that these measurements cannot see move the {what}: use a better instrument"
    others = np.abs(parameter_correlations(fit)[names.index(what)])
    others[names.index(what)] = 0.0
    return (
        f"only what is expected beforehand tells {what} from {names[int(np.argmax(others))]}: "
        "take the geometry as known, or judge the tool point instead"
    )


def _offset_sigmas(prediction: AccuracyPrediction, acceptance: AcceptanceLimits) -> list[tuple[str, float]]:
    every = zip(prediction.parameters, prediction.units, prediction.sigma, strict=True)
    offsets = [(name, sigma) for name, unit, sigma in every if name.endswith(" offset") and unit == "rad"]
    if not acceptance.offsets_of:
        return offsets
    unknown = set(acceptance.offsets_of) - {name for name, _ in offsets}
    if unknown:
        raise CalibrationError(
            make_message("there is no {unknown}.", unknown=sorted(unknown)[0]),
            remedy=make_message("Offsets are {offsets}.", offsets=", ".join((n for n, _ in offsets))),
        )
    return [(name, sigma) for name, sigma in offsets if name in acceptance.offsets_of]
