"""The end-effector's points, measured in between the poses of a calibration; hook or target changes in between.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.2.
"""

from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from cellcal.calibration.poses.arm_fit import with_readings
from cellcal.calibration.poses.measurement_prediction import MeasurementPrediction
from cellcal.calibration.poses.next_pose import choose_for_unknowns
from cellcal.drivers.interfaces import Instruction, Joints
from cellcal.procedures.arm.arm_bench import ArmCapture, of_target
from cellcal.procedures.arm.arm_motion import ordered_ways, way_between
from cellcal.procedures.arm.arm_series import ArmVisits
from cellcal.procedures.arm.calibration_plan import CalibrationSeries, SeriesProgress, predict_current
from cellcal.procedures.arm.tool_plan import ToolGoal, ToolPlan, place_rows, unmeasured_poses
from cellcal.procedures.questions import ask_confirmation
from cellcal.procedures.run import Run
from cellcal.procedures.steps.end_effector import BACK, point_instruction

Way = tuple[Joints, ...]


@dataclass(frozen=True, slots=True)
class PointChoice:
    """The way to the next pose of a point; empty where there is none, and whether that is because it is enough."""

    way_rad: Way
    enough: bool


async def measure_points(run: Run, series: CalibrationSeries, visits: ArmVisits) -> tuple[ArmCapture, ...]:
    """Measure every point until it is known well enough, and at poses that no fit will see; return the latter."""
    tool, goal = _tool_plan_and_goal(series)
    numbers = count(1)
    checks: list[ArmCapture] = []
    for point, plan in enumerate(tool.points, 1):
        instruction = point_instruction(series.bench.method, point, goal.points_in_tool_m[point - 1])
        await _change_target(run, series, visits, (point, instruction))
        while True:
            number = next(numbers)
            standing = SeriesProgress(visits.valid_captures(), (), visits.here_rad)
            choice = await run.solve(f"choose a point pose {number}", choose_point, series, standing, point)
            if not choice.way_rad:
                break
            await visits.visit_point(number, choice.way_rad)
        ways = await run.solve(f"choose point checks {point}", point_checks, series, visits.here_rad, point)
        for way in ways:
            checks.append(await visits.check_pose("point check", len(checks) + 1, way))
        assert len(ways) == len(plan.reserved)
    await _change_target(run, series, visits, (0, BACK[series.bench.method]))
    return tuple(checks)


async def _change_target(
    run: Run, series: CalibrationSeries, visits: ArmVisits, next_target: tuple[int, Instruction]
) -> None:
    """Go to rest and have hook or target put where it is wanted next; 0 is its place on the flange."""
    (target, instruction), (tool, _) = next_target, _tool_plan_and_goal(series)
    number = target or 1 + len(tool.points)
    way = await run.solve(
        f"find the way back {number}", way_to_change, series, visits.here_rad, visits.target
    )
    pace = tool.paces[target - 1] if target else series.plan.pace
    await visits.change_target(number, target, pace, way)
    await run.step(f"change the target {number}", ask_confirmation, instruction)


def way_to_change(series: CalibrationSeries, here_rad: Joints, target: int) -> Way:
    """Return the way to where hook or target can be changed."""
    rest_rad, plan = series.plan.way_to_rest_rad[-1], series.plan
    if not target:
        return way_between(series.motion_space(), plan.roads, here_rad, rest_rad)
    tool, goal = _tool_plan_and_goal(series)
    reach = series.motion_space().with_target(goal.points_m()[target - 1])
    return way_between(reach, tool.points[target - 1].roads, here_rad, rest_rad)


def choose_point(series: CalibrationSeries, standing: SeriesProgress, point: int) -> PointChoice:
    """Choose the pose that tells most about a point among those that are soon reached; or end its measuring."""
    (tool, goal), rules = _tool_plan_and_goal(series), series.rules
    taken = of_target(standing.captures, point)
    prediction = _predict_expected(series, standing)
    if goal.stop_rule(rules.point_min, point)(len(taken), prediction):
        return PointChoice((), True)
    plan, unmeasured = tool.points[point - 1], unmeasured_poses(tool.points[point - 1].pool, taken)
    if not len(unmeasured) or len(taken) >= rules.point_max:
        return PointChoice((), False)
    turn = choose_for_unknowns(
        prediction.of_target(point),
        unmeasured,
        place_rows(prediction, point),
        lambda *_: False,
        most=rules.batch,
    )
    poses = tuple(tuple(float(q) for q in unmeasured[k]) for k in turn.order)
    reach = series.motion_space().with_target(goal.points_m()[point - 1])
    return PointChoice(ordered_ways(reach, plan.roads, standing.here_rad, poses)[0], False)


def point_checks(series: CalibrationSeries, here_rad: Joints, point: int) -> tuple[Way, ...]:
    """Return ways to the poses of a point that were put aside for verification."""
    tool, goal = _tool_plan_and_goal(series)
    plan, reach = tool.points[point - 1], series.motion_space().with_target(goal.points_m()[point - 1])
    return ordered_ways(reach, plan.roads, here_rad, plan.reserved)


def _predict_expected(series: CalibrationSeries, standing: SeriesProgress) -> MeasurementPrediction:
    """Return what will be known once the flange's poses that are still to come are measured, as planned."""
    now, flange = predict_current(series, standing.captures), of_target(standing.captures, 0)
    coming = tuple(way[-1] for way in series.plan.foreseen_rad[: series.plan.expected_captures])
    remaining = unmeasured_poses(coming, flange)[: max(0, len(coming) - len(flange))]
    if not len(remaining):
        return now
    return replace(
        with_readings(now, remaining, np.zeros(len(remaining), dtype=np.intp)), observe=now.observe
    )


def _tool_plan_and_goal(series: CalibrationSeries) -> tuple[ToolPlan, ToolGoal]:
    tool, goal = series.plan.tool, series.plan.goal.tool
    assert tool is not None
    assert goal is not None  # such a series has both
    return tool, goal
