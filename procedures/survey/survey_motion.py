"""Which poses a survey may use, and whether a way between two of them may be commanded. Pure functions."""

import math
from functools import lru_cache

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath, allowed_postures, check_moves
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.motion.approach import from_below
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.surroundings import Surroundings, clearance_check

Triple = tuple[float, float, float]
Wire = tuple[Triple, Triple, float]  # exit in the base, hook in the flange, range [m]

WIDEST_BEND_RAD = 1.0  # between the wire and its mouth's direction: beyond, the lip's radius blurs the length
FEWEST_POSES = 8
_STEP_RAD, _NEARER_M, _CORNERS = 0.01, 0.001, 80
_TRIED, _LOOKS = 12, 9  # postures tried as a rest, of each pool; places looked at on a way


def survey_limits(wire: Wire | None, room: MotionBounds, speed_rad_s: float) -> MotionLimits:
    """Return what every posture and way of a survey must keep; without a wire while it is not hooked in."""
    low, high = room.box_m()
    return MotionLimits(
        joint_speed_rad_s=speed_rad_s,
        tip_speed_m_s=room.capped_tip_speed_m_s,
        box_low_m=low,
        box_high_m=high,
        wire=None
        if wire is None
        else WirePath(*wire, lowest_fraction=room.wire_low, highest_fraction=room.wire_high),
    )


@lru_cache(maxsize=64)
def draw_pool(
    model_name: str, wire: Wire, room: MotionBounds, mouth_at_m: Triple | None, count_seed: tuple[int, int]
) -> tuple[Joints, ...]:
    """Draw postures evenly between the joint limits; keep those that limits, wire and the arm itself allow.

    Raises
    ------
    DegenerateDataError
        Fewer than eight are left.
    """
    model = load_model(model_name)
    limits, (count, seed) = survey_limits(wire, room, 0.5), count_seed
    drawn = candidate_joints(model, limits, 6 * count, seed=seed, hook_in_flange_m=wire[1])
    if mouth_at_m is not None:
        away = model.tip_positions(drawn, np.array(wire[1])) - np.array(wire[0])
        ahead = np.array(mouth_at_m) - np.array(wire[0])
        cosine = away @ ahead / (np.linalg.norm(away, axis=1) * np.linalg.norm(ahead))
        drawn = drawn[cosine > np.cos(WIDEST_BEND_RAD)]
    pool = drawn[_collision_check(model_name, wire, room.surroundings).is_free(drawn)][:count]
    if len(pool) < FEWEST_POSES:
        raise DegenerateDataError(
            make_message(
                "only {pool_count} of the postures tried keep joint limits, box, wire and arm clear of "
                "each other",
                pool_count=len(pool),
            ),
            remedy="Widen the workspace box, or put the fixture or the wire where the robot reaches all round it.",
        )
    return tuple(tuple(float(q) for q in pose) for pose in pool)


@lru_cache(maxsize=64)
def middle_of_work(model_name: str, wires: tuple[Wire, ...], room: MotionBounds, seed: int) -> Triple:
    """Return where a wire's mouth should look: the mean hook over the postures in reach, to the centimetre [m]."""
    model = load_model(model_name)
    hooks = []
    for number, wire in enumerate(wires):
        limits = survey_limits(wire, room, 0.5)
        drawn = candidate_joints(model, limits, 60, seed=seed + number, hook_in_flange_m=wire[1])
        hooks.append(model.tip_positions(drawn, np.array(wire[1])))
    x, y, z = (round(float(v), 2) for v in np.concatenate(hooks).mean(axis=0))
    return (x, y, z)


@lru_cache(maxsize=16)
def resting_poses(
    model_name: str, wires: tuple[Wire, ...], room: MotionBounds, pools: tuple[tuple[Joints, ...], ...]
) -> tuple[Joints, ...]:
    """Return postures at which the wire can be moved, the one from which most poses can be reached first.

    Raises
    ------
    DegenerateDataError
        No posture keeps the wire clear of the arm at every spot.
    """
    allowed = [q for pool in pools for q in pool[:_TRIED] if _clear_everywhere(model_name, wires, room, q)]
    if not allowed:
        raise DegenerateDataError(
            "no posture keeps the wire clear of the arm at every spot.",
            remedy="Put the spots on one side of the robot, or use fewer of them.",
        )
    shares = [
        min(
            _coarse_share(model_name, (wire, room), q, pool[:_TRIED])
            for wire, pool in zip(wires, pools, strict=True)
        )
        for q in allowed
    ]
    best = [k for k in np.argsort(-np.array(shares), kind="stable") if shares[k] >= max(shares) / 2.0]
    return tuple(allowed[k] for k in best)


def way_to_rest(
    model_name: str, room: MotionBounds, here_rad: Joints, rests: tuple[Joints, ...]
) -> tuple[Joints, ...]:
    """Return the corners of a free way, the wire still off, to the best rest that has one.

    Raises
    ------
    DegenerateDataError
        There is none, not even through one of eighty postures in between.
    """
    near = next((rest for rest in rests if _is_leaving_free(model_name, room, here_rad, rest)), None)
    if near is not None:
        return (near,)
    for corner in _free_postures(model_name, room, here_rad):
        if _is_leaving_free(model_name, room, here_rad, corner):
            found = next((rest for rest in rests if way_is_free(model_name, None, room, corner, rest)), None)
            if found is not None:
                return (corner, found)
    degrees = ", ".join(f"{math.degrees(q):.0f}" for q in rests[0])
    raise DegenerateDataError(
        "no way is free from where the robot stands to where the wire can be moved.",
        remedy=make_message("Jog the robot to about {degrees} deg, then start a new run.", degrees=degrees),
    )


def _free_postures(model_name: str, room: MotionBounds, here_rad: Joints) -> list[Joints]:
    """Return postures clear of everything, the nearest to here first."""
    model = load_model(model_name)
    drawn = candidate_joints(model, survey_limits(None, room, 0.5), _CORNERS, seed=1)
    clear = drawn[_collision_check(model_name, None, room.surroundings).is_free(drawn)]
    order = np.argsort(np.abs(clear - np.array(here_rad)).max(axis=1))
    return [tuple(float(q) for q in clear[k]) for k in order]


def _is_leaving_free(model_name: str, room: MotionBounds, here_rad: Joints, there_rad: Joints) -> bool:
    """Return whether a way is free; one that begins too near to something may not come any nearer (DECISIONS 7)."""
    model, ends = load_model(model_name), np.array([here_rad, there_rad])
    limits = survey_limits(None, room, 0.5)
    if not check_moves(model, ends[0], ends[1:], limits, speed_rad_s=1e-4).allowed:
        return False
    collisions = _collision_check(model_name, None, room.surroundings)
    steps = int(np.ceil(np.abs(ends[1] - ends[0]).max() / _STEP_RAD)) + 1
    way = ends[0] + np.linspace(0.0, 1.0, steps + 1)[:, None] * (ends[1] - ends[0])
    clearances = np.array([contact.clearance_m for contact in collisions.narrowest_contacts(way)])
    allowed_m = min(collisions.shape.margin_m, clearances[0] - _NEARER_M)
    ends_free = clearances[-1] >= collisions.shape.margin_m
    return bool(ends_free and (clearances >= allowed_m).all())


def way_between(
    model_name: str, wire: Wire, room: MotionBounds, rest_rad: Joints, ends: tuple[Joints, Joints]
) -> tuple[Joints, ...]:
    """Return the corners of a free way to the second posture, with the detour through the rest; empty without one.

    Only postures with a free way to the rest are gone to, so that there is always a way back.
    """
    here, there = ends
    if not way_is_free(model_name, wire, room, rest_rad, there):
        return ()
    if way_is_free(model_name, wire, room, here, there):
        return (there,)
    return (rest_rad, there) if way_is_free(model_name, wire, room, here, rest_rad) else ()


@lru_cache(maxsize=4096)
def way_is_free(
    model_name: str, wire: Wire | None, room: MotionBounds, here_rad: Joints, there_rad: Joints
) -> bool:
    """Return whether a joint move keeps limits, box and wire's range, and the arm clear of itself and of the wire."""
    model, limits = load_model(model_name), survey_limits(wire, room, 0.5)
    ends = np.array([here_rad, *from_below(here_rad, there_rad)])
    if not check_moves(model, ends[0], ends[1:], limits, speed_rad_s=1e-4, stops=_last_only(ends)).allowed:
        return False
    return bool(_collision_check(model_name, wire, room.surroundings).is_path_free(ends).all())


def unchecked_remarks(model_name: str, wire: Wire, room: MotionBounds) -> tuple[str, ...]:
    """Return in sentences what no check of the ways sees."""
    words = list(_collision_check(model_name, wire, room.surroundings).not_checked)
    if None in room.box_m():
        words.append("no workspace box known")
    return tuple(words)


def _clear_everywhere(
    model_name: str, wires: tuple[Wire, ...], room: MotionBounds, posture_rad: Joints
) -> bool:
    model, posture = load_model(model_name), np.array([posture_rad])
    return all(
        bool(allowed_postures(model, posture, survey_limits(wire, room, 0.5), wire[1])[0])
        and bool(_collision_check(model_name, wire, room.surroundings).is_free(posture)[0])
        for wire in wires
    )


def _coarse_share(
    model_name: str, at: tuple[Wire, MotionBounds], rest_rad: Joints, pool: tuple[Joints, ...]
) -> float:
    """Return which share of the poses seems to have a free way to the rest, looked at in a few places."""
    (wire, room), share = at, np.linspace(0.0, 1.0, _LOOKS)[:, None, None]
    rest, ends = np.array(rest_rad), np.array(pool)
    postures = rest + share * (ends - rest)
    free = _collision_check(model_name, wire, room.surroundings).is_free(postures.reshape(-1, len(rest)))
    return float(free.reshape(_LOOKS, -1).all(axis=0).mean())


def _last_only(ends: Array) -> list[bool]:
    return [False] * (len(ends) - 2) + [True]


def _collision_check(model_name: str, wire: Wire | None, surroundings: Surroundings) -> CollisionCheck:
    return clearance_check(model_name, surroundings, None if wire is None else WirePath(*wire))
