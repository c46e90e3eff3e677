"""A user frame felt by a touch probe at a corner: three points of one face, two of the next, one of the third.

The rule and its source are in `calibration.points.three_two_one`. The robot moves by itself, slowly, and stops at
each contact; a frame is only written after touches that it was not found from have agreed with it.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated

from pydantic import Field
from pydantic_core import to_jsonable_python

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.points.three_two_one import FACES, LEAST, CornerFrame, FaceName
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.accuracy_limits import FRAME, AccuracyClass, FrameLimits, limits_in_force, limits_text
from cellcal.procedures.arm.arm_bench import ARM_SIGMA_M, check_same_robot
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.forecast import ANSWER_S, PERSON_S, Forecast, Knowledge, Prediction
from cellcal.procedures.motion.plan_words import PlanTour, plan_words
from cellcal.procedures.motion.speed_limit import TimedMotion
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.run import Run
from cellcal.procedures.setting_texts import (
    ACCURACY_CLASS,
    ARM_SIGMA,
    FRAME_NUMBER,
    OWN_LIMITS,
    WRITE_ANYWAY,
    describe_setting,
)
from cellcal.procedures.steps.pages import ARM_CHECKS, PlannedMoves, plan_page
from cellcal.procedures.steps.write import read_user_frame, write_user_frame
from cellcal.procedures.teaching.corner_places import CornerRules, first_spots
from cellcal.procedures.teaching.corner_plan import FacePlan, plan_spots
from cellcal.procedures.teaching.corner_touches import (
    CheckTouch,
    CornerGoal,
    CornerPrediction,
    CornerSetup,
    ProbedPoint,
    compare_checks,
    construct_corner,
    fewest_touches,
    predict_corner,
    predict_probed_corner,
    read_probe_bench,
    touch_checks,
    touch_corner,
    touch_sigma,
)
from cellcal.procedures.verdict import (
    Characteristic,
    Contribution,
    ProcedureVerdict,
    known_within,
    state_evidence,
    state_fact,
    state_figure,
)
from cellcal.procedures.write_review import (
    WriteAnyway,
    ask_to_write_user_frame,
    frame_changes,
    refuse_failed,
    with_order_remark,
)

CHECK_SIGMAS = 3.0
TRAVEL_S = 6.0  # from touch to touch
BETWEEN_S = 1.0  # to stop, to go back and to come to rest, at each contact

READY = Instruction(
    "probe_at_corner",
    "Mount the touch probe and clamp the workpiece. Bring the tip over the first face near the corner, 30 mm or "
    "more above it, the probe looking straight at that face: it stays in this attitude.",
)


@dataclass(frozen=True, slots=True)
class ProbedFrame:
    """Which user frame to write, where it is about, and how well it must be known."""

    frame_number: Annotated[int, Field(ge=0, le=99), FRAME_NUMBER]
    nominal: Annotated[
        Pose | None,
        describe_setting(
            "Where the corner is, roughly",
            "Corner and directions of the workpiece in the robot's base; empty: the user frame of the controller.",
            "place",
            unit="m",
            drawing="frame",
        ),
    ] = None
    touching: Annotated[
        CornerRules,
        describe_setting(
            "How the corner is felt", "Which corner, where it is felt and how slowly.", "effort"
        ),
    ] = field(default_factory=CornerRules)
    arm_sigma_m: Annotated[float, Field(ge=0, le=0.01), ARM_SIGMA] = 0.001
    accuracy_class: Annotated[AccuracyClass, ACCURACY_CLASS] = "B"
    limits: Annotated[FrameLimits | None, OWN_LIMITS] = None
    write_anyway: Annotated[WriteAnyway, WRITE_ANYWAY] = ""

    def corner_goal(self, tip_sigma_m: float) -> CornerGoal:
        """Return what the touches are for."""
        limits = limits_in_force(FRAME, self.accuracy_class, self.limits)
        return CornerGoal(limits.origin_m, limits.angle_rad, self.arm_sigma_m, tip_sigma_m)


@dataclass(frozen=True, slots=True)
class ProbedSetup:
    """The user frame as found, written and read back, and what it rests on."""

    frame_number: int
    found: CornerFrame
    before: Pose
    read_back: Pose
    goal: CornerGoal
    touch_sigma_m: float  # of one touch, along its normal
    points: tuple[ProbedPoint, ...]
    outlook: CornerPrediction  # after the last of them
    checks: tuple[CheckTouch, ...]


async def probed_frame(run: Run, spec: ProbedFrame) -> ProbedSetup:
    """Feel for the faces of a corner, solve for the user frame there, check it, and write it."""
    await run.ensure("the probe is mounted", ask_confirmation, READY)
    bench = await run.step("read the robot", read_probe_bench)
    await run.ensure("the robot kept its position", check_same_robot, bench.epoch)
    before = await run.step("read the user frame", read_user_frame, spec.frame_number)
    nominal, rules = before if spec.nominal is None else spec.nominal, spec.touching

    plan = await run.solve("plan the touches", plan_spots, bench, rules, nominal, (), first_spots())
    await run.step(
        "accept the plan", ask_acceptance, _plan_instruction(plan, rules), sha256_of(to_jsonable_python(plan))
    )
    corner = CornerSetup(bench, rules, spec.corner_goal(bench.tip_sigma_m), nominal)
    touches = await touch_corner(run, corner, plan)
    found = await run.solve("construct the frame", construct_corner, bench, rules, touches)
    checks = await touch_checks(run, corner, touches)
    setup = ProbedSetup(
        frame_number=spec.frame_number,
        found=found,
        before=before,
        read_back=found.base_frame,  # as it will be, if a person wants it
        goal=corner.goal,
        touch_sigma_m=touch_sigma(touches),
        points=tuple(map(ProbedPoint.from_touch, touches)),
        outlook=predict_probed_corner(corner, touches),
        checks=await run.solve("compare the check touches", compare_checks, bench, rules, found, checks),
    )
    verdict = _judge_result(spec, setup)
    refuse_failed(verdict, spec.write_anyway, found)
    base_user = found.base_frame
    result, sha256 = _result_instruction(spec, setup, verdict), sha256_of(to_jsonable_python(base_user))
    await run.step("accept the result", ask_acceptance, result, sha256)
    read_back = await run.write("write the user frame", write_user_frame, spec.frame_number, base_user)
    return replace(setup, read_back=read_back)


def _plan_instruction(plan: FacePlan, rules: CornerRules) -> Instruction:
    motion, fastest_rad_s = plan.motion, max(plan.motion.speeds_rad_s)
    what = make_message(
        "the robot with its touch probe, to {ways_rad_count} points of three faces and to at "
        "most {max_touches} more; at each it goes {search_way_m:.0f} mm towards the face at "
        "{search_speed_mm_s:.1f} mm/s and stops at the contact",
        ways_rad_count=len(plan.ways_rad),
        max_touches=rules.max_touches - len(plan.ways_rad) + len(FACES),
        search_way_m=rules.search_way_m * 2000.0,
        search_speed_mm_s=rules.search_speed_m_s * 1000.0,
    )
    moving_s = motion.moving_s + len(plan.ways_rad) * _feeling_s(rules)
    tour = PlanTour(len(plan.ways_rad), TimedMotion(motion.travel_rad, moving_s, fastest_rad_s))
    instruction = Instruction("accept_plan", plan_words(what, tour, motion.not_checked))
    names = tuple(f"{spot.face} {spot.number + 1}" for spot in first_spots())
    moves = PlannedMoves(
        ways_rad=tuple(way[1:] for way in plan.ways_rad),
        speed_rad_s=fastest_rad_s,
        checked=ARM_CHECKS,
        not_checked=motion.not_checked,
        most=rules.max_touches + len(FACES),
        names=names,
    )
    return plan_page(instruction, tour, moves)


def _result_instruction(spec: ProbedFrame, setup: ProbedSetup, verdict: ProcedureVerdict) -> Instruction:
    found = setup.found
    turn_u_rad = setup.goal.expanded_uncertainties(found.covariance_matrix())[1]
    return ask_to_write_user_frame(
        spec.frame_number, setup.before, found.base_frame, turn_u_rad, verdict, spec.write_anyway
    )


def _outline_phases(spec: ProbedFrame) -> tuple[Phase, ...]:
    counts = _expected_counts(spec)
    further = sum(counts.values()) - sum(LEAST.values())
    return (
        *(Phase("read the robot"), Phase("read the user frame"), Phase("plan the touches")),
        *(Phase("accept the plan"), Phase("touch the z face", counts["z"], adaptive=True)),
        *(Phase("plan the y face"), Phase("touch the y face", counts["y"], adaptive=True)),
        *(Phase("plan the x face"), Phase("touch the x face", counts["x"], adaptive=True)),
        *(Phase("plan a further touch", further, adaptive=True), Phase("construct the frame")),
        *(Phase("plan the check touches"), Phase("touch a check point", len(FACES))),
        *(Phase("compare the check touches"), Phase("accept the result"), Phase("write the user frame")),
    )


def _results_to_store(spec: ProbedFrame, result: ProbedSetup) -> StoredResult:
    return StoredResult("user_frame", str(spec.frame_number), result)


def _make_verdict(spec: ProbedFrame, result: ProbedSetup) -> ProcedureVerdict:
    verdict = with_order_remark(_judge_result(spec, result), spec.write_anyway)
    return replace(verdict, changes=frame_changes(result.before, result.read_back))


def _judge_result(spec: ProbedFrame, setup: ProbedSetup) -> ProcedureVerdict:
    limits, goal, found = limits_in_force(FRAME, spec.accuracy_class, spec.limits), setup.goal, setup.found
    origin_u, turn_u = (value / 2.0 for value in goal.expanded_uncertainties(found.covariance_matrix()))
    origin = known_within("origin of the frame", "m", u=origin_u, limit=limits.origin_m)
    turn = known_within("direction of the frame's axes", "rad", u=turn_u, limit=limits.angle_rad)
    spare = state_evidence(
        "coordinates beyond those that fix the frame",
        found.redundancy > 0,
        "PASS if there are points to compare, else UNDECIDED: allow one more touch (max_touches)",
        found=found.redundancy,
        limit=1,
    )
    return ProcedureVerdict(
        (
            origin.with_budget(
                Contribution(
                    "probe, skew of the times and scatter of the arm",
                    max(found.standard_uncertainties[:3]),
                    "measured",
                ),
                Contribution("the tip in the flange, tip_sigma_mm", goal.tip_sigma_m, "cell file"),
                Contribution("the arm's own errors, arm_sigma_m", goal.arm_sigma_m, "estimated"),
            ),
            turn.with_budget(
                Contribution(
                    "probe, skew of the times and scatter of the arm",
                    max(found.standard_uncertainties[3:]),
                    "measured",
                ),
                Contribution("the arm's own errors, arm_sigma_m", goal.arm_turn_rad, "estimated"),
            ),
            spare,
            *map(_check_figure, setup.checks),
            *(
                state_figure("the faces' departure from a right angle", angle, "rad")
                for angle in found.square_rad
            ),
        ),
        limits_from=limits_text(spec.accuracy_class, spec.limits),
        not_verified=(
            "The forms of the faces count only as they scatter.",
            "All touches were made in one attitude: what the tip in the flange is wrong by shifts the frame.",
        ),
        remarks=(_saving_text(setup, spec.touching.max_touches),),
    )


_CHECK_RULE = "PASS if the touch misses the frame by at most three deviations, else FAIL"
_CHECKS: dict[FaceName, str] = {
    "z": "check touch of the z face",
    "y": "check touch of the y face",
    "x": "check touch of the x face",
}


def _check_figure(check: CheckTouch) -> Characteristic:
    most = CHECK_SIGMAS * check.sigma_m
    holds = abs(check.miss_m) <= most
    return state_fact(_CHECKS[check.face], holds, _CHECK_RULE, found=abs(check.miss_m), limit=most, unit="m")


def _saving_text(setup: ProbedSetup, most: int) -> str:
    outlook, touches = setup.outlook, len(setup.points)
    if not outlook.reached:
        return make_message(
            "{touches} touches; further ones were not asked for: {most} would leave the origin "
            "within {origin_u_mm:.2f} mm and the axes within {angle_u_rad:.2f} mm per metre (k=2)",
            touches=touches,
            most=most,
            origin_u_mm=outlook.origin_u_m * 1000.0,
            angle_u_rad=outlook.angle_u_rad * 1000.0,
        )
    if touches >= outlook.in_turn:
        return make_message(
            "no saving: {touches} touches, as many as the three faces in turn would take", touches=touches
        )
    return make_message(
        "{touches} touches, each where it tells most; the three faces touched in turn would take "
        "{in_turn} for the U of the limits",
        touches=touches,
        in_turn=outlook.in_turn,
    )


def _expected_counts(spec: ProbedFrame, tip_sigma_m: float = 0.0) -> dict[FaceName, int]:
    """Return how many touches of each face are expected; out of reach, none is asked for beyond those that fix it."""
    outlook = predict_corner(
        spec.touching, spec.corner_goal(tip_sigma_m), ARM_SIGMA_M, fewest_touches(ARM_SIGMA_M)
    )
    again = outlook.again if outlook.reached else ()
    return {face: LEAST[face] + again.count(face) for face in FACES}


def _feeling_s(rules: CornerRules) -> float:
    """Return how long a touch takes with its repeats, about."""
    again_s = rules.retreat_m / rules.measure_speed_m_s + BETWEEN_S
    return rules.search_way_m / rules.search_speed_m_s + BETWEEN_S + rules.repeats * again_s


def _forecast_run(spec: ProbedFrame, knowledge: Knowledge) -> Forecast:
    tools, rules = knowledge.instruments, spec.touching
    goal, sigma_m = spec.corner_goal(tools.probe_tip_sigma_m), math.hypot(tools.probe_sigma_m, ARM_SIGMA_M)
    counts = _expected_counts(spec, tools.probe_tip_sigma_m)
    touches, made = sum(counts.values()), {face: (sigma_m,) * counts[face] for face in FACES}
    each = CornerGoal(math.inf, math.inf, goal.arm_sigma_m, goal.tip_sigma_m)
    after = predict_corner(replace(rules, max_touches=touches), each, sigma_m, made)
    origin = {name: limit.origin_m for name, limit in FRAME.items()}
    turn = {name: limit.angle_rad for name, limit in FRAME.items()}
    return Forecast(
        duration_s=PERSON_S + 2.0 * ANSWER_S + (touches + len(FACES)) * (TRAVEL_S + _feeling_s(rules)),
        predictions=(
            Prediction(
                make_message("origin of the frame, after {touches} touches", touches=touches),
                after.origin_u_m,
                "m",
                origin,
            ),
            Prediction(
                make_message("direction of the frame's axes, after {touches} touches", touches=touches),
                after.angle_u_rad,
                "rad",
                turn,
            ),
        ),
        assumed=(
            make_message(
                "the tip in the flange is known to {tip_sigma_mm:.2f} mm per coordinate (tip_sigma_mm)",
                tip_sigma_mm=goal.tip_sigma_m * 1000.0,
            ),
            make_message(
                "the arm's own errors shift the tip by {arm_sigma_mm:.2f} mm per coordinate (arm_sigma_m)",
                arm_sigma_mm=spec.arm_sigma_m * 1000.0,
            ),
        ),
        not_checked=("The ways are planned when the probe stands over the corner.",),
    )


DEFINITION = ProcedureDefinition(
    name="probed_frame",
    title="User frame from a corner felt by a touch probe",
    version=1,
    procedure=probed_frame,
    spec_type=ProbedFrame,
    needs=("moves_joints", "commanded", "model", "probe", "writes_user_frame"),
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
)
