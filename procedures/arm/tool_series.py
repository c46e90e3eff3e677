"""The end-effector's points, measured in between the poses of a calibration; hook or target changes in between.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.2.
"""

from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from cellcal.calibration.poses.arm_fit import with_readings
from cellcal.calibration.poses.measurement_poses import Outlook
from cellcal.calibration.poses.next_pose import best_for
from cellcal.drivers.interfaces import Instruction, Joints
from cellcal.procedures.arm.arm_bench import ArmCapture, of_target
from cellcal.procedures.arm.arm_motion import ordered_ways, way_between
from cellcal.procedures.arm.arm_series import Visits
from cellcal.procedures.arm.calibration_plan import Series, Standing, known_so_far
from cellcal.procedures.arm.tool_plan import ToolGoal, ToolPlan, place_rows, unseen
from cellcal.procedures.questions import ask
from cellcal.procedures.run import Run
from cellcal.procedures.steps.end_effector import BACK, to_point

Way = tuple[Joints, ...]


@dataclass(frozen=True, slots=True)
class PointChoice:
    """The way to the next pose of a point; empty where there is none, and whether that is because it is enough."""

    way_rad: Way
    enough: bool


async def measure_points(run: Run, series: Series, visits: Visits) -> tuple[ArmCapture, ...]:
    """Measure every point until it is known well enough, and at poses that no fit will see; return the latter."""
    tool, goal = _sought(series)
    numbers = count(1)
    checks: list[ArmCapture] = []
    for point, plan in enumerate(tool.points, 1):
        asked = to_point(series.bench.method, point, goal.points_in_tool_m[point - 1])
        await _change(run, series, visits, (point, asked))
        while True:
            number = next(numbers)
            standing = Standing(visits.captures(), (), visits.here_rad)
            choice = await run.solve(f"choose a point pose {number}", choose_point, series, standing, point)
            if not choice.way_rad:
                break
            await visits.visit_point(number, choice.way_rad)
        ways = await run.solve(f"choose point checks {point}", point_checks, series, visits.here_rad, point)
        for way in ways:
            checks.append(await visits.check("point check", len(checks) + 1, way))
        assert len(ways) == len(plan.reserved)
    await _change(run, series, visits, (0, BACK[series.bench.method]))
    return tuple(checks)


async def _change(run: Run, series: Series, visits: Visits, wanted: tuple[int, Instruction]) -> None:
    """Go to rest and have hook or target put where it is wanted next; 0 is its place on the flange."""
    (target, asked), (tool, _) = wanted, _sought(series)
    number = target or 1 + len(tool.points)
    way = await run.solve(
        f"find the way back {number}", way_to_change, series, visits.here_rad, visits.target
    )
    pace = tool.paces[target - 1] if target else series.plan.pace
    await visits.change(number, target, pace, way)
    await run.step(f"change the target {number}", ask, asked)


def way_to_change(series: Series, here_rad: Joints, target: int) -> Way:
    """Return the way to where hook or target can be changed."""
    rest_rad, plan = series.plan.way_to_rest_rad[-1], series.plan
    if not target:
        return way_between(series.reach(), plan.roads, here_rad, rest_rad)
    tool, goal = _sought(series)
    reach = series.reach().with_target(goal.points_m()[target - 1])
    return way_between(reach, tool.points[target - 1].roads, here_rad, rest_rad)


def choose_point(series: Series, standing: Standing, point: int) -> PointChoice:
    """Choose the pose that tells most about a point among those that are soon reached; or end its measuring."""
    (tool, goal), rules = _sought(series), series.rules
    taken = of_target(standing.captures, point)
    known = _expected(series, standing)
    if goal.enough(rules.point_min, point)(len(taken), known):
        return PointChoice((), True)
    plan, left = tool.points[point - 1], unseen(tool.points[point - 1].pool, taken)
    if not len(left) or len(taken) >= rules.point_max:
        return PointChoice((), False)
    turn = best_for(
        known.of_target(point), left, place_rows(known, point), lambda *_: False, most=rules.batch
    )
    poses = tuple(tuple(float(q) for q in left[k]) for k in turn.order)
    reach = series.reach().with_target(goal.points_m()[point - 1])
    return PointChoice(ordered_ways(reach, plan.roads, standing.here_rad, poses)[0], False)


def point_checks(series: Series, here_rad: Joints, point: int) -> tuple[Way, ...]:
    """Return ways to the poses of a point that were put aside for verification."""
    tool, goal = _sought(series)
    plan, reach = tool.points[point - 1], series.reach().with_target(goal.points_m()[point - 1])
    return ordered_ways(reach, plan.roads, here_rad, plan.reserved)


def _expected(series: Series, standing: Standing) -> Outlook:
    """Return what will be known once the flange's poses that are still to come are measured, as planned."""
    now, flange = known_so_far(series, standing.captures), of_target(standing.captures, 0)
    coming = tuple(way[-1] for way in series.plan.foreseen_rad[: series.plan.expected_captures])
    left = unseen(coming, flange)[: max(0, len(coming) - len(flange))]
    if not len(left):
        return now
    return replace(with_readings(now, left, np.zeros(len(left), dtype=np.intp)), observe=now.observe)


def _sought(series: Series) -> tuple[ToolPlan, ToolGoal]:
    tool, goal = series.plan.tool, series.plan.goal.tool
    assert tool is not None
    assert goal is not None  # such a series has both
    return tool, goal
