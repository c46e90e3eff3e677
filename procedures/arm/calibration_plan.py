"""The plan of a robot calibration, and the choice of its next poses. Pure functions of what was measured."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.parameters import GEOMETRY, GRAVITY, OFFSETS
from cellcal.calibration.identification.robust import RobustFit
from cellcal.calibration.message import make_message
from cellcal.calibration.poses.arm_fit import (
    ArmTask,
    fit_arm,
    predict_from_fit,
    predict_task,
    target_expanded_u,
    with_readings,
)
from cellcal.calibration.poses.enough_poses import AcceptanceLimits, acceptance_gaps
from cellcal.calibration.poses.measurement_poses import DesignCriterion
from cellcal.calibration.poses.measurement_prediction import (
    MeasurementPrediction,
    TestPoses,
    predict_accuracy,
)
from cellcal.calibration.poses.next_pose import choose_in_turn, random_poses_needed, spread_order
from cellcal.calibration.poses.shortfall import find_shortfall
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.arm.arm_bench import ArmCapture, Bench, observations_of, of_target
from cellcal.procedures.arm.arm_motion import (
    MotionSpace,
    Roadmap,
    Spots,
    draw_poses,
    map_roads,
    ordered_ways,
    way_to_rest,
    ways_through,
)
from cellcal.procedures.arm.series_rules import SeriesRules
from cellcal.procedures.arm.tool_plan import ToolGoal, ToolPlan, draw_points, plan_points, unmeasured_poses
from cellcal.procedures.motion.speed_limit import SpeedLimit, TimedMotion

ModelName = Literal["offsets", "geometry", "sag"]
LEVEL: dict[str, int] = {"offsets": OFFSETS, "geometry": GEOMETRY, "sag": GRAVITY}


@dataclass(frozen=True, slots=True)
class SeriesGoal:
    """How well each quantity must be known before a series ends. ``None`` does not matter."""

    tip_u_m: float | None  # U (k = 2) of the target over the work, RMS
    offset_sigma_rad: float | None  # acceptance angular standard deviation
    offsets_of: tuple[str, ...]
    model: ModelName
    tool: ToolGoal | None = None  # what is sought besides, by points of the end-effector

    def acceptance_limits(self) -> AcceptanceLimits:
        """Return the goal in standard deviations."""
        tip = None if self.tip_u_m is None else self.tip_u_m / 2.0
        return AcceptanceLimits(
            tip_rms_m=tip, offset_rad=self.offset_sigma_rad, offsets_of=self.offsets_of, margin=1.0
        )


@dataclass(frozen=True, slots=True)
class CalibrationPlan:
    """Poses to choose from and to verify with, and what is expected of them."""

    goal: SeriesGoal
    roads: Roadmap
    pool: tuple[Joints, ...]
    tests: tuple[Joints, ...]
    reserved: tuple[Joints, ...]  # for verification; never fitted; spread over the work
    way_to_rest_rad: tuple[Joints, ...]
    # The ways as expected: to the poses that tell most, then to those that verify.
    foreseen_rad: tuple[tuple[Joints, ...], ...]
    pace: SpeedLimit
    expected_captures: int
    tip_u_m: float  # expected after them, k = 2
    tip_u_max_m: float
    shortfall: str  # why the goal is not reachable, empty if it is
    not_checked: tuple[str, ...]
    tool: ToolPlan | None = None

    @property
    def expected_checks(self) -> int:
        """The expected number of poses that verify; fewer than the rules want where the room has no more."""
        return len(self.foreseen_rad) - self.expected_captures

    def expected_motion(self) -> TimedMotion:
        """Return how far and how long the arm is expected to go."""
        flange = self.pace.time_ways(self.way_to_rest_rad[-1], self.foreseen_rad)
        return flange if self.tool is None else flange + self.tool.expected_motion(self.way_to_rest_rad[-1])


@dataclass(frozen=True, slots=True)
class CalibrationSeries:
    """A series from its beginning: robot and device as found, plan, rules. Everything is decided from it."""

    bench: Bench
    plan: CalibrationPlan
    rules: SeriesRules

    def make_task(self) -> ArmTask:
        """Return what its fits are about."""
        return task_of(self.bench, self.plan.goal, self.rules)

    def test_poses(self) -> TestPoses:
        """Return the postures that stand for the work."""
        return TestPoses(np.array(self.plan.tests))

    def motion_space(self) -> MotionSpace:
        """Return what limits its motion."""
        return MotionSpace.from_bench(self.bench, self.rules.room)


@dataclass(frozen=True, slots=True)
class SeriesProgress:
    """The captures so far, which of them were taken again, and where the robot is."""

    captures: tuple[ArmCapture, ...]
    retaken: tuple[int, ...]
    here_rad: Joints
    coming_rad: tuple[tuple[Joints, ...], ...] = ()  # ways that were chosen and not gone yet


@dataclass(frozen=True, slots=True)
class PoseChoice:
    """The next ways, each to a new pose or again to that of a capture; or why there is none."""

    ways_rad: tuple[tuple[Joints, ...], ...]
    again: tuple[int, ...]  # of each way: the capture that is doubted, -1 for a new pose
    enough: bool
    tip_u_m: float
    tip_u_max_m: float
    why_not: str = ""


def task_of(bench: Bench, goal: SeriesGoal, rules: SeriesRules) -> ArmTask:
    """Return what the fits of such a series are about."""
    task = bench.make_task(LEVEL[goal.model], arm_sigma_m=rules.arm_sigma_m)
    return task if goal.tool is None else replace(task, points_in_flange_m=goal.tool.points_m())


def plan_series(bench: Bench, goal: SeriesGoal, rules: SeriesRules) -> CalibrationPlan:
    """Draw poses, put some aside for verification, and foresee how many of the others will do."""
    reach = MotionSpace.from_bench(bench, rules.room)
    postures = draw_poses(reach, rules.candidates, rules.seed, rules.mouth_at_m)
    spots = () if goal.tool is None else draw_points(reach, goal.tool, rules)
    to_rest = way_to_rest(reach, bench.joints_rad, postures, spots)
    roads = map_roads(reach, to_rest[-1], postures)
    drawn, work = roads.poses_rad[1:], np.array(postures)  # the first is where the series begins
    every = np.array(drawn)
    most_checks = min(rules.checks_for(rules.max_captures), len(drawn) // 3)
    reserved = spread_order(every, reach.targets_m(every), most_checks)
    pool = np.delete(every, list(reserved), axis=0)
    tests = TestPoses(work[:: max(1, len(work) // rules.tests)][: rules.tests])
    before = predict_task(task_of(bench, goal, rules), np.empty((0, every.shape[1])))
    reserved_poses, poses = tuple(drawn[k] for k in reserved), _pose_tuples(pool)
    turn = choose_in_turn(before, pool, tests, _stop_rule(goal, rules, tests), most=rules.max_captures)
    order, after = turn.order, turn.after
    u_m, u_max_m = target_expanded_u(after, tests)
    found = find_shortfall(before, pool, goal.acceptance_limits(), tests)
    best = tuple(poses[index] for index in order)
    checks = reserved_poses[: rules.checks_for(len(order))]
    tool = None if goal.tool is None else plan_points((to_rest[-1], spots), goal.tool, rules, after)
    return CalibrationPlan(
        goal=goal,
        roads=roads,
        pool=poses,
        tests=_pose_tuples(tests.joints_rad),
        reserved=reserved_poses,
        way_to_rest_rad=to_rest,
        foreseen_rad=_foresee_ways(reach, roads, rules, (best, checks)),
        pace=reach.speed_limit(bench.limits.speed_rad_s),
        expected_captures=len(order),
        tip_u_m=u_m,
        tip_u_max_m=u_max_m,
        shortfall="" if found is None else found.shortfall_text,
        not_checked=reach.not_checked(),
        tool=None if tool is None else replace(tool, paces=_speed_limits(bench, rules, spots)),
    )


def _speed_limits(bench: Bench, rules: SeriesRules, spots: Spots) -> tuple[SpeedLimit, ...]:
    return tuple(reach.speed_limit(bench.limits.speed_rad_s) for reach, _ in spots)


def _foresee_ways(
    reach: MotionSpace,
    roads: Roadmap,
    rules: SeriesRules,
    poses: tuple[tuple[Joints, ...], tuple[Joints, ...]],
) -> tuple[tuple[Joints, ...], ...]:
    """Return the ways to the best poses, a few at a time as they will be chosen, then to those that verify."""
    best, checks = poses
    cuts = [0, *range(rules.first, len(best), rules.batch), len(best)]
    ways: list[tuple[Joints, ...]] = []
    for some in (*(best[a:b] for a, b in pairwise(cuts)), checks):
        ways += ordered_ways(reach, roads, ways[-1][-1] if ways else roads.hubs_rad[0], some)
    return tuple(ways)


def choose_poses(series: CalibrationSeries, standing: SeriesProgress) -> PoseChoice:
    """Choose what to measure next: doubted captures again, else the poses that tell most; or end the series."""
    plan, rules, taken = series.plan, series.rules, len(of_target(standing.captures, 0))
    now = predict_current(series, standing.captures)
    u_m, u_max_m = target_expanded_u(now, series.test_poses())
    enough = taken >= rules.min_captures and not acceptance_gaps(
        predict_accuracy(now, series.test_poses()), plan.goal.acceptance_limits()
    )
    done = PoseChoice((), (), enough, u_m, u_max_m)
    doubted = _doubted_captures(series, standing)
    if doubted:
        poses = tuple(_nearest_pose(plan.pool, standing.captures[k]) for k in doubted)
        return replace(
            done,
            ways_rad=ways_through(series.motion_space(), plan.roads, standing.here_rad, poses),
            again=doubted,
            enough=False,
        )
    if enough or taken >= rules.max_captures:
        return (
            done
            if enough
            else _end_choice(done, make_message("{taken} captures were allowed (max_captures)", taken=taken))
        )
    found = find_shortfall(now, np.array(plan.pool), plan.goal.acceptance_limits(), series.test_poses())
    if found is not None and taken >= rules.min_captures:
        return _end_choice(done, found.shortfall_text)
    if standing.coming_rad:
        return replace(done, ways_rad=standing.coming_rad, again=(-1,) * len(standing.coming_rad))
    most_new = min(rules.first if taken == 0 else rules.batch, rules.max_captures - taken)
    choice = _next_ways(series, standing, now, most_new, done)
    return choice if choice.ways_rad else _end_choice(done, "every pose that can be reached was measured")


def _next_ways(
    series: CalibrationSeries,
    standing: SeriesProgress,
    now: MeasurementPrediction,
    most_new: int,
    done: PoseChoice,
) -> PoseChoice:
    """Choose poses one after the other, as if those before were measured."""
    unmeasured, tests = (
        unmeasured_poses(series.plan.pool, of_target(standing.captures, 0)),
        series.test_poses(),
    )
    if not len(unmeasured):
        return done
    turn = choose_in_turn(
        now, unmeasured, tests, lambda *_: False, most=most_new, criterion=_choose_criterion(now, series)
    )
    poses = tuple(tuple(float(q) for q in unmeasured[k]) for k in turn.order)
    ways = ordered_ways(series.motion_space(), series.plan.roads, standing.here_rad, poses)
    return PoseChoice(ways, (-1,) * len(ways), False, done.tip_u_m, done.tip_u_max_m)


def fixed_plan_captures(
    series: CalibrationSeries, captures: tuple[ArmCapture, ...], tip_u_m: float
) -> int | None:
    """Return how many evenly drawn poses would be needed for the same U, median of a few draws; None if too many.

    Points of the end-effector would be measured as they were.
    """
    tests, base = series.test_poses(), _predict_prior(series, captures)
    points = tuple(capture for capture in captures if capture.target)
    if points:
        rows = observations_of(series.make_task(), points)
        base = with_readings(base, rows.joints_rad, rows.mounting)
    return random_poses_needed(
        base,
        np.array(series.plan.pool),
        lambda prediction: target_expanded_u(prediction, tests)[0] <= tip_u_m,
    )


@lru_cache(maxsize=16)
def fit_captures(task: ArmTask, captures: tuple[ArmCapture, ...], level: int | None = None) -> RobustFit:
    """Return the fit of captures; the same question is asked several times between two captures."""
    return fit_arm(task, observations_of(task, captures), level=level)


def _stop_rule(
    goal: SeriesGoal, rules: SeriesRules, tests: TestPoses
) -> Callable[[int, MeasurementPrediction], bool]:
    """Return whether so many captures are expected to be enough."""
    acceptance = goal.acceptance_limits()

    def is_enough(count: int, prediction: MeasurementPrediction) -> bool:
        return count >= rules.min_captures and not acceptance_gaps(
            predict_accuracy(prediction, tests), acceptance
        )

    return is_enough


def predict_current(series: CalibrationSeries, captures: tuple[ArmCapture, ...]) -> MeasurementPrediction:
    """Return what is known: from a fit as soon as that tells more than the priors."""
    task = series.make_task()
    if task.enough_for_a_fit(len(captures)):
        return predict_from_fit(task, fit_captures(task, captures))
    rows = observations_of(task, captures) if captures else None
    before = predict_task(task, np.empty((0, task.nominal_model().axis_count)))
    return before if rows is None else with_readings(before, rows.joints_rad, rows.mounting)


def _predict_prior(series: CalibrationSeries, captures: tuple[ArmCapture, ...]) -> MeasurementPrediction:
    """Return what was known before any capture, for readings as good as they turned out to be."""
    task = series.make_task()
    now = (
        predict_from_fit(task, fit_captures(task, captures)) if task.enough_for_a_fit(len(captures)) else None
    )
    before = predict_task(task, np.empty((0, len(series.bench.joints_rad))))
    return (
        before
        if now is None
        else MeasurementPrediction(
            before.layout, before.state, now.observe, before.scales, before.information
        )
    )


def _choose_criterion(now: MeasurementPrediction, series: CalibrationSeries) -> DesignCriterion:
    missing = acceptance_gaps(
        predict_accuracy(now, series.test_poses()), series.plan.goal.acceptance_limits()
    )
    only_offsets = missing and all(gap.unit == "rad" for gap in missing)
    return DesignCriterion.OFFSETS if only_offsets else DesignCriterion.TEST_POSES


def _doubted_captures(series: CalibrationSeries, standing: SeriesProgress) -> tuple[int, ...]:
    """Return captures that the others contradict and that were not taken again yet."""
    task = series.make_task()
    if not task.enough_for_a_fit(len(standing.captures)):
        return ()
    flange = [k for k, capture in enumerate(standing.captures) if capture.target == 0]
    rejected = [k for k in fit_captures(task, standing.captures).rejected if k in flange]
    retakes_open = series.rules.retakes - len(standing.retaken)
    return tuple(int(k) for k in rejected if int(k) not in standing.retaken)[: max(retakes_open, 0)]


def _nearest_pose(pool: tuple[Joints, ...], capture: ArmCapture) -> Joints:
    """Return the planned pose at which a capture was taken: where the robot stands is a little beside it."""
    apart = np.abs(np.array(pool) - np.array(capture.joints_rad)).max(axis=1)
    return pool[int(np.argmin(apart))]


def _end_choice(done: PoseChoice, why: str) -> PoseChoice:
    return PoseChoice((), (), False, done.tip_u_m, done.tip_u_max_m, why)


def _pose_tuples(joints_rad: Array) -> tuple[Joints, ...]:
    return tuple(tuple(float(q) for q in pose) for pose in joints_rad)
