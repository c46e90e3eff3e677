"""Where a fixture stands in a robot's base: the draw-wire sits on its alignment points, one after the other.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.3, Fig. 7.
The robot carries the wire's hook to poses chosen one by one; the lengths give each point's place by trilateration,
the points give the fixture's pose. What cannot be told from its mirror image is refused.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from pydantic import Field, TypeAdapter
from pydantic_core import to_jsonable_python

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.points.alignment import Alignment
from cellcal.calibration.points.fixture import PlacedPoints, Triple, place_points, refuse_bad_points
from cellcal.calibration.wires.network import WirePlace
from cellcal.calibration.wires.network_fit import WireNetwork
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.accuracy_limits import FrameLimits
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.forecast import Forecast, Knowledge
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.refit import Refit, RefitResult, pose_values, values_of
from cellcal.procedures.run import Run
from cellcal.procedures.run_history import Finding
from cellcal.procedures.setting_texts import (
    FIXTURE,
    MOUTH_AT,
    OWN_LIMITS,
    RULES,
    WRITE_ANYWAY,
    describe_setting,
)
from cellcal.procedures.steps.mastering import check_same_epoch
from cellcal.procedures.survey.alignment_result import (
    AlignmentResult,
    alignment_instruction,
    judge_alignment,
    uncertain_error,
    wrong_shape_error,
)
from cellcal.procedures.survey.shared_fixture import (
    NOTHING_KNOWN,
    KnownWire,
    predict_base,
    read_known_wire,
    wire_points,
)
from cellcal.procedures.survey.survey import (
    EACH_CAPTURE,
    Captures,
    Survey,
    SurveyGoal,
    SurveyPlan,
    SurveyRules,
    SurveyState,
    WireSpot,
    fit_survey,
    goal_uncertainties,
)
from cellcal.procedures.survey.survey_choice import fixed_plan_captures
from cellcal.procedures.survey.survey_forecast import survey_forecast
from cellcal.procedures.survey.survey_motion import (
    Wire,
    middle_of_work,
)
from cellcal.procedures.survey.survey_plan import SpotLayout, plan_survey, survey_plan_page
from cellcal.procedures.survey.survey_refit import refit_lengths, survey_of
from cellcal.procedures.survey.wire_survey import measure_spots, read_survey_state
from cellcal.procedures.verdict import ProcedureVerdict
from cellcal.procedures.write_review import (
    WriteAnyway,
    raise_first,
    refuse_failed,
    with_order_remark,
    with_verdict,
)

ALIGNMENT_LIMITS = FrameLimits(0.00015, math.radians(0.02))
_SHARED_WIRE = (
    0.93  # of a base's limits: what two alignments with one wire share is known only when both are there
)
HOOK_WIRE = Instruction(
    "hook_stays_on",
    "Fix the hook's adaptor to the flange, where it stays throughout. Leave the wire itself off until you are asked.",
)


@dataclass(frozen=True, slots=True)
class FixtureAlignment:
    """Which fixture, where its points are on the drawing, roughly where it stands, and how well it must be known."""

    fixture: Annotated[str, Field(min_length=1, max_length=64), FIXTURE]
    points_in_fixture_m: Annotated[
        tuple[Triple, ...],
        Field(min_length=3, max_length=12),
        describe_setting(
            "Points of the fixture",
            "Where the wire's exit is set, three points or more, by the drawing, in x, y and z of the fixture.",
            "place",
            unit="m",
            basic=True,
            drawing="fixture",
        ),
    ]
    rough_base_fixture: Annotated[
        Pose,
        describe_setting(
            "Fixture, roughly",
            "Where the fixture stands in the robot's base and how it is turned, by tape measure.",
            "place",
            unit="m",
            basic=True,
            drawing="fixture",
        ),
    ]
    rough_sigma_m: Annotated[
        float,
        Field(gt=0, le=0.2),
        describe_setting(
            "How rough the rough place is",
            "By how much a point may be off where the rough place has it (standard deviation).",
            "doubt",
            unit="m",
        ),
    ] = 0.020
    limits: Annotated[FrameLimits, OWN_LIMITS] = ALIGNMENT_LIMITS
    bases: Annotated[
        FrameLimits | None,
        describe_setting(
            "Limits of the other robot's base",
            "The series goes on until another robot's base, seen through the fixture, is known so well.",
            "limits",
        ),
    ] = None
    mouth_at_m: Annotated[Triple | None, MOUTH_AT] = None
    rules: Annotated[SurveyRules, RULES] = field(default_factory=SurveyRules)
    write_anyway: Annotated[WriteAnyway, WRITE_ANYWAY] = ""


_RESULT: TypeAdapter[AlignmentResult] = TypeAdapter(AlignmentResult)


async def fixture_alignment(run: Run, spec: FixtureAlignment) -> AlignmentResult:
    """Find a fixture in the robot's base from wire lengths to its alignment points."""
    await run.ensure("the hook's adaptor is on", ask_confirmation, HOOK_WIRE)
    state = await run.step("read the robot", read_survey_state)
    known_wire = await run.step("read the alignments", read_known_wire, spec.fixture)
    if state.epoch is not None:
        await run.ensure("the robot kept its position", check_same_epoch, state.epoch)

    plan = await run.solve("plan the poses", plan_alignment, state, spec, known_wire)
    await run.step(
        "accept the plan", ask_acceptance, _plan_instruction(plan, spec), sha256_of(to_jsonable_python(plan))
    )

    survey = Survey(state, plan, spec.rules)
    measured = await measure_spots(run, survey)

    result = await run.solve("place the fixture", place_fixture, survey, spec, measured.captures, known_wire)
    result = replace(result, set_aside=measured.set_aside)
    raise_first((wrong_shape_error(result), uncertain_error(result, spec.bases)), spec.write_anyway)
    verdict = judge_alignment(result, spec.bases, spec.rules)
    refuse_failed(verdict, spec.write_anyway, result)
    shown = with_verdict(
        alignment_instruction(result), verdict, "Keep it as the robot's alignment?", spec.write_anyway
    )
    await run.step(
        "accept the result", ask_acceptance, shown, sha256_of(to_jsonable_python(result.alignment))
    )
    return result


def plan_alignment(
    state: SurveyState, spec: FixtureAlignment, known_wire: KnownWire = NOTHING_KNOWN
) -> SurveyPlan:
    """Plan spots and the poses to choose from; refuse what cannot succeed before anything moves."""
    refuse_bad_points(spec.points_in_fixture_m)
    rough, at, room = spec.rough_base_fixture, state.gauge_setup, spec.rules.room
    points = [
        rough.rotation_matrix() @ np.array(p) + np.array(rough.position_m) for p in spec.points_in_fixture_m
    ]
    exits = (
        WirePlace(at.anchor_in_base_m, at.sigma_anchor_m),
        *(_fixture_point(p, spec.rough_sigma_m) for p in points),
    )
    hooks = (WirePlace(at.hook_in_flange_m, at.sigma_hook_m),)
    wires: tuple[Wire, ...] = tuple((e.at_m, at.hook_in_flange_m, state.gauge_range_m) for e in exits[1:])
    mouth = spec.mouth_at_m or middle_of_work(state.model, wires, room, spec.rules.seed)
    spots = tuple(
        WireSpot(k, 0, True, _mount_instruction(k, mouth, spec.fixture))
        for k in range(1, len(spec.points_in_fixture_m) + 1)
    )
    frame_limits = spec.limits if spec.bases is None else spec.bases
    share = 1.0 if spec.bases is None else _SHARED_WIRE
    goal = SurveyGoal(
        rough,
        spec.points_in_fixture_m,
        share * frame_limits.origin_m,
        share * frame_limits.angle_rad,
        None if spec.bases is None else known_wire.worst_covariance(spec.points_in_fixture_m),
    )
    layout = SpotLayout(goal, exits, hooks, spots, wires, mouth, turns_mouth=True)
    return plan_survey(state, spec.rules, layout)


def place_fixture(
    survey: Survey, spec: FixtureAlignment, captures: Captures, known_wire: KnownWire = NOTHING_KNOWN
) -> AlignmentResult:
    """Fit the fixture to its points with all that the lengths say, and compare the effort with a fixed plan."""
    network, placed = fit_fixture(survey, spec, captures)
    spots = survey.list_places()
    alignment = Alignment(
        fixture=spec.fixture,
        robot_serial=survey.state.serial,
        model=survey.state.model,
        points_in_fixture_m=spec.points_in_fixture_m,
        base_fixture=placed.outer_inner,
        covariance=placed.covariance,
        counts_at_zero=survey.state.counts_at_zero,
        points=wire_points(survey, network, known_wire.wire),
    )
    covariance = network.exit_covariance(spots)
    reached = goal_uncertainties(survey.plan.goal, covariance, spec.rules.point_sigma_m)
    fixed = fixed_plan_captures(survey, network.disturbance_factor, reached)
    base = None if spec.bases is None else predict_base(alignment, known_wire)
    return AlignmentResult(alignment, placed, network, sum(map(len, captures)), fixed, spec.limits, base)


def fit_fixture(
    survey: Survey, spec: FixtureAlignment, captures: Captures
) -> tuple[WireNetwork, PlacedPoints]:
    """Fit the points to the lengths, and the fixture to its points."""
    network, spots = fit_survey(survey, captures), survey.list_places()
    found, covariance = [network.exits_m[k] for k in spots], network.exit_covariance(spots)
    sigma_m = spec.rules.point_sigma_m
    return network, place_points(spec.points_in_fixture_m, found, covariance, sigma_point_m=sigma_m)


def _fixture_point(point: np.ndarray, sigma_m: float) -> WirePlace:
    x, y, z = (float(v) for v in point)
    return WirePlace((x, y, z), sigma_m)


def _mount_instruction(point: int, mouth_at_m: Triple, fixture: str) -> Instruction:
    x, y, z = (round(value * 1e3) for value in mouth_at_m)
    return Instruction(
        f"mount_wire_{point}",
        make_message(
            "Fix the wire's base adaptor on alignment point {point} of {fixture}, its mouth towards "
            "x {x}, y {y}, z {z} mm from the base, and hook the wire in. Nothing may touch it; the "
            "robot moves next.",
            point=point,
            fixture=fixture,
            x=x,
            y=y,
            z=z,
        ),
    )


def _plan_instruction(plan: SurveyPlan, spec: FixtureAlignment) -> Instruction:
    rules, spots = spec.rules, len(plan.spots)
    what = make_message(
        "the robot, at each of {spots} alignment points, to {min_captures} to {max_captures} of "
        "{map} poses, one chosen after the other",
        spots=spots,
        min_captures=rules.min_captures,
        max_captures=rules.max_captures,
        map=min(map(len, plan.pools)),
    )
    return survey_plan_page(plan, rules, what, "move the wire from point to point")


def _outline_phases(spec: FixtureAlignment) -> tuple[Phase, ...]:
    points = len(spec.points_in_fixture_m)
    expected = points * max(spec.rules.min_captures, min(20, spec.rules.max_captures))
    return (
        *(Phase("read the robot"), Phase("read the alignments")),
        *(Phase("plan the poses"), Phase("accept the plan")),
        Phase("go to rest", points),
        Phase("move the wire", points),
        *(Phase(name, expected, adaptive=True) for name in EACH_CAPTURE),
        *(Phase("look at the lengths", points, adaptive=True), Phase("place the fixture")),
        Phase("accept the result"),
    )


def _results_to_store(spec: FixtureAlignment, result: AlignmentResult) -> StoredResult:
    return StoredResult("alignment", spec.fixture, result.alignment)


def _make_verdict(spec: FixtureAlignment, result: AlignmentResult) -> ProcedureVerdict:
    return with_order_remark(judge_alignment(result, spec.bases, spec.rules), spec.write_anyway)


def _forecast_run(spec: FixtureAlignment, knowledge: Knowledge) -> Forecast:
    return survey_forecast(lambda state: plan_alignment(state, spec), spec.rules, "fixture's", knowledge)


def _make_refit(spec: FixtureAlignment, findings: Sequence[Finding]) -> Refit:
    found = values_of(findings)
    survey, recorded = survey_of(found, spec.rules), _RESULT.validate_python(found["place the fixture"])

    def solve_again(captures: Captures) -> tuple[RefitResult, WireNetwork]:
        network, placed = fit_fixture(survey, spec, captures)
        values = pose_values(placed.outer_inner, recorded.alignment.base_fixture)
        return RefitResult((), placed.origin_u_m, values), network

    return refit_lengths(survey, findings, solve_again)


DEFINITION = ProcedureDefinition(
    name="fixture_alignment",
    title="Fixture alignment with the draw-wire",
    version=5,
    procedure=fixture_alignment,
    spec_type=FixtureAlignment,
    needs=("moves_joints", "tells_flange_pose", "gauge", "gauge_setup", "model"),
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
    refit=_make_refit,
)
