"""What a survey with the draw-wire would need and reach, before a device is touched."""

import math
from collections.abc import Callable
from dataclasses import replace

from cellcal.calibration.message import make_message
from cellcal.procedures.accuracy_limits import FRAME
from cellcal.procedures.forecast import (
    PERSON_S,
    SAMPLE_S,
    Forecast,
    Knowledge,
    PlannedPose,
    Prediction,
    missing_wire_setup,
)
from cellcal.procedures.survey.survey import (
    EACH_CAPTURE,
    Survey,
    SurveyPlan,
    SurveyRules,
    SurveyState,
    recorded_wire,
)
from cellcal.procedures.survey.survey_choice import expected_at_least

_MORE_CARE = 4  # times the readings, or a fourth of the scale's uncertainty: what more care is taken to be


def _state_before(knowledge: Knowledge) -> SurveyState:
    """Return the robot as it is assumed before its controller was read.

    Raises
    ------
    ValueError
        Something of ``missing_wire_setup`` is not known.
    """
    if knowledge.model is None or knowledge.gauge is None or knowledge.gauge_setup is None:
        raise ValueError(
            make_message(
                "not known: {missing_wire_setup}", missing_wire_setup=", ".join(missing_wire_setup(knowledge))
            )
        )
    zero = () if knowledge.record is None else knowledge.record.counts_at_zero
    return SurveyState(
        serial="" if knowledge.record is None else knowledge.record.robot_serial,
        model=knowledge.model.name,
        joints_rad=(0.0,) * knowledge.model.axis_count,
        counts_at_zero=zero,
        epoch=None,
        gauge_setup=knowledge.gauge_setup,
        gauge_range_m=knowledge.gauge.range_m,
        gauge_sigma_m=knowledge.gauge.sigma_m,
        limits=knowledge.limits,
        recorded=None
        if knowledge.record is None or knowledge.record.wire is None
        else recorded_wire(knowledge.record),
    )


def survey_forecast(
    plan_survey: Callable[[SurveyState], SurveyPlan], rules: SurveyRules, what: str, knowledge: Knowledge
) -> Forecast:
    """Return how many captures a survey expects, how long they take and what they will tell."""
    lacks = missing_wire_setup(knowledge)
    if lacks:
        return Forecast(0.0, lacks=lacks)
    state = _state_before(knowledge)
    survey = Survey(state, plan_survey(state), rules)
    return _forecast_of(survey, what, knowledge)


def _forecast_of(survey: Survey, what: str, knowledge: Knowledge) -> Forecast:
    rules, goal, plan = survey.rules, survey.plan.goal, survey.plan
    low, high = rules.min_captures, min(rules.max_captures, *(len(pool) for pool in plan.pools))
    while low < high:  # more captures never tell less
        middle = (low + high) // 2
        enough = goal.is_promised_by(*expected_at_least(survey, middle))
        low, high = (low, middle) if enough else (middle + 1, high)
    origin_u_m, angle_u_rad = expected_at_least(survey, low)
    captures = low * len(plan.spots)
    after = make_message("after {captures} captures", captures=captures)
    paced, each_s = plan.total_motion(low), knowledge.limits.settle_s + rules.samples * SAMPLE_S
    predictions = [
        Prediction(
            make_message("{what} origin", what=what), origin_u_m, "m",
            {name: limits.origin_m for name, limits in FRAME.items()},
            make_message(
                "{after}. {goal_text}", after=after, goal_text=_goal_text(survey, low, (origin_u_m, angle_u_rad))
            ),
        )
    ]  # fmt: skip
    if len(goal.points_in_inner_m) > 1:
        angles = {name: limits.angle_rad for name, limits in FRAME.items()}
        predictions.append(
            Prediction(make_message("{what} angle", what=what), angle_u_rad, "rad", angles, after)
        )
    poses = tuple(
        PlannedPose(f"spot {spot + 1}, pose {k + 1}", plan.pools[spot][index])
        for spot in range(len(plan.spots))
        for k, index in enumerate(plan.best[spot][:low])
    )
    return Forecast(
        duration_s=math.ceil(paced.moving_s + captures * each_s + len(plan.spots) * PERSON_S),
        poses=poses,
        speed_rad_s=paced.fastest_rad_s,
        predictions=tuple(predictions),
        assumed=()
        if survey.state.recorded
        else ("no mastering record: the arm's errors are taken from the maker's",),
        not_checked=plan.not_checked,
        planned=dict.fromkeys(EACH_CAPTURE, captures),
    )


def _goal_text(survey: Survey, count: int, reached: tuple[float, float]) -> str:
    """Return whether the limits of the settings will be met, and if not, by what they would be."""
    goal, rules = survey.plan.goal, survey.rules
    origin_u_mm = goal.origin_u_m * 1e3
    limit_text = make_message("{origin_u_mm:.3f} mm", origin_u_mm=origin_u_mm)
    if len(goal.points_in_inner_m) > 1:
        limit_text = make_message(
            "{origin_u_mm:.3f} mm and {angle_u_deg:.4f} deg",
            origin_u_mm=origin_u_mm,
            angle_u_deg=math.degrees(goal.angle_u_rad),
        )
    if goal.is_promised_by(*reached):
        return make_message("{limit_text} are asked for: in reach.", limit_text=limit_text)
    samples, scale = _MORE_CARE * rules.samples, rules.scale_sigma / _MORE_CARE
    ways = (
        (
            make_message("{samples} readings (samples) a capture", samples=samples),
            replace(rules, samples=samples),
        ),
        (
            make_message("a wire certified to {scale:.1e} (scale_sigma)", scale=scale),
            replace(rules, scale_sigma=scale),
        ),
        (
            make_message(
                "{samples} readings (samples) a capture and a wire certified to {scale:.1e} (scale_sigma)",
                samples=samples,
                scale=scale,
            ),
            replace(rules, samples=samples, scale_sigma=scale),
        ),
    )
    for words, other_rules in ways:
        other = replace(survey, rules=other_rules)
        if goal.is_promised_by(*expected_at_least(other, count)):
            return make_message(
                "{limit_text} are asked for: not in reach so. In reach by {words}; or by more points, further apart.",
                limit_text=limit_text,
                words=words,
            )
    return make_message(
        "{limit_text} are asked for: not in reach so. More points tell most, further apart and not in one plane.",
        limit_text=limit_text,
    )
