"""The drift check, a few minutes on a schedule: whether a robot still is as it was when known to be healthy.

The first run takes the reference readings. Every later run measures at the same poses and tells warmth from a
knocked tool, a lost zero and a moved device, says how sure that is, and what to run next.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field
from pydantic_core import to_jsonable_python

from cellcal.calibration.drift.causes import DriftFinding
from cellcal.calibration.drift.reference import DriftReference
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.arm.arm_bench import (
    READY,
    ArmCapture,
    Bench,
    Method,
    captures_agree,
    check_same_robot,
    declared_bench,
    read_bench,
)
from cellcal.procedures.arm.arm_series import ArmVisits
from cellcal.procedures.arm.drift_findings import (
    DriftCaptures,
    DriftResult,
    look_for_changes,
    recommend_action,
    reference_of,
)
from cellcal.procedures.arm.drift_plan import (
    ASSUMED_DISTANCE_M,
    REPEAT_M,
    DriftPlan,
    DriftRules,
    noise_before_m,
    plan_check,
    plan_reference,
)
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.cell import Cell
from cellcal.procedures.forecast import ANSWER_S, SAMPLE_S, Forecast, Knowledge, PlannedPose, Prediction
from cellcal.procedures.motion.plan_words import PlanTour, plan_words
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.setting_texts import INSTRUMENT, RULES, describe_setting
from cellcal.procedures.steps.pages import ARM_CHECKS, WIRE_CHECKS, PlannedMoves, plan_page
from cellcal.procedures.verdict import (
    Characteristic,
    ProcedureVerdict,
    chance_rule,
    judge_value,
    state_evidence,
    state_fact,
    state_figure,
)


@dataclass(frozen=True, slots=True)
class DriftCheck:
    """With what to measure, and how much the readings may have changed."""

    method: Annotated[Method, INSTRUMENT] = "wire"
    limit_m: Annotated[
        float,
        Field(gt=0, le=0.1),
        describe_setting(
            "Change that is too much",
            "A reading that changed by more than this since the reference counts as drift.",
            "limits",
            unit="m",
            basic=True,
        ),
    ] = 0.0003
    renew: Annotated[
        bool,
        describe_setting(
            "Take a new reference", "Only of a robot that is known to be healthy.", "what", basic=True
        ),
    ] = False
    rules: Annotated[DriftRules, RULES] = field(default_factory=DriftRules)


async def drift_check(run: Run, spec: DriftCheck) -> DriftResult:
    """Compare the robot with its reference; where there is none, take it."""
    await run.ensure("the device is ready", ask_confirmation, READY[spec.method])
    bench = await run.step("read the robot", read_bench, spec.method)
    await run.ensure("the robot kept its position", check_same_robot, bench.epoch)
    reference = await run.step("look up the reference", stored_reference, bench.serial, spec.method)
    if reference is None or spec.renew:
        return await _take_reference(run, spec, bench)
    _refuse_other_robot(reference, bench)
    return await _compare_with_reference(run, spec, bench, reference)


async def stored_reference(cell: Cell, serial: str, method: Method) -> DriftReference | None:
    """Return the newest reference of this robot with this device; None where none was taken."""
    found = [one for one in cell.drift_references if (one.robot_serial, one.method) == (serial, method)]
    return found[-1] if found else None


async def _take_reference(run: Run, spec: DriftCheck, bench: Bench) -> DriftResult:
    """Measure at poses that tell the causes apart, twice: a reference must repeat."""
    plan = await run.solve("plan the poses", plan_reference, bench, spec.rules)
    await run.step(
        "accept the plan",
        ask_acceptance,
        _plan_instruction(plan, _TAKING, spec.method, rounds=2),
        sha256_of(to_jsonable_python(plan)),
    )
    visits = ArmVisits(run, bench, plan.pace, spec.rules.samples, bench.joints_rad)
    await visits.go_to_rest(plan.way_to_rest_rad)
    for way in plan.ways_rad:
        await visits.visit_pose(way)
    again = tuple([await visits.check_pose("again", k, way) for k, way in enumerate(plan.ways_rad, 1)])
    _refuse_scatter(visits.valid_captures(), again, bench)
    reference = reference_of(bench, plan.ways_rad, visits.valid_captures(), again)
    advice = "run drift_check on a schedule: it compares with this reference"
    every = tuple(range(len(plan.ways_rad)))
    return DriftResult(reference, True, None, every, reference.sigma_m(REPEAT_M), advice)


async def _compare_with_reference(
    run: Run, spec: DriftCheck, bench: Bench, reference: DriftReference
) -> DriftResult:
    """Measure at a few poses of the reference, and at more as long as they would decide."""
    plan = await run.solve("plan the poses", plan_check, bench, reference, spec.rules)
    await run.step(
        "accept the plan",
        ask_acceptance,
        _plan_instruction(plan, _COMPARING, spec.method),
        sha256_of(to_jsonable_python(plan)),
    )
    visits = ArmVisits(run, bench, plan.pace, spec.rules.samples, bench.joints_rad)
    await visits.go_to_rest(plan.way_to_rest_rad)
    first = min(spec.rules.first, len(reference.poses_rad))
    measured = list(range(first))
    for way in plan.ways_rad[:first]:
        await visits.visit_pose(way)
    while True:
        number = len(measured) - first + 1
        captures = DriftCaptures(reference, tuple(measured), visits.valid_captures())
        look = await run.solve(f"look for changes {number}", look_for_changes, bench, captures, spec.rules)
        if look.next_pose < 0:
            break
        measured.append(look.next_pose)
        await visits.visit_pose(plan.ways_rad[look.next_pose])
    advice = recommend_action(look.finding, spec.rules.probability)
    return DriftResult(reference, False, look, tuple(measured), captures.sigma_m(), advice)


def _refuse_other_robot(reference: DriftReference, bench: Bench) -> None:
    same = (reference.robot_serial, reference.model, reference.method) == (
        bench.serial,
        bench.model,
        bench.method,
    )
    if not same or reference.counts_at_zero != bench.counts_at_zero:
        what = "another mastering" if same else "another robot or device"
        raise RefusalError(
            make_message("the reference is of {what}: readings cannot be compared with it", what=what),
            code="procedure.reference_outdated",
            remedy="See that the robot is healthy, for example by accuracy_check; then take a new reference (renew).",
        )


def _refuse_scatter(first: tuple[ArmCapture, ...], again: tuple[ArmCapture, ...], bench: Bench) -> None:
    apart = [
        k + 1
        for k, (a, b) in enumerate(zip(first, again, strict=True))
        if not captures_agree(a, b, bench.sigma_m)
    ]
    if apart:
        raise RefusalError(
            make_message(
                "the two rounds differ at pose {map}: this is no reference", map=", ".join(map(str, apart))
            ),
            code="procedure.not_repeatable",
            remedy="Let the robot warm up, see that device and wire are firm and free; then start a new run.",
        )


_TAKING = "the robot, to up to {ways_rad_count} poses, to take the reference"
_COMPARING = "the robot, to up to {ways_rad_count} poses, to compare"


def _plan_instruction(plan: DriftPlan, what: str, method: Method, rounds: int = 1) -> Instruction:
    what_moves = make_message(what, ways_rad_count=len(plan.ways_rad))
    tour = PlanTour(rounds * len(plan.ways_rad), plan.total_motion().repeat_motion(rounds))
    instruction = Instruction("accept_plan", plan_words(what_moves, tour, plan.not_checked))
    checks = WIRE_CHECKS if method == "wire" else ARM_CHECKS
    each = ("go to pose", "capture", "go to again", "capture again") if rounds > 1 else ()
    moves = PlannedMoves(
        plan.ways_rad,
        tour.paced.fastest_rad_s,
        checks,
        plan.not_checked,
        planned=dict.fromkeys(each, len(plan.ways_rad)),
    )
    return plan_page(instruction, tour, moves)


def _outline_phases(spec: DriftCheck) -> tuple[Phase, ...]:
    poses, again = (spec.rules.poses, spec.rules.poses) if spec.renew else (spec.rules.first, 0)
    return (
        *(
            Phase("read the robot"),
            Phase("look up the reference"),
            Phase("plan the poses"),
            Phase("accept the plan"),
        ),
        *(Phase("go to rest"), Phase("go to pose", poses, adaptive=True)),
        *(Phase("capture", poses, adaptive=True), Phase("go to again", again, adaptive=True)),
        Phase("capture again", again, adaptive=True),
        Phase("look for changes", 0 if spec.renew else 1, adaptive=True),
    )


def _results_to_store(spec: DriftCheck, result: DriftResult) -> StoredResult | None:
    del spec
    if not result.taken_now:
        return None
    return StoredResult(
        "drift_reference", f"{result.reference.robot_serial} {result.reference.method}", result.reference
    )


def _make_verdict(spec: DriftCheck, result: DriftResult) -> ProcedureVerdict:
    message = (
        "A change that is the same at every pose of the reference, such as a turn about the first axis, may hide.",
    )
    if result.look is None:
        repeats = state_fact(
            "both rounds agree", True, "no pose differs by more than six deviations of the device"
        )
        sigma = state_figure("deviation of a reference reading", result.sigma_m, "m")
        return ProcedureVerdict(
            (repeats, sigma),
            limits_from="fixed limits of the procedure",
            not_verified=(
                "Whether the robot has drifted: this run took the reference that later ones compare with.",
            ),
            remarks=(result.saving_text,),
        )
    finding, share = result.look.finding, spec.rules.probability
    change = judge_value(
        "largest change of a reading", finding.change_max_m, "m", u=result.sigma_m, limit=spec.limit_m
    )
    figures: list[Characteristic] = [change, state_figure("RMS of the changes", finding.change_rms_m, "m")]
    if finding.has_changed:
        likely = finding.likeliest_cause
        rule = chance_rule(
            make_message("PASS if at least {share:g}, else UNDECIDED: measure at more poses", share=share)
        )
        figures.append(
            state_evidence(
                make_message("cause: {likely_name}", likely_name=likely.name),
                result.look.decided,
                rule,
                found=likely.probability,
                limit=share,
            )
        )
        figures.append(state_figure("left by that cause", likely.unexplained_m, "m"))
    return ProcedureVerdict(
        tuple(figures),
        limits_from="limits of the settings",
        not_verified=message,
        remarks=(
            make_message("Next: {recommended}.", recommended=result.recommended),
            _suspects_text(finding),
            result.saving_text,
        ),
    )


def _suspects_text(finding: DriftFinding) -> str:
    words = [
        make_message("{one_name} {probability:.1%}", one_name=one.name, probability=one.probability)
        for one in finding.suspects
        if one.probability >= 0.001
    ]
    return make_message("How probable: {words}.", words=", ".join(words))


def _forecast_run(spec: DriftCheck, knowledge: Knowledge) -> Forecast:
    bench = declared_bench(knowledge, spec.method)
    if bench is None:
        return Forecast(
            0.0, lacks=(make_message("a kinematic model, and where the {method} is", method=spec.method),)
        )
    of_this = [one for one in knowledge.drift_references if one.method == spec.method]
    reference = None if spec.renew or not of_this else of_this[-1]
    rules = spec.rules
    plan = plan_reference(bench, rules) if reference is None else plan_check(bench, reference, rules)
    poses, rounds = (len(plan.ways_rad), 2) if reference is None else (rules.first, 1)
    paced, each_s = plan.total_motion(poses), knowledge.limits.settle_s + rules.samples * SAMPLE_S
    moving_s = paced.repeat_motion(rounds).moving_s
    return Forecast(
        duration_s=math.ceil(moving_s + rounds * poses * each_s + ANSWER_S),
        poses=tuple(PlannedPose(f"pose {k}", way[-1]) for k, way in enumerate(plan.ways_rad, 1)),
        speed_rad_s=paced.fastest_rad_s,
        predictions=_predict_readings(spec, noise_before_m(knowledge, spec.method, rules.samples), reference),
        assumed=(
            *(
                (
                    make_message(
                        "the target is {assumed_distance_m:g} m from the tracker",
                        assumed_distance_m=ASSUMED_DISTANCE_M,
                    ),
                )
                if spec.method == "tracker"
                else ()
            ),
            make_message(
                "an arm of this class comes back to a pose within {repeat_m:.2f} mm a coordinate",
                repeat_m=REPEAT_M * 1000.0,
            ),
            "no reference was taken yet, or a new one is asked for: this run takes it, at all poses twice"
            if reference is None
            else "the newest reference is compared with",
        ),
        not_checked=plan.not_checked,
    )


def _predict_readings(
    spec: DriftCheck, reading_m: float, reference: DriftReference | None
) -> tuple[Prediction, ...]:
    """Return how well a reading of the reference, or a change since it, will be known: as the run states it."""
    taken_m = math.hypot(reading_m, REPEAT_M) / math.sqrt(2.0)  # of the mean of two rounds
    if reference is None:
        change_m = math.hypot(taken_m, reading_m, REPEAT_M)
        later = make_message(
            "a check against it would see changes to {change_m:.3f} mm (k=2)", change_m=2000.0 * change_m
        )
        return (Prediction("a reference reading", 2.0 * taken_m, "m", sentence=later),)
    change_m = math.hypot(reference.sigma_m(REPEAT_M), reading_m, REPEAT_M)
    words = make_message("a change of {limit_mm:.2f} mm fails (limit_m)", limit_mm=spec.limit_m * 1000.0)
    return (Prediction("change of a reading", 2.0 * change_m, "m", sentence=words),)


DEFINITION = ProcedureDefinition(
    name="drift_check",
    title="Drift check against the reference of a healthy robot",
    version=3,
    procedure=drift_check,
    spec_type=DriftCheck,
    needs=("moves_joints", "tells_flange_pose", "model", "sees_the_flange"),
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
)
