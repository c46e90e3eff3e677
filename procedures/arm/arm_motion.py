"""Which postures a series on one arm may use, and the ways between them, with a wire or a target on the flange.

With a wire the rules are those of a survey (`procedures.survey.survey_motion`); with a target the arm and the
bar that carries it are kept clear of each other; the path of the tracker's beam is unknown.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.calibration.motion.motion_check import WirePath, check_moves
from cellcal.calibration.motion.motion_quantities import wire_winding
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.arm.arm_bench import Bench, Triple
from cellcal.procedures.motion.approach import from_below
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.motion.speed_limit import SpeedLimit
from cellcal.procedures.surroundings import clearance_check
from cellcal.procedures.survey import survey_motion

FEWEST_POSES = 8
_CORNERS = 80
_TRIED, _LOOKS = 12, 9  # postures tried as a hub; places looked at on a way
_WINDING_LOOKS = 40  # along a joint move, of at most one turn of a joint
_WOUND_RAD, _SAME_WINDING_RAD = 3.5, 0.5  # from where the series begins; the gate allows more
_ANY_SPEED_RAD_S = 0.5  # to compare ways by
_HUBS, _WORTH_A_HUB = 8, 0.1  # and the share of what is left that a hub must seem to reach


@dataclass(frozen=True, slots=True)
class MotionSpace:
    """The limits of the motion of one series; hashable, so that a way is checked once."""

    model: str
    target_in_flange_m: Triple
    wire: survey_motion.Wire | None
    room: MotionBounds

    @classmethod
    def from_bench(cls, bench: Bench, room: MotionBounds) -> "MotionSpace":
        """Return the reach of a bench."""
        wire = (bench.anchor_in_base_m, bench.target_in_flange_m, bench.range_m)
        return cls(bench.model, bench.target_in_flange_m, wire if bench.method == "wire" else None, room)

    def with_target(self, target_in_flange_m: Triple) -> "MotionSpace":
        """Return what limits the motion with wire or target at another place of the flange."""
        wire = None if self.wire is None else (self.wire[0], target_in_flange_m, self.wire[2])
        return replace(self, target_in_flange_m=target_in_flange_m, wire=wire)

    def mouth_at_m(self, seed: int) -> Triple | None:
        """Return where a wire's mouth looks at best: to the middle of the work; None without a wire."""
        if self.wire is None:
            return None
        return survey_motion.middle_of_work(self.model, (self.wire,), self.room, seed)

    def targets_m(self, joints_rad: Array) -> Array:
        """Return where the target is in these postures (N, 3), by the drawing."""
        return load_model(self.model).tip_positions(joints_rad, np.array(self.target_in_flange_m))

    def speed_limit(self, speed_rad_s: float) -> SpeedLimit:
        """Return how fast its ways may be gone."""
        return SpeedLimit(self.model, self.target_in_flange_m, speed_rad_s, self.room.capped_tip_speed_m_s)

    def not_checked(self) -> tuple[str, ...]:
        """Return in sentences what no check of the ways sees."""
        if self.wire is not None:
            return survey_motion.unchecked_remarks(self.model, self.wire, self.room)
        words = [*_collision_check(self).not_checked, "the tracker's line of sight is not known"]
        return tuple(words if None not in self.room.box_m() else [*words, "no workspace box known"])


@lru_cache(maxsize=32)
def draw_poses(
    reach: MotionSpace, count: int, seed: int, mouth_at_m: Triple | None = None
) -> tuple[Joints, ...]:
    """Draw postures evenly between the joint limits; keep those that limits, box and the arm itself allow.

    Raises
    ------
    DegenerateDataError
        Fewer than eight are left.
    """
    if reach.wire is not None:
        mouth = mouth_at_m or reach.mouth_at_m(seed)
        return survey_motion.draw_pool(reach.model, reach.wire, reach.room, mouth, (count, seed))
    model, limits = load_model(reach.model), survey_motion.survey_limits(None, reach.room, 0.5)
    drawn = candidate_joints(model, limits, 4 * count, seed=seed, hook_in_flange_m=reach.target_in_flange_m)
    pool = drawn[_collision_check(reach).is_free(drawn)][:count]
    if len(pool) < FEWEST_POSES:
        raise DegenerateDataError(
            make_message(
                "only {pool_count} of the postures tried keep joint limits, box and arm clear of each other",
                pool_count=len(pool),
            ),
            remedy="Widen the workspace box.",
        )
    return tuple(tuple(float(q) for q in pose) for pose in pool)


Spots = tuple[
    tuple[MotionSpace, tuple[Joints, ...]], ...
]  # other targets on the flange, and postures drawn for each


@lru_cache(maxsize=32)
def way_to_rest(
    reach: MotionSpace, here_rad: Joints, pool: tuple[Joints, ...], spots: Spots = ()
) -> tuple[Joints, ...]:
    """Return the corners of a free way to the posture from which most of the pool can be reached.

    With other targets it is clear for each of them, too: there one is exchanged for the other.

    Raises
    ------
    DegenerateDataError
        There is none.
    """
    if reach.wire is not None:
        wires = tuple(one.wire for one in (reach, *(r for r, _ in spots)) if one.wire is not None)
        rests = survey_motion.resting_poses(reach.model, wires, reach.room, (pool, *(p for _, p in spots)))
    else:
        shares = [_coarse_share(reach, pose, pool[:_TRIED]) for pose in pool[:_TRIED]]
        best = (pool[k] for k in np.argsort(-np.array(shares), kind="stable"))
        rests = tuple(pose for pose in best if all(_is_clear(other, pose) for other, _ in spots))
    if not rests:
        raise DegenerateDataError(
            "no posture keeps the arm clear of itself with the target in every point.",
            remedy="Use points on one side of the end-effector, or fewer of them.",
        )
    return way_to_one(reach, here_rad, rests, pool)


def _is_clear(reach: MotionSpace, pose_rad: Joints) -> bool:
    return bool(_collision_check(reach).is_free(np.array([pose_rad])).all())


def way_to_one(
    reach: MotionSpace, here_rad: Joints, rests: tuple[Joints, ...], pool: tuple[Joints, ...]
) -> tuple[Joints, ...]:
    """Return the corners of a free way to the first of some postures that has one, through one of a pool if need be.

    Raises
    ------
    DegenerateDataError
        There is none.
    """
    near = next((rest for rest in rests if way_is_free(reach, here_rad, rest)), None)
    if near is not None:
        return (near,)
    corners = sorted(pool, key=lambda pose: max(abs(a - b) for a, b in zip(pose, here_rad, strict=True)))
    for corner in corners[:_CORNERS]:
        if way_is_free(reach, here_rad, corner):
            found = next((rest for rest in rests[:_TRIED] if way_is_free(reach, corner, rest)), None)
            if found is not None:
                return (corner, found)
    degrees = ", ".join(f"{np.degrees(q):.0f}" for q in rests[0])
    raise DegenerateDataError(
        "no way is free from where the robot stands to where the series begins.",
        remedy=make_message("Jog the robot to about {degrees} deg, then start a new run.", degrees=degrees),
    )


@dataclass(frozen=True, slots=True)
class Roadmap:
    """Postures that can be gone to, with free ways: each hangs on a hub, each hub on an earlier one."""

    hubs_rad: tuple[Joints, ...]  # the first is where the series begins
    parents: tuple[int, ...]  # of each hub; the first is its own
    poses_rad: tuple[Joints, ...]
    hub_of: tuple[int, ...]  # of each posture
    wound_rad: tuple[
        float, ...
    ]  # of each posture, when it is gone to along the hubs: the wire about the flange

    def hub_at(self, pose_rad: Joints) -> int:
        """Return the hub on which a posture hangs."""
        return self.hub_of[self.poses_rad.index(pose_rad)]

    def winding_at(self, pose_rad: Joints) -> float:
        """Return how far the wire is wound about the flange at a posture, from where the series begins [rad]."""
        return self.wound_rad[self.poses_rad.index(pose_rad)]

    def corners_between(self, here_rad: Joints, there_rad: Joints) -> tuple[Joints, ...]:
        """Return the corners of the way along the hubs, from one posture to another."""
        up, down = self._hub_line(self.hub_at(here_rad)), self._hub_line(self.hub_at(there_rad))
        while len(up) > 1 and len(down) > 1 and up[-2] == down[-2]:
            up, down = up[:-1], down[:-1]
        hubs = [self.hubs_rad[k] for k in (*up, *reversed(down[:-1]))]
        if here_rad in hubs:  # a hub hangs on another one: the way begins or ends where the line passes it
            hubs = hubs[hubs.index(here_rad) + 1 :]
        if there_rad in hubs:
            hubs = hubs[: hubs.index(there_rad)]
        return (*hubs, there_rad)

    def _hub_line(self, hub: int) -> list[int]:
        line = [hub]
        while line[-1] != 0:
            line.append(self.parents[line[-1]])
        return line


@lru_cache(maxsize=16)
def map_roads(reach: MotionSpace, rest_rad: Joints, pool: tuple[Joints, ...]) -> Roadmap:
    """Find free ways to as many postures as a few hubs reach; the others are left out.

    Raises
    ------
    DegenerateDataError
        Fewer than eight can be reached.
    """
    hubs, parents = [rest_rad], [0]
    hung: dict[Joints, _HubLink] = {rest_rad: _HubLink(0, 0.0)}
    hung |= _link_to_hub(reach, rest_rad, _HubLink(0, 0.0), pool)
    while len(hubs) < _HUBS and not set(pool) <= hung.keys():
        remaining = tuple(pose for pose in pool if pose not in hung)
        tried = [pose for pose in hung if pose not in hubs]
        tried = tried[:: max(1, len(tried) // _TRIED)]
        shares = [_coarse_share(reach, pose, remaining[: 2 * _TRIED]) for pose in tried]
        if not shares or max(shares) < _WORTH_A_HUB:
            break
        best = tried[int(np.argmax(shares))]
        parents.append(hung[best].hub)
        hubs.append(best)
        hung |= _link_to_hub(reach, best, _HubLink(len(hubs) - 1, hung[best].wound_rad), remaining)
    if len(hung) < FEWEST_POSES:
        raise DegenerateDataError(
            make_message(
                "only {hung_count} of {pool_count} postures have a free way from where the robot would rest",
                hung_count=len(hung),
                pool_count=len(pool),
            ),
            remedy="Widen the workspace box, allow more candidates, or move the wire.",
        )
    return Roadmap(
        hubs_rad=tuple(hubs),
        parents=tuple(parents),
        poses_rad=tuple(hung),
        hub_of=tuple(one.hub for one in hung.values()),
        wound_rad=tuple(one.wound_rad for one in hung.values()),
    )


def way_between(
    reach: MotionSpace, roads: Roadmap, here_rad: Joints, there_rad: Joints
) -> tuple[Joints, ...]:
    """Return the corners of a free way from one posture of a roadmap to another: straight, or along its hubs."""
    winds = roads.winding_at(there_rad) - roads.winding_at(here_rad)
    alike = abs(wound_on_way(reach, here_rad, there_rad) - winds) < _SAME_WINDING_RAD
    if alike and way_is_free(reach, here_rad, there_rad):
        return (there_rad,)
    return roads.corners_between(here_rad, there_rad)


def ordered_ways(
    reach: MotionSpace, roads: Roadmap, here_rad: Joints, poses: tuple[Joints, ...]
) -> tuple[tuple[Joints, ...], ...]:
    """Return a way to each of these poses of a roadmap, the one that is reached soonest next."""
    remaining, ways, pace = list(poses), [], reach.speed_limit(_ANY_SPEED_RAD_S)
    while remaining:
        roads_there = [way_between(reach, roads, here_rad, pose) for pose in remaining]
        soonest = int(np.argmin([pace.time_ways(here_rad, (way,)).moving_s for way in roads_there]))
        ways.append(roads_there[soonest])
        here_rad = remaining.pop(soonest)
    return tuple(ways)


def ways_through(
    reach: MotionSpace, roads: Roadmap, here_rad: Joints, poses: tuple[Joints, ...]
) -> tuple[tuple[Joints, ...], ...]:
    """Return a way to each of these poses of a roadmap, in this order."""
    starts = (here_rad, *poses[:-1])
    return tuple(way_between(reach, roads, here, pose) for here, pose in zip(starts, poses, strict=True))


@dataclass(frozen=True, slots=True)
class _HubLink:
    """On which hub a posture hangs, and how far the wire is wound there."""

    hub: int
    wound_rad: float


def _link_to_hub(
    reach: MotionSpace, hub_rad: Joints, hub: _HubLink, poses: tuple[Joints, ...]
) -> dict[Joints, _HubLink]:
    """Return the postures with a free way from a hub on which the wire does not wind too far."""
    wound = {pose: hub.wound_rad + wound_on_way(reach, hub_rad, pose) for pose in poses if pose != hub_rad}
    near = [pose for pose, angle in wound.items() if abs(angle) <= _WOUND_RAD]
    return {pose: _HubLink(hub.hub, wound[pose]) for pose in near if way_is_free(reach, hub_rad, pose)}


def wound_on_way(reach: MotionSpace, here_rad: Joints, there_rad: Joints) -> float:
    """Return how far a wire winds about the flange on a straight joint move [rad]; 0 without a wire."""
    if reach.wire is None:
        return 0.0
    share = np.linspace(0.0, 1.0, _WINDING_LOOKS)[:, None]
    path = np.array(here_rad) + share * (np.array(there_rad) - np.array(here_rad))
    return float(wire_winding(load_model(reach.model), path, reach.wire[:2])[-1])


@lru_cache(maxsize=8192)
def way_is_free(reach: MotionSpace, here_rad: Joints, there_rad: Joints) -> bool:
    """Return whether a joint move keeps limits and box, and the arm clear of itself and of what hangs on it."""
    if reach.wire is not None:
        return survey_motion.way_is_free(reach.model, reach.wire, reach.room, here_rad, there_rad)
    model, limits = load_model(reach.model), survey_motion.survey_limits(None, reach.room, 0.5)
    ends = np.array([here_rad, *from_below(here_rad, there_rad)])
    if not check_moves(model, ends[0], ends[1:], limits, speed_rad_s=1e-4).allowed:
        return False
    return bool(_collision_check(reach).is_path_free(ends).all())


def _coarse_share(reach: MotionSpace, rest_rad: Joints, pool: tuple[Joints, ...]) -> float:
    """Return which share of the poses seems to have a free way from the rest, looked at in a few places."""
    share = np.linspace(0.0, 1.0, _LOOKS)[:, None, None]
    rest, ends = np.array(rest_rad), np.array(pool)
    free = _collision_check(reach).is_free((rest + share * (ends - rest)).reshape(-1, len(rest)))
    return float(free.reshape(_LOOKS, -1).all(axis=0).mean())


def _collision_check(reach: MotionSpace) -> CollisionCheck:
    wire = None if reach.wire is None else WirePath(*reach.wire)
    return clearance_check(reach.model, reach.room.surroundings, wire, reach.target_in_flange_m)
