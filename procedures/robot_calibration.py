"""The calibration of a robot: its own geometry, zeros and sag, from a draw-wire or a tracker that sees its flange.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, sections 2 and 3.1.
Poses are chosen one small batch after the other for what is still unknown; the series ends when the target is known
well enough over the work, or when it is shown that it cannot be. Poses that are never fitted verify the result.
"""

import math
from dataclasses import replace

from pydantic_core import to_jsonable_python

from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Joints, MasteringData
from cellcal.procedures.accuracy_limits import CHECK, limits_in_force
from cellcal.procedures.arm.arm_bench import (
    READY,
    ArmCapture,
    Bench,
    check_same_robot,
    declared_bench,
    of_target,
    read_bench,
)
from cellcal.procedures.arm.arm_motion import MotionSpace, ordered_ways
from cellcal.procedures.arm.arm_pages import (
    planned_steps,
    series_steps,
    tool_predictions,
    tool_ways,
    zero_changes,
    zero_displacement,
)
from cellcal.procedures.arm.arm_series import ArmVisits
from cellcal.procedures.arm.calibration_plan import (
    CalibrationSeries,
    PoseChoice,
    SeriesProgress,
    choose_poses,
    plan_series,
)
from cellcal.procedures.arm.calibration_questions import (
    plan_instruction,
    result_instruction,
    zeros_instruction,
)
from cellcal.procedures.arm.calibration_result import (
    ArmIdentification,
    arm_after_mastering,
    errors_after,
    identify_arm,
)
from cellcal.procedures.arm.calibration_spec import CalibrationResult, RobotCalibration
from cellcal.procedures.arm.calibration_verdict import verdict_on_calibration
from cellcal.procedures.arm.tool_series import measure_points
from cellcal.procedures.arm.tool_write import (
    ToolOrder,
    not_written_reason,
    write_tool,
)
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.forecast import ANSWER_S, SAMPLE_S, Forecast, Knowledge, PlannedPose, Prediction
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.run import NeedsUnmetError, RefusalError, Run
from cellcal.procedures.steps.pages import with_changes
from cellcal.procedures.steps.write import (
    check_still_in_force,
    read_tool_frame,
    restore_mastering,
    write_mastering,
)
from cellcal.procedures.verdict import (
    FAIL,
)
from cellcal.procedures.write_review import refuse_failed, with_verdict

FINAL_POSES = 3


async def robot_calibration(run: Run, spec: RobotCalibration) -> CalibrationResult:
    """Identify a robot's parameters with as few poses as it takes, and verify them."""
    await run.ensure("the device is ready", ask_confirmation, READY[spec.method])
    bench = await run.step("read the robot", read_bench, spec.method)
    order = await _read_tool_order(run, spec)
    await run.ensure("the robot kept its position", check_same_robot, bench.epoch)

    plan = await run.solve("plan the poses", plan_series, bench, spec.series_goal(), spec.rules)
    await run.step(
        "accept the plan", ask_acceptance, plan_instruction(plan, spec), sha256_of(to_jsonable_python(plan))
    )

    series = CalibrationSeries(bench, plan, spec.rules)
    visits = ArmVisits(run, bench, plan.pace, spec.rules.samples, bench.joints_rad)
    await visits.go_to_rest(plan.way_to_rest_rad)
    ended, of_points = await _measure_series(run, series, visits)
    checks = (*await _verify_arm(run, series, visits), *of_points)
    moved_m = await visits.check_device(_way_back(series, visits))

    identified = await run.solve("identify the arm", identify_arm, series, visits.valid_captures(), checks)
    result = CalibrationResult(
        identified,
        identified.arm,
        ended.enough,
        ended.why_not,
        visits.list_unused(identified.rejected),
        bench,
        moved_m=moved_m,
    )
    shown = with_verdict(
        result_instruction(result), verdict_on_calibration(spec, result), "Keep the parameters?"
    )
    await run.step("accept the result", ask_acceptance, shown, sha256_of(to_jsonable_python(identified)))
    if spec.write_zeros:
        result = await _write_zeros(run, spec, series, visits, result)
    return result if order is None else await _write_tool(run, spec, result, order)


async def _read_tool_order(run: Run, spec: RobotCalibration) -> ToolOrder | None:
    if spec.tool_number is None:
        return None
    before = await run.step("read the tool frame", read_tool_frame, spec.tool_number)
    return ToolOrder(spec.tool_number, before, spec.write_anyway)


async def _write_tool(
    run: Run, spec: RobotCalibration, result: CalibrationResult, order: ToolOrder
) -> CalibrationResult:
    """Write the tool frame where it is proved; else say in the result why it stays as it is: the arm is found."""
    found, verdict = result.identified.tool, verdict_on_calibration(spec, result)
    assert found is not None  # a number is refused without points
    why_not = not_written_reason(found, verdict, order)
    if why_not:
        return replace(result, tool_not_written=why_not)
    return replace(result, tool=await write_tool(run, found, verdict, order))


async def _measure_series(
    run: Run, series: CalibrationSeries, visits: ArmVisits
) -> tuple[PoseChoice, tuple[ArmCapture, ...]]:
    """Capture, look, choose; until it is enough, or shown not to be reachable. Return checks at points, too.

    The end-effector's points come after the first poses: what they tell is known when the others are chosen.
    """
    looks = 0
    coming: tuple[tuple[Joints, ...], ...] = ()
    checks: tuple[ArmCapture, ...] = ()
    while True:
        looks += 1
        standing = SeriesProgress(visits.valid_captures(), tuple(visits.retaken), visits.here_rad, coming)
        choice = await run.solve(f"choose poses {looks}", choose_poses, series, standing)
        if not choice.ways_rad:
            return choice, checks
        now = len(choice.ways_rad) if looks == 1 else 1  # before the first look nothing can be enough
        for way, again in zip(choice.ways_rad[:now], choice.again[:now], strict=True):
            await visits.visit_pose(way, again)
        coming = choice.ways_rad[now:] if choice.again[0] < 0 else ()
        if looks == 1 and series.plan.tool is not None:
            checks = await measure_points(run, series, visits)


async def _verify_arm(run: Run, series: CalibrationSeries, visits: ArmVisits) -> tuple[ArmCapture, ...]:
    """Capture at poses that no fit will see."""
    most_checks = series.rules.checks_for(len(of_target(visits.valid_captures(), 0)))
    ways = await run.solve("choose check poses", check_ways, series, visits.here_rad, most_checks)
    if len(ways) < min(most_checks, series.rules.checks):
        raise RefusalError(
            make_message(
                "only {way_count} of {most_checks} check poses can be reached: nothing would be verified",
                way_count=len(ways),
                most_checks=most_checks,
            ),
            code="procedure.unreachable",
            remedy="Widen the workspace box or allow more candidates; then start a new run.",
        )
    return tuple([await visits.check_pose("check", number, way) for number, way in enumerate(ways, 1)])


def check_ways(
    series: CalibrationSeries, here_rad: tuple[float, ...], most_checks: int
) -> tuple[tuple[tuple[float, ...], ...], ...]:
    """Return ways to poses that were put aside for verification, which lie far from each other."""
    reach, plan = series.motion_space(), series.plan
    return ordered_ways(reach, plan.roads, here_rad, plan.reserved[:most_checks])


def _way_back(series: CalibrationSeries, visits: ArmVisits) -> tuple[tuple[float, ...], ...]:
    """Return the way to the pose that was gone to first."""
    assert visits.first_rad is not None  # a series has captures before it is verified
    return ordered_ways(series.motion_space(), series.plan.roads, visits.here_rad, (visits.first_rad,))[0]


async def _write_zeros(
    run: Run, spec: RobotCalibration, series: CalibrationSeries, visits: ArmVisits, result: CalibrationResult
) -> CalibrationResult:
    """Write the joint zeros as mastering and look again; take them back where the robot is not where it should be."""
    found, bench = result.identified, series.bench
    _refuse_zeros(found, bench)
    verdict = verdict_on_calibration(spec, result)
    refuse_failed(verdict, None, result)
    question = "Write them as the robot's mastering? Taught positions move with them."
    shown = with_verdict(zeros_instruction(found), verdict, question, writes=True)
    shown = with_changes(shown, zero_changes(bench, found), **zero_displacement(bench, series.plan, found))
    await run.step("accept the zeros", ask_acceptance, shown, sha256_of(to_jsonable_python(found.mastering)))
    written = await run.write("write the mastering", write_mastering, found.mastering)
    await run.ensure("the written mastering is in force", check_still_in_force, found.mastering)
    ways = check_ways(series, visits.here_rad, FINAL_POSES)
    finals = tuple([await visits.check_pose("final", number, way) for number, way in enumerate(ways, 1)])
    rms_m = errors_after(series, visits.valid_captures(), found.written_offsets_rad, finals)
    limit_m = limits_in_force(CHECK, spec.accuracy_class, spec.limits).check_rms_m
    if not rms_m <= limit_m:
        old = MasteringData(bench.counts_at_zero, mastered=True)
        await run.write("restore the mastering", restore_mastering, old)
        raise RefusalError(
            make_message(
                "with the new zeros the readings are off by {rms_mm:.2f} mm RMS, {limit_mm:.2f} mm are "
                "allowed: the old mastering is back",
                rms_mm=rms_m * 1000.0,
                limit_mm=limit_m * 1000.0,
            ),
            code="procedure.not_verified",
            remedy="Use the parameter set of a run without write_zeros; look whether arm or device were touched.",
            evidence=result,
        )
    arm = arm_after_mastering(found.arm, found.written_offsets_rad, found.mastering)
    return replace(result, identified=found, arm=arm, written=written, final_rms_m=rms_m)


def _refuse_zeros(found: ArmIdentification, bench: Bench) -> None:
    if not found.mastering:
        raise NeedsUnmetError(
            "this robot's mastering cannot be written",
            missing=("access to encoder counts and mastering",),
            remedy="Use the parameter set: run again without write_zeros.",
        )
    if not found.hold_out.is_explained_by_offsets or not found.hold_out.is_as_predicted:
        raise RefusalError(
            make_message(
                "joint zeros alone leave {offsets_only_rms_mm:.2f} mm RMS at the check poses, the whole "
                "model {after_rms_mm:.2f} mm: writing them would hide what else is wrong",
                offsets_only_rms_mm=found.hold_out.offsets_only_rms_m * 1000.0,
                after_rms_mm=found.hold_out.after_rms_m * 1000.0,
            ),
            code="procedure.not_only_zeros",
            remedy="Nothing was written. Use the parameter set: run again without write_zeros.",
            evidence=found,
        )


def _outline_phases(spec: RobotCalibration) -> tuple[Phase, ...]:
    expected = max(spec.rules.min_captures, min(45, spec.rules.max_captures))  # until there is a plan
    steps = series_steps(spec.rules, expected, spec.rules.checks_for(expected))
    series = {name: Phase(name, times, adaptive=True) for name, times in steps.items()}
    writing = (
        *(
            Phase("accept the zeros"),
            Phase("write the mastering"),
            Phase("go to final", FINAL_POSES, adaptive=True),
        ),
        Phase("capture final", FINAL_POSES, adaptive=True),
    )
    writing_tool = (Phase("accept the tool", adaptive=True), Phase("write the tool frame", adaptive=True))
    return (
        *(
            Phase("read the robot"),
            *((Phase("read the tool frame"),) if spec.tool_number is not None else ()),
        ),
        *(Phase("plan the poses"), Phase("accept the plan"), Phase("go to rest")),
        *(series["choose poses"], series["go to pose"], series["capture"]),
        *(*_point_phases(spec), Phase("choose check poses")),
        *(series["go to check"], series["capture check"]),
        *(Phase("go to station", 1), Phase("capture station", 1)),
        *(Phase("identify the arm"), Phase("accept the result")),
        *(writing if spec.write_zeros else ()),
        *(writing_tool if spec.tool_number is not None else ()),
    )


def _point_phases(spec: RobotCalibration) -> tuple[Phase, ...]:
    points, rules = len(spec.points_in_tool_m), spec.rules
    if not points:
        return ()
    expected = points * max(rules.point_min, min(8, rules.point_max))
    checks = points * rules.point_checks
    return (
        *(Phase(name, points + 1) for name in ("find the way back", "go to change", "change the target")),
        *(Phase(name, expected, adaptive=True) for name in ("choose a point pose", "go to point pose")),
        *(Phase("capture point", expected, adaptive=True), Phase("choose point checks", points)),
        *(Phase(name, checks) for name in ("go to point check", "capture point check")),
    )


def _results_to_store(spec: RobotCalibration, result: CalibrationResult) -> tuple[StoredResult, ...]:
    tool = result.tool
    stored_tool = () if tool is None else (StoredResult("tool_frame", str(tool.tool_number), tool),)
    if verdict_on_calibration(spec, result).overall_decision is FAIL:
        return stored_tool
    return (StoredResult("parameter_set", result.arm.robot_serial, result.arm), *stored_tool)


def _forecast_run(spec: RobotCalibration, knowledge: Knowledge) -> Forecast:
    bench = declared_bench(knowledge, spec.method)
    if bench is None:
        return Forecast(
            0.0, lacks=(make_message("a kinematic model, and where the {method} is", method=spec.method),)
        )
    plan = plan_series(bench, spec.series_goal(), spec.rules)
    ends = [way[-1] for way in plan.foreseen_rad]
    poses, checks = ends[: plan.expected_captures], ends[plan.expected_captures :]
    stops = len(ends) + len(tool_ways(plan.tool))
    paced, each_s = plan.expected_motion(), knowledge.limits.settle_s + spec.rules.samples * SAMPLE_S
    after = make_message(
        "after {expected_captures} captures; each pose is chosen anew as readings come in",
        expected_captures=plan.expected_captures,
    )
    return Forecast(
        duration_s=math.ceil(paced.moving_s + stops * each_s + 3 * ANSWER_S),
        poses=(
            *(PlannedPose(f"pose {k}", pose) for k, pose in enumerate(poses, 1)),
            *(PlannedPose(f"check {k}", pose) for k, pose in enumerate(checks, 1)),
            *(PlannedPose(name, way[-1]) for name, way in tool_ways(plan.tool)),
        ),
        speed_rad_s=paced.fastest_rad_s,
        predictions=(
            Prediction("target over the work, RMS", plan.tip_u_m, "m", {}, after),
            *tool_predictions(plan.tool),
        ),
        assumed=(
            make_message(
                "the arm leaves {arm_sigma_mm:.2f} mm a coordinate that no parameter describes",
                arm_sigma_mm=spec.rules.arm_sigma_m * 1000.0,
            ),
            *((plan.shortfall,) if plan.shortfall else ()),
        ),
        not_checked=MotionSpace.from_bench(bench, spec.rules.room).not_checked(),
        planned=planned_steps(plan, spec.rules),
    )


DEFINITION = ProcedureDefinition(
    name="robot_calibration",
    title="Robot calibration with draw-wire or tracker",
    version=4,
    procedure=robot_calibration,
    spec_type=RobotCalibration,
    needs=("moves_joints", "tells_flange_pose", "model", "sees_the_flange"),
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=verdict_on_calibration,
    forecast=_forecast_run,
)
