"""Five poses in a cube that one arm can go round, with free ways, and others that tell where the device is."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cellcal.calibration.accuracy import FULL_POSES, cube_positions
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import allowed_postures
from cellcal.calibration.poses.next_pose import spread_order
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.arm.arm_bench import Bench, Triple
from cellcal.procedures.arm.arm_motion import (
    MotionSpace,
    Roadmap,
    draw_poses,
    map_roads,
    ordered_ways,
    way_is_free,
    way_to_rest,
    ways_through,
    wound_on_way,
)
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.motion.speed_limit import SpeedLimit, TimedMotion
from cellcal.procedures.survey.survey_motion import survey_limits

SHRINK, SMALLEST_SHARE = 0.8, 0.3
_TRIED, _STEPS, _REACHED_M = 12, 12, 1e-6
_CENTRES = 12


class CubeRules(Protocol):
    """The rules of a plan."""

    @property
    def centre_m(self) -> Triple | None: ...
    @property
    def side_m(self) -> float: ...
    @property
    def placing(self) -> int: ...
    @property
    def candidates(self) -> int: ...
    @property
    def seed(self) -> int: ...
    @property
    def room(self) -> MotionBounds: ...


@dataclass(frozen=True, slots=True)
class CubePlan:
    """The test poses P1 to P5, the ways to them, and the ways to the poses that place the device."""

    centre_m: Triple
    side_m: float
    tests_rad: tuple[Joints, ...]
    placing_rad: tuple[tuple[Joints, ...], ...]
    first_round_rad: tuple[tuple[Joints, ...], ...]
    round_rad: tuple[tuple[Joints, ...], ...]
    way_to_rest_rad: tuple[Joints, ...]
    pace: SpeedLimit
    not_checked: tuple[str, ...]

    def round_motion(self) -> TimedMotion:
        """Return how far and how long the arm goes once round the cube."""
        return self.pace.time_ways(self.tests_rad[-1], self.round_rad)

    def total_motion(self, cycles: int) -> TimedMotion:
        """Return how far and how long the arm goes in all, with so many rounds."""
        begun = self.pace.time_ways(self.way_to_rest_rad[-1], (*self.placing_rad, *self.first_round_rad))
        return begun + self.round_motion().repeat_motion(cycles - 1)


@dataclass(frozen=True, slots=True)
class _TestPose:
    """A test pose with the hub on which it hangs, and how far a wire is wound there."""

    pose_rad: Joints
    hub: int
    wound_rad: float


def plan_cube(bench: Bench, rules: CubeRules) -> CubePlan:
    """Plan the largest cube, up to the one asked for, whose five poses can be gone to.

    Raises
    ------
    DegenerateDataError
        Not even a cube of a third of the size can.
    """
    reach = MotionSpace.from_bench(bench, rules.room)
    drawn = draw_poses(reach, rules.candidates, rules.seed)
    to_rest = way_to_rest(reach, bench.joints_rad, drawn)
    roads = map_roads(reach, to_rest[-1], drawn)
    centres = (rules.centre_m,) if rules.centre_m is not None else _dense_places(reach, roads, rules.side_m)
    centre, side, found = _largest_cube(bench, reach, roads, (centres, rules.side_m))
    tests = tuple(one.pose_rad for one in found)
    roads = Roadmap(
        roads.hubs_rad,
        roads.parents,
        (*roads.poses_rad, *tests),
        (*roads.hub_of, *(one.hub for one in found)),
        (*roads.wound_rad, *(one.wound_rad for one in found)),
    )
    placing = _ways_to_placing(reach, roads, to_rest[-1], rules.placing, len(tests))
    here = placing[-1][-1]
    return CubePlan(
        centre_m=centre,
        side_m=side,
        tests_rad=tests,
        placing_rad=placing,
        first_round_rad=ways_through(reach, roads, here, tests),
        round_rad=ways_through(reach, roads, tests[-1], tests),
        way_to_rest_rad=to_rest,
        pace=reach.speed_limit(bench.limits.speed_rad_s),
        not_checked=reach.not_checked(),
    )


def _largest_cube(
    bench: Bench, reach: MotionSpace, roads: Roadmap, largest: tuple[tuple[Triple, ...], float]
) -> tuple[Triple, float, tuple[_TestPose, ...]]:
    """Return the largest cube that has its five poses; of those as large, the one that is gone round soonest."""
    centres, side = largest
    while side >= SMALLEST_SHARE * largest[1]:
        fives = [
            (centre, _five_poses(bench, reach, roads, cube_positions(centre, side))) for centre in centres
        ]
        whole = [(centre, found) for centre, found in fives if len(found) == FULL_POSES]
        if whole:
            centre, found = min(whole, key=lambda one: _turned_rad(one[1]))
            return centre, side, found
        side *= SHRINK
    x, y, z = centres[0]
    raise DegenerateDataError(
        make_message(
            "no cube about x {x:.0f}, y {y:.0f}, z {z:.0f} mm has five poses that can be gone to",
            x=x * 1000.0,
            y=y * 1000.0,
            z=z * 1000.0,
        ),
        remedy="Choose another centre_m, or a smaller side_m; or allow more candidates.",
    )


def _dense_places(reach: MotionSpace, roads: Roadmap, side_m: float) -> tuple[Triple, ...]:
    """Return places, to the centimetre and apart, about which the target can be put in most postures."""
    targets = reach.targets_m(np.array(roads.poses_rad))
    apart = np.linalg.norm(targets[:, None] - targets[None], axis=2)
    best: list[int] = []
    for k in np.argsort(-(apart < side_m / 2.0).sum(axis=1), kind="stable"):
        if len(best) < _CENTRES and np.all(apart[k, best] > side_m / 2.0):
            best.append(int(k))
    places = [tuple(round(float(v), 2) for v in targets[k]) for k in best]
    return tuple((x, y, z) for x, y, z in places)


def _turned_rad(found: tuple[_TestPose, ...]) -> float:
    """Return the way of the slowest joint once round these poses."""
    poses = np.array([one.pose_rad for one in (*found, found[0])])
    return float(np.abs(np.diff(poses, axis=0)).max(axis=1).sum())


def _ways_to_placing(
    reach: MotionSpace, roads: Roadmap, rest_rad: Joints, count: int, tests: int
) -> tuple[tuple[Joints, ...], ...]:
    """Return ways to poses far from each other and from the test poses."""
    every = np.array(roads.poses_rad)
    last = range(len(every) - tests, len(every))
    chosen = spread_order(every, reach.targets_m(every), count, first=tuple(last))
    return ordered_ways(reach, roads, rest_rad, tuple(roads.poses_rad[k] for k in chosen))


def _five_poses(bench: Bench, reach: MotionSpace, roads: Roadmap, places_m: Array) -> tuple[_TestPose, ...]:
    """Return a posture for each place, as long as there is one."""
    found: list[_TestPose] = []
    for place in places_m:
        pose = _posture_at(bench, reach, roads, place, found)
        if pose is None:
            break
        found.append(pose)
    return tuple(found)


def _posture_at(
    bench: Bench, reach: MotionSpace, roads: Roadmap, place_m: Array, found: Sequence[_TestPose]
) -> _TestPose | None:
    """Return a posture that puts the target at a place: one of those found, or a drawn one, moved there.

    The first found is the cube's middle: about it the arm turns least, and its attitude changes least.
    """
    every = np.array(roads.poses_rad)
    nearest = np.argsort(np.linalg.norm(reach.targets_m(every) - place_m, axis=1))[:_TRIED]
    drawn = (_TestPose(roads.poses_rad[k], roads.hub_of[k], roads.wound_rad[k]) for k in nearest)
    limits = survey_limits(reach.wire, reach.room, 0.5)
    for near in (*found, *drawn):
        moved = _moved_to(bench, reach, np.array(near.pose_rad), place_m)
        if (
            moved is None
            or not allowed_postures(bench.nominal_model(), moved[None], limits, reach.target_in_flange_m)[0]
        ):
            continue
        pose = tuple(float(q) for q in moved)
        if way_is_free(reach, roads.hubs_rad[near.hub], pose):
            return _TestPose(pose, near.hub, near.wound_rad + wound_on_way(reach, near.pose_rad, pose))
    return None


def _moved_to(bench: Bench, reach: MotionSpace, joints_rad: Array, place_m: Array) -> Array | None:
    """Return the joints nearby that put the target there, by Newton's steps; None if they do not end."""
    model, target = bench.nominal_model(), np.array(reach.target_in_flange_m)
    joints = joints_rad.copy()
    for _ in range(_STEPS):
        tips, jacobian = model.tip_jacobian(joints[None], target)
        gap = place_m - tips[0]
        if float(np.linalg.norm(gap)) < _REACHED_M:
            return joints
        joints = joints + np.linalg.pinv(jacobian[0]) @ gap
    return None
