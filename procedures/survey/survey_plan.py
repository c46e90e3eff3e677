"""The plan of a survey with one draw-wire: the poses of each spot, the rest, and the page on which it is accepted."""

from dataclasses import dataclass

from cellcal.calibration.points.fixture import Triple
from cellcal.calibration.wires.network import WirePlace
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.motion.plan_words import PlanTour, plan_words
from cellcal.procedures.steps.pages import plan_page
from cellcal.procedures.survey.survey import (
    Survey,
    SurveyGoal,
    SurveyPlan,
    SurveyRules,
    SurveyState,
    WireSpot,
)
from cellcal.procedures.survey.survey_choice import order_pools
from cellcal.procedures.survey.survey_motion import (
    Wire,
    draw_pool,
    resting_poses,
    unchecked_remarks,
    way_to_rest,
)


@dataclass(frozen=True, slots=True)
class SpotLayout:
    """The unknown spots and the ways of the wire: exits and hooks with the wire's home first, and a wire a spot."""

    goal: SurveyGoal
    exits: tuple[WirePlace, ...]
    hooks: tuple[WirePlace, ...]
    spots: tuple[WireSpot, ...]
    wires: tuple[Wire, ...]
    mouth_at_m: Triple | None  # where the wire's mouth looks, in the base
    turns_mouth: bool  # the mouth is turned there at every spot; the housing stays otherwise


def plan_survey(state: SurveyState, rules: SurveyRules, layout: SpotLayout) -> SurveyPlan:
    """Draw the poses to choose from at every spot, and find a rest and a free way to it.

    Raises
    ------
    DegenerateDataError
        Too few poses at a spot, no rest, or no free way to one.
    """
    room, wires = rules.room, layout.wires
    mouth_at_m = layout.mouth_at_m if layout.turns_mouth else None
    pools = tuple(
        draw_pool(state.model, wire, room, mouth_at_m, (rules.candidates, rules.seed + k))
        for k, wire in enumerate(wires)
    )
    rests = resting_poses(state.model, wires, room, pools)
    plan = SurveyPlan(
        goal=layout.goal,
        exits=layout.exits,
        hooks=layout.hooks,
        spots=layout.spots,
        mouth_at_m=layout.mouth_at_m,
        way_to_rest_rad=way_to_rest(state.model, room, state.joints_rad, rests),
        pools=pools,
        best=((),) * len(pools),
        paces=tuple(state.speed_limit(hook, room) for _, hook, _ in wires),
        not_checked=unchecked_remarks(state.model, wires[0], room),
    )
    return order_pools(Survey(state, plan, rules))


def survey_plan_page(plan: SurveyPlan, rules: SurveyRules, what: str, by_hand: str) -> Instruction:
    """Return the page that asks for a plan: ``what`` is done, and what a person does ``by_hand`` between spots."""
    count = len(plan.spots) * rules.min_captures
    tour = PlanTour(count, plan.total_motion(rules.min_captures), by_hand)
    instruction = Instruction("accept_plan", plan_words(what, tour, plan.not_checked))
    return plan_page(instruction, tour, plan.planned_moves(rules))
