"""The accuracy check: five poses in a cube, gone round several times, following ISO 9283.

With a tracker pose accuracy and repeatability; with a draw-wire the same along the wire only, and titled so. Both
are said of the nominal model and of the identified one, from the same readings. Where the device stands is found at
other poses, which take no part in the test.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic_core import to_jsonable_python

from cellcal.calibration.accuracy import (
    FULL_POSES,
    AccuracyConditions,
    AccuracyTest,
    AttainedPoses,
    PoseResult,
    evaluate_accuracy,
)
from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.identification.parameters import ArmState
from cellcal.calibration.line_accuracy import LinePose, LineTest, evaluate_lengths
from cellcal.calibration.message import make_message
from cellcal.calibration.poses.arm_fit import fit_placement, predicted_sigma
from cellcal.calibration.poses.calibrated_arm import CalibratedArm
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.accuracy_limits import POSE, AccuracyClass, PoseLimits, limits_in_force, limits_text
from cellcal.procedures.arm.arm_bench import (
    READY,
    ArmCapture,
    Bench,
    Method,
    Triple,
    check_same_robot,
    declared_bench,
    joints_of,
    observations_of,
    read_bench,
    values_of,
)
from cellcal.procedures.arm.arm_series import ArmVisits
from cellcal.procedures.arm.cube_plan import CubePlan, plan_cube
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.cell import Cell
from cellcal.procedures.forecast import ANSWER_S, SAMPLE_S, Forecast, Knowledge, PlannedPose, Prediction
from cellcal.procedures.motion.plan_words import PlanTour, plan_words
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.run import Run
from cellcal.procedures.setting_texts import (
    ACCURACY_CLASS,
    CANDIDATES,
    INSTRUMENT,
    OWN_LIMITS,
    ROOM,
    RULES,
    SAMPLES,
    SEED,
    describe_setting,
)
from cellcal.procedures.steps.pages import ARM_CHECKS, WIRE_CHECKS, PlannedMoves, plan_page, straight_ways
from cellcal.procedures.verdict import ProcedureVerdict, ValueChange, judge_value, state_figure

SYSTEMATIC_SHARE = 0.5  # of a wire's sigma, that averaging does not take away


@dataclass(frozen=True, slots=True)
class CheckRules:
    """The place of the cube, how often it is gone round, the care of each pose, and the limits of motion."""

    cycles: Annotated[
        int,
        Field(ge=2, le=100),
        describe_setting(
            "Rounds of the cube", "How often the poses of the test cube are gone round.", "effort", unit="1"
        ),
    ] = 5
    centre_m: Annotated[
        Triple | None,
        describe_setting(
            "Middle of the test cube",
            "In the robot's base; empty: the middle of the work.",
            "place",
            unit="m",
            drawing="cube",
        ),
    ] = None
    side_m: Annotated[
        float,
        Field(ge=0.05, le=2),
        describe_setting("Edge of the test cube", "Length of one edge.", "place", unit="m", drawing="cube"),
    ] = 0.4
    placing: Annotated[
        int,
        Field(ge=10, le=100),
        describe_setting(
            "Poses to place the instrument",
            "They tell where the instrument stands and are no part of the test.",
            "effort",
            unit="1",
        ),
    ] = 14
    candidates: Annotated[int, Field(ge=32, le=1000), CANDIDATES] = 150
    samples: Annotated[int, Field(ge=1, le=1000), SAMPLES] = 3
    load_share: Annotated[
        float,
        Field(ge=0, le=1),
        describe_setting(
            "Load, share of the rated load",
            "What is mounted, from 0 to 1; it stands on the certificate.",
            "effort",
            unit="1",
        ),
    ] = 0.0
    warmed_up: Annotated[
        bool, describe_setting("The robot is warm", "It has worked for as long as its maker says.", "effort")
    ] = False
    seed: Annotated[int, Field(ge=0), SEED] = 1
    room: Annotated[MotionBounds, ROOM] = field(default_factory=MotionBounds)


@dataclass(frozen=True, slots=True)
class AccuracyCheck:
    """With what to measure, and what the robot must keep."""

    method: Annotated[Method, INSTRUMENT] = "tracker"
    accuracy_class: Annotated[AccuracyClass, ACCURACY_CLASS] = "B"
    limits: Annotated[PoseLimits | None, OWN_LIMITS] = None
    rules: Annotated[CheckRules, RULES] = field(default_factory=CheckRules)


@dataclass(frozen=True, slots=True)
class AccuracyResult:
    """The test by the nominal model, and by the identified one where there is one."""

    title: str
    nominal: AccuracyTest | LineTest
    identified: AccuracyTest | LineTest | None
    speed_share: float

    @property
    def test_in_force(self) -> AccuracyTest | LineTest:
        """The test of the model that programs should be compensated with."""
        return self.nominal if self.identified is None else self.identified


async def accuracy_check(run: Run, spec: AccuracyCheck) -> AccuracyResult:
    """Measure pose accuracy and repeatability."""
    await run.ensure("the device is ready", ask_confirmation, READY[spec.method])
    bench = await run.step("read the robot", read_bench, spec.method)
    await run.ensure("the robot kept its position", check_same_robot, bench.epoch)
    arm = await run.step("look up the parameters", parameters_in_force, bench)

    rules = spec.rules
    plan = await run.solve("plan the poses", plan_cube, bench, rules)
    await run.step(
        "accept the plan", ask_acceptance, _plan_instruction(plan, spec), sha256_of(to_jsonable_python(plan))
    )
    visits = ArmVisits(run, bench, plan.pace, rules.samples, bench.joints_rad)
    await visits.go_to_rest(plan.way_to_rest_rad)
    for way in plan.placing_rad:
        await visits.visit_pose(way)
    cycles = []
    for cycle in range(rules.cycles):
        ways = plan.first_round_rad if cycle == 0 else plan.round_rad
        start = 1 + cycle * FULL_POSES
        cycles.append(tuple([await visits.check_pose("test", start + k, way) for k, way in enumerate(ways)]))
    captures = CubeCaptures(visits.valid_captures(), tuple(cycles))
    return await run.solve("evaluate the test", evaluate_rounds, bench, plan, captures, arm, rules)


async def parameters_in_force(cell: Cell, bench: Bench) -> CalibratedArm | None:
    """Return the parameters of this robot that hold for its present mastering; None where there are none."""
    arm = cell.calibrated
    if arm is None or (arm.robot_serial, arm.model, arm.counts_at_zero) != (
        bench.serial, bench.model, bench.counts_at_zero
    ):  # fmt: skip
        return None
    return arm


@dataclass(frozen=True, slots=True)
class CubeCaptures:
    """Captures that place the device, then those of every cycle, five each."""

    placing: tuple[ArmCapture, ...]
    cycles: tuple[tuple[ArmCapture, ...], ...]


def evaluate_rounds(
    bench: Bench, plan: CubePlan, captures: CubeCaptures, arm: CalibratedArm | None, rules: CheckRules
) -> AccuracyResult:
    """Say of both models how far from them the robot went, and how well it came back."""
    rated_rad_s, once = float(np.min(bench.nominal_model().max_speed_rad_s)), plan.round_motion()
    share = min(once.travel_rad / once.moving_s / rated_rad_s, 1.0)
    conditions = AccuracyConditions(rules.load_share, share, rules.warmed_up, one_direction=True)
    nominal = _test_model(bench, plan, captures, {}, conditions)
    if arm is None:
        return AccuracyResult(nominal.title, nominal, None, share)
    return AccuracyResult(
        nominal.title, nominal, _test_model(bench, plan, captures, arm.parameter_values(), conditions), share
    )


def _test_model(
    bench: Bench,
    plan: CubePlan,
    captures: CubeCaptures,
    values: dict[str, float],
    conditions: AccuracyConditions,
) -> AccuracyTest | LineTest:
    task, axes = bench.make_task(), len(bench.joints_rad)
    fit = fit_placement(task, observations_of(task, captures.placing), values)
    state = fit.state
    joints, fitted = np.array(plan.tests_rad), joints_of(captures.placing, axes)
    found = np.array([values_of(cycle) for cycle in captures.cycles]).swapaxes(0, 1)  # (P, cycles, channels)
    device = state.devices[0]
    places = _target_positions(state, joints)
    if bench.method == "wire":
        expected = device.zero_m + device.scale * np.linalg.norm(places - device.anchor_in_base_m, axis=1)
        systematic = np.hypot(SYSTEMATIC_SHARE * bench.sigma_m, predicted_sigma(fit, task, joints))
        return evaluate_lengths(
            expected, found[:, :, 0], joints, device_sigma_m=systematic, fitted_joints_rad=fitted
        )
    base_device = inverse_transform(device.device_base)
    positions = found @ base_device[:3, :3].T + base_device[:3, 3]
    sigma_m = float(np.hypot(bench.sigma_m, predicted_sigma(fit, task, joints).max()))
    attained = AttainedPoses(places, positions, joints, device_sigma_m=sigma_m)
    return evaluate_accuracy(attained, conditions, fitted_joints_rad=fitted)


def _target_positions(state: ArmState, joints_rad: Array) -> Array:
    """Return where a model says the target is, in the base (P, 3) [m]."""
    values = term_values(state.nominal, joints_rad, state.terms)
    flanges = state.arm_model.base_flange(state.moved_joints(joints_rad, values))
    return np.asarray((flanges @ state.flange_tool)[:, :3, 3])


def _plan_instruction(plan: CubePlan, spec: AccuracyCheck) -> Instruction:
    x, y, z = (v * 1e3 for v in plan.centre_m)
    what = make_message(
        "the robot, to {placing_rad_count} poses that tell where the device is, then {cycles} "
        "times round five poses in a cube of {side_mm:.0f} mm about x {x:.0f}, y {y:.0f}, z "
        "{z:.0f} mm",
        placing_rad_count=len(plan.placing_rad),
        cycles=spec.rules.cycles,
        side_mm=plan.side_m * 1000.0,
        x=x,
        y=y,
        z=z,
    )
    stops = len(plan.placing_rad) + spec.rules.cycles * len(plan.tests_rad)
    tour = PlanTour(stops, plan.total_motion(spec.rules.cycles))
    instruction = Instruction("accept_plan", plan_words(what, tour, plan.not_checked))
    ways = (*plan.placing_rad, *straight_ways(plan.tests_rad))
    names = (
        *(str(k) for k in range(1, len(plan.placing_rad) + 1)),
        *(f"P{k}" for k in range(1, len(plan.tests_rad) + 1)),
    )
    checks = WIRE_CHECKS if spec.method == "wire" else ARM_CHECKS
    return plan_page(
        instruction, tour, PlannedMoves(ways, tour.paced.fastest_rad_s, checks, plan.not_checked, names=names)
    )


def _outline_phases(spec: AccuracyCheck) -> tuple[Phase, ...]:
    tests = FULL_POSES * spec.rules.cycles
    return (
        *(Phase("read the robot"), Phase("look up the parameters"), Phase("plan the poses")),
        *(
            Phase("accept the plan"),
            Phase("go to rest"),
            Phase("go to pose", spec.rules.placing, adaptive=True),
        ),
        *(Phase("capture", spec.rules.placing, adaptive=True), Phase("go to test", tests)),
        *(Phase("capture test", tests), Phase("evaluate the test")),
    )


def _results_to_store(spec: AccuracyCheck, result: AccuracyResult) -> StoredResult:
    return StoredResult("accuracy_test", spec.method, result)


def _make_verdict(spec: AccuracyCheck, result: AccuracyResult) -> ProcedureVerdict:
    limits = limits_in_force(POSE, spec.accuracy_class, spec.limits)
    test, along = result.test_in_force, "" if spec.method == "tracker" else " along the wire"
    poses: tuple[PoseResult | LinePose, ...] = test.poses
    worst, widest = max(poses, key=lambda pose: pose.ap_m), max(poses, key=lambda pose: pose.rp_m)
    changes: tuple[ValueChange, ...] = ()
    if result.identified is not None:
        changes = (
            ValueChange(
                make_message("largest error{along}", along=along),
                result.nominal.ap_m,
                result.identified.ap_m,
                "m",
            ),
        )
    departures = test.departures if isinstance(test, AccuracyTest) else ()
    model = "nominal" if result.identified is None else "identified"
    return ProcedureVerdict(
        (
            judge_value(
                make_message("AP{along}, worst pose, {model} model", along=along, model=model),
                worst.ap_m,
                "m",
                u=worst.ap_sigma_m,
                limit=limits.ap_m,
            ),
            judge_value(
                make_message("RP{along}, worst pose", along=along),
                widest.rp_m,
                "m",
                u=widest.rp_sigma_m,
                limit=limits.rp_m,
            ),
            state_figure("share of the rated speed", result.speed_share, "1"),
        ),
        limits_from=limits_text(spec.accuracy_class, spec.limits),
        not_verified=(
            *(make_message("departs from the full test: {words}", words=words) for words in departures),
            "The attitude differs from pose to pose: each is taken from the nearest free posture.",
            "Base and target were placed by this model at other poses: a robot that stands elsewhere does not show.",
        ),
        remarks=(result.title, "Poses and cycles are fixed by ISO 9283: nothing to save."),
        changes=changes,
    )


def _forecast_run(spec: AccuracyCheck, knowledge: Knowledge) -> Forecast:
    bench = declared_bench(knowledge, spec.method)
    if bench is None:
        return Forecast(
            0.0, lacks=(make_message("a kinematic model, and where the {method} is", method=spec.method),)
        )
    plan, rules = plan_cube(bench, spec.rules), spec.rules
    captures, paced = rules.placing + FULL_POSES * rules.cycles, plan.total_motion(rules.cycles)
    each_s = knowledge.limits.settle_s + rules.samples * SAMPLE_S
    return Forecast(
        duration_s=math.ceil(paced.moving_s + captures * each_s + ANSWER_S),
        poses=tuple(PlannedPose(f"P{k}", pose) for k, pose in enumerate(plan.tests_rad, 1)),
        speed_rad_s=paced.fastest_rad_s,
        predictions=(_device_prediction(bench),),
        assumed=("the robot's own scatter is what is measured: its part of U is known afterwards",),
        not_checked=plan.not_checked,
    )


def _device_prediction(bench: Bench) -> Prediction:
    """Return the part of U that no number of cycles takes away."""
    along, share = ("", 1.0) if bench.method == "tracker" else (" along the wire", SYSTEMATIC_SHARE)
    expanded = 2.0 * share * bench.sigma_m
    sentence = make_message(
        "{expanded:.3f} mm (k=2) by the {method} alone; the robot's scatter adds to it.",
        expanded=expanded * 1000.0,
        method=bench.method,
    )
    classes = {name: limits.ap_m for name, limits in POSE.items()}
    return Prediction(
        make_message("AP{along}, by the {method} alone", along=along, method=bench.method),
        expanded,
        "m",
        classes,
        sentence,
    )


DEFINITION = ProcedureDefinition(
    name="accuracy_check",
    title="Accuracy and repeatability following ISO 9283",
    version=3,
    procedure=accuracy_check,
    spec_type=AccuracyCheck,
    needs=("moves_joints", "tells_flange_pose", "model", "sees_the_flange"),
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
)
