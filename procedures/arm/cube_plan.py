"""Five poses in a cube that one arm can go round, with free ways, and others that tell where the device is."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calibration.accuracy import FULL_POSES, cube_positions
from calibration.errors import DegenerateDataError
from calibration.geometry import Array
from calibration.motion.motion_check import allowed_postures
from calibration.poses.next_pose import spread_order
from drivers.interfaces import Joints
from procedures.arm.arm_bench import Bench, Triple
from procedures.arm.arm_motion import (
    Reach,
    Roadmap,
    draw_poses,
    map_roads,
    ordered_ways,
    way_between,
    way_is_free,
    way_to_rest,
    wound_on_way,
)
from procedures.motion.plans import Room
from procedures.survey.survey_motion import survey_limits

SHRINK, SMALLEST_SHARE = 0.8, 0.3
_TRIED, _STEPS, _REACHED_M = 12, 12, 1e-6
_CENTRES = 6


class CubeRules(Protocol):
    """What a plan is made by."""

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
    def room(self) -> Room: ...


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
    speed_rad_s: float
    not_checked: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Found:
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
    reach = Reach.of(bench, rules.room)
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
    placing = _placing(reach, roads, to_rest[-1], rules.placing, len(tests))
    here = placing[-1][-1]
    return CubePlan(
        centre_m=centre,
        side_m=side,
        tests_rad=tests,
        placing_rad=placing,
        first_round_rad=_round(reach, roads, here, tests),
        round_rad=_round(reach, roads, tests[-1], tests),
        way_to_rest_rad=to_rest,
        speed_rad_s=reach.speed((*roads.poses_rad, *tests), bench.limits.speed_rad_s),
        not_checked=reach.not_checked(),
    )


def _largest_cube(
    bench: Bench, reach: Reach, roads: Roadmap, wanted: tuple[tuple[Triple, ...], float]
) -> tuple[Triple, float, tuple[_Found, ...]]:
    """Return the first cube that has its five poses: large ones about every centre first."""
    centres, side = wanted
    while side >= SMALLEST_SHARE * wanted[1]:
        for centre in centres:
            found = _five(bench, reach, roads, cube_positions(centre, side))
            if len(found) == FULL_POSES:
                return centre, side, found
        side *= SHRINK
    x, y, z = centres[0]
    raise DegenerateDataError(
        f"no cube about x {x * 1e3:.0f}, y {y * 1e3:.0f}, z {z * 1e3:.0f} mm has five poses that can be gone to",
        remedy="Choose another centre_m, or a smaller side_m; or allow more candidates.",
    )


def _dense_places(reach: Reach, roads: Roadmap, side_m: float) -> tuple[Triple, ...]:
    """Return places, to the centimetre, about which the target can be put in most postures."""
    targets = reach.targets_m(np.array(roads.poses_rad))
    near = (np.linalg.norm(targets[:, None] - targets[None], axis=2) < side_m / 2.0).sum(axis=1)
    best = np.argsort(-near, kind="stable")[:_CENTRES]
    places = [tuple(round(float(v), 2) for v in targets[k]) for k in best]
    return tuple((x, y, z) for x, y, z in places)


def _round(
    reach: Reach, roads: Roadmap, here_rad: Joints, tests: tuple[Joints, ...]
) -> tuple[tuple[Joints, ...], ...]:
    ways = []
    for pose in tests:
        ways.append(way_between(reach, roads, here_rad, pose))
        here_rad = pose
    return tuple(ways)


def _placing(
    reach: Reach, roads: Roadmap, rest_rad: Joints, count: int, tests: int
) -> tuple[tuple[Joints, ...], ...]:
    """Return ways to poses far from each other and from the test poses."""
    every = np.array(roads.poses_rad)
    last = range(len(every) - tests, len(every))
    chosen = spread_order(every, reach.targets_m(every), count, first=tuple(last))
    return ordered_ways(reach, roads, rest_rad, tuple(roads.poses_rad[k] for k in chosen))


def _five(bench: Bench, reach: Reach, roads: Roadmap, places_m: Array) -> tuple[_Found, ...]:
    """Return a posture for each place, as long as there is one."""
    found: list[_Found] = []
    for place in places_m:
        pose = _posture_at(bench, reach, roads, place)
        if pose is None:
            break
        found.append(pose)
    return tuple(found)


def _posture_at(bench: Bench, reach: Reach, roads: Roadmap, place_m: Array) -> _Found | None:
    """Return a posture that puts the target at a place: a drawn one, moved there."""
    every = np.array(roads.poses_rad)
    nearest = np.argsort(np.linalg.norm(reach.targets_m(every) - place_m, axis=1))[:_TRIED]
    limits = survey_limits(reach.wire, reach.room, 0.5)
    for index in nearest:
        moved = _moved_to(bench, reach, every[index], place_m)
        if (
            moved is None
            or not allowed_postures(bench.nominal(), moved[None], limits, reach.target_in_flange_m)[0]
        ):
            continue
        pose, near = tuple(float(q) for q in moved), roads.poses_rad[int(index)]
        if way_is_free(reach, roads.hubs_rad[roads.hub(near)], pose):
            wound = roads.wound(near) + wound_on_way(reach, near, pose)
            return _Found(pose, roads.hub(near), wound)
    return None


def _moved_to(bench: Bench, reach: Reach, joints_rad: Array, place_m: Array) -> Array | None:
    """Return the joints nearby that put the target there, by Newton's steps; None if they do not end."""
    model, target = bench.nominal(), np.array(reach.target_in_flange_m)
    joints = joints_rad.copy()
    for _ in range(_STEPS):
        tips, jacobian = model.tip_jacobian(joints[None], target)
        gap = place_m - tips[0]
        if float(np.linalg.norm(gap)) < _REACHED_M:
            return joints
        joints = joints + np.linalg.pinv(jacobian[0]) @ gap
    return None
