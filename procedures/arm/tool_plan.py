"""Points of the end-effector in between the poses of a calibration: what is sought, its poses, and the next of them.

The places of the points are unknowns of the same fit as the arm; the tool frame follows from them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.points.end_effector import points_in_flange, refuse_tool_points, tool_u
from cellcal.calibration.points.fixture import Triple
from cellcal.calibration.poses.arm_fit import point_covariance, point_rows
from cellcal.calibration.poses.measurement_prediction import MeasurementPrediction
from cellcal.calibration.poses.next_pose import choose_for_unknowns, spread_order
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.arm.arm_bench import ArmCapture
from cellcal.procedures.arm.arm_motion import (
    MotionSpace,
    Roadmap,
    Spots,
    draw_poses,
    map_roads,
    ordered_ways,
    way_between,
)
from cellcal.procedures.arm.series_rules import SeriesRules
from cellcal.procedures.motion.speed_limit import SpeedLimit, TimedMotion

# Of a limit: what a point promises before the arm is known as well as it will be.
_PROMISE = 0.78
_SAME_POSE_RAD = 0.02


@dataclass(frozen=True, slots=True)
class ToolGoal:
    """The places of the points from the tip, roughly where the tool is, and how well its frame must be known."""

    rough_flange_tool: Pose
    points_in_tool_m: tuple[Triple, ...]
    tip_u_m: float
    angle_u_rad: float
    point_sigma_m: float  # of drawing and seat, one coordinate of one point

    def __post_init__(self) -> None:
        refuse_tool_points(self.points_in_tool_m)

    def points_m(self) -> tuple[Triple, ...]:
        """Return where the points roughly are in the flange [m]."""
        return points_in_flange(self.rough_flange_tool, self.points_in_tool_m)

    def expanded_uncertainties(self, covariance_m2: Array) -> tuple[float, float]:
        """Return U (k = 2) of tip [m] and axes [rad] once the points are known so well."""
        return tool_u(self.rough_flange_tool, self.points_in_tool_m, covariance_m2, self.point_sigma_m)

    def stop_rule(self, least: int, point: int) -> Callable[[int, MeasurementPrediction], bool]:
        """Return whether so many captures of a point are expected to do."""
        return lambda count, prediction: count >= least and self.is_promised_by(prediction, point)

    def is_promised_by(self, prediction: MeasurementPrediction, point: int) -> bool:
        """Return whether the goal would be met if every point were known as this one is; points count from 1."""
        at = slice(3 * point - 3, 3 * point)
        every = np.kron(np.eye(len(self.points_in_tool_m)), point_covariance(prediction)[at, at])
        tip_u_m, angle_u_rad = self.expanded_uncertainties(np.asarray(every, dtype=np.float64))
        return tip_u_m <= _PROMISE * self.tip_u_m and angle_u_rad <= _PROMISE * self.angle_u_rad


@dataclass(frozen=True, slots=True)
class PointPlan:
    """Poses for one point to choose from and to verify with."""

    roads: Roadmap
    pool: tuple[Joints, ...]
    reserved: tuple[Joints, ...]  # for verification; never fitted
    foreseen_rad: tuple[tuple[Joints, ...], ...]  # ways to those that tell most, to the checks, and back


@dataclass(frozen=True, slots=True)
class ToolPlan:
    """The expected deviations of the points."""

    points: tuple[PointPlan, ...]
    captures: tuple[int, ...]  # expected at each
    tip_u_m: float  # expected after them, k = 2
    angle_u_rad: float
    paces: tuple[SpeedLimit, ...] = ()

    def expected_motion(self, rest_rad: Joints) -> TimedMotion:
        """Return how far and how long the arm is expected to go."""
        ways = zip(self.paces, self.points, strict=True)
        tours = [pace.time_ways(rest_rad, point.foreseen_rad) for pace, point in ways]
        return sum(tours[1:], start=tours[0])


def draw_points(reach: MotionSpace, goal: ToolGoal, rules: SeriesRules) -> Spots:
    """Draw postures for every point; the wire's housing stays as it is turned for the flange."""
    mouth_at_m = rules.mouth_at_m or reach.mouth_at_m(rules.seed)
    reaches = tuple(reach.with_target(point) for point in goal.points_m())
    return tuple(
        (one, draw_poses(one, rules.point_candidates, rules.seed + k, mouth_at_m))
        for k, one in enumerate(reaches, 1)
    )


def plan_points(
    standing: tuple[Joints, Spots], goal: ToolGoal, rules: SeriesRules, prediction: MeasurementPrediction
) -> ToolPlan:
    """Plan the poses of every point from the rest, and foresee how many of them will do after the flange's."""
    rest_rad, spots = standing
    plans, counts = [], []
    for number, (reach, drawn) in enumerate(spots, 1):
        roads = map_roads(reach, rest_rad, drawn)
        every = np.array(roads.poses_rad[1:])
        reserved = spread_order(every, reach.targets_m(every), rules.point_checks)
        checks = tuple(roads.poses_rad[1 + k] for k in reserved)
        pool = tuple(pose for pose in roads.poses_rad[1:] if pose not in checks)
        turn = choose_for_unknowns(
            prediction.of_target(number),
            np.array(pool),
            place_rows(prediction, number),
            goal.stop_rule(rules.point_min, number),
            most=rules.point_max,
        )
        prediction = replace(turn.after, observe=prediction.observe)
        best = tuple(pool[k] for k in turn.order)
        ways = ordered_ways(reach, roads, rest_rad, best)
        ways += ordered_ways(reach, roads, ways[-1][-1], checks)
        ways += (way_between(reach, roads, ways[-1][-1], rest_rad),)
        plans.append(PointPlan(roads, pool, checks, ways))
        counts.append(len(best))
    return ToolPlan(tuple(plans), tuple(counts), *goal.expanded_uncertainties(point_covariance(prediction)))


def place_rows(prediction: MeasurementPrediction, point: int) -> Rows:
    """Return which unknowns are the place of a point; points count from 1."""
    return point_rows(prediction)[3 * point - 3 : 3 * point]


def unmeasured_poses(pool: tuple[Joints, ...], captures: tuple[ArmCapture, ...]) -> Array:
    """Return the poses of a pool that were not measured yet."""
    poses = np.array(pool)
    if not captures:
        return poses
    measured = np.array([capture.joints_rad for capture in captures])
    apart = np.abs(poses[:, None, :] - measured[None]).max(axis=2).min(axis=1)
    remaining: Array = poses[apart > _SAME_POSE_RAD]
    return remaining
