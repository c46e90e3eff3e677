"""Where a probe feels for the faces of a corner, and the ways between its touches. Pure functions.

Seen from the frame, the tip hovers ``clear_m`` off a face, feels along its normal, and goes back to where it
hovered. From face to face it goes over the top, so that it never crosses the workpiece. The attitude is that in
which the probe stands when the run begins.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import MotionLimits, check_moves
from cellcal.calibration.points.three_two_one import (
    FACES,
    LEAST,
    CornerFace,
    FaceName,
    outward_in_frame,
    three_two_one,
)
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.cell import MotionCaps as Caps
from cellcal.procedures.motion.plan_ways import as_joints, refuse_broken
from cellcal.procedures.motion.plans import MotionPlan, checked_plan
from cellcal.procedures.motion.probe_line import joints_for_tip
from cellcal.procedures.steps.touch import ProbeApproach, TouchedPoint
from cellcal.procedures.surroundings import clearance_check
from cellcal.procedures.survey.survey_motion import survey_limits
from cellcal.procedures.teaching.corner_places import CornerRules, FaceSpot, Triple, check_places, face_places

STEEPEST_RAD = math.radians(45.0)  # between the stylus and the first face's normal: else its shank may touch
_LOOKS = 21  # along a way, for the workpiece
_ROUGH_SIGMA_M = 1e-3  # of a point that is only drawn


@dataclass(frozen=True, slots=True)
class ProbeBench:
    """The robot and its probe before anything moves."""

    model: str
    serial: str
    joints_rad: Joints
    epoch: int | None
    tip_in_flange_m: Triple
    tip_sigma_m: float  # of one coordinate of the tip in the flange, as the cell file says
    axis_in_flange: Triple
    radius_m: float  # of the ball, less what it gives before its contact closes
    probe_sigma_m: float
    limits: Caps


@dataclass(frozen=True, slots=True)
class FaceTouch:
    """A point of a face, felt."""

    face: FaceName
    point: TouchedPoint
    hover_rad: Joints  # where the arm stood before it, and again after it


@dataclass(frozen=True, slots=True)
class FacePlan:
    """Spots to feel one after the other: for each the way to where the tip hovers, and the approach."""

    ways_rad: tuple[tuple[Joints, ...], ...]  # from where the one before ended, that corner first
    approaches: tuple[ProbeApproach, ...]
    motion: MotionPlan


def probed_faces(touches: Sequence[FaceTouch], own_sigma_m: float) -> dict[FaceName, CornerFace]:
    """Return the faces as their points tell them; ``own_sigma_m``: what each arm position scatters by itself."""
    found: dict[FaceName, CornerFace] = {}
    for name in FACES:
        points = [one.point for one in touches if one.face == name]
        if points:
            away = -np.mean([point.direction_in_base for point in points], axis=0)
            sigmas = tuple(math.hypot(point.sigma_m, own_sigma_m) for point in points)
            found[name] = CornerFace(tuple(point.tip_in_base_m for point in points), _as_triple(away), sigmas)
    return found


def frame_so_far(bench: ProbeBench, rules: CornerRules, nominal: Pose, touches: Sequence[FaceTouch]) -> Pose:
    """Return the frame by the faces felt so far; what they leave open is as it was drawn."""
    drawn = {
        name: CornerFace(
            tuple(
                _ball_centre(bench, rules, nominal, name, at)
                for at in face_places(rules)[name][: LEAST[name]]
            ),
            _as_triple(nominal.rotation_matrix() @ outward_in_frame(name, rules.corner)),
            (_ROUGH_SIGMA_M,) * LEAST[name],
        )
        for name in FACES
    }
    faces = drawn | probed_faces(touches, _ROUGH_SIGMA_M)
    return three_two_one(faces, radius_m=bench.radius_m, corner=rules.corner).base_frame


def plan_spots(
    bench: ProbeBench,
    rules: CornerRules,
    nominal: Pose,
    touches: tuple[FaceTouch, ...],
    spots: tuple[FaceSpot, ...],
) -> FacePlan:
    """Plan touches at spots from where the one felt last ended, or from where the robot stood at first."""
    spot_places = face_places(rules)
    targets = [(spot.face, spot_places[spot.face][spot.number]) for spot in spots]
    return _plan_face_touches(bench, rules, nominal, touches, targets)


def plan_check_touches(
    bench: ProbeBench, rules: CornerRules, nominal: Pose, touches: tuple[FaceTouch, ...]
) -> FacePlan:
    """Plan one touch of each face at a place where it was not felt; the last face first."""
    spot_places = check_places(rules)
    return _plan_face_touches(
        bench, rules, nominal, touches, [(face, spot_places[face]) for face in reversed(FACES)]
    )


def rest_of_way(way_rad: Sequence[Joints], here_rad: Joints) -> tuple[Joints, ...]:
    """Return the corners still to be gone of a planned way, for an arm that stands anywhere on it."""
    corners, here = np.array(way_rad), np.array(here_rad)
    apart = []
    for start, end in pairwise(corners):
        leg = end - start
        share = float(np.clip((here - start) @ leg / max(float(leg @ leg), 1e-12), 0.0, 1.0))
        apart.append(float(np.linalg.norm(here - start - share * leg)))
    nearest = len(apart) - 1 - int(np.argmin(apart[::-1]))  # of two that meet where it stands, the later one
    return tuple(way_rad[nearest + 1 :])


def _plan_face_touches(
    bench: ProbeBench,
    rules: CornerRules,
    nominal: Pose,
    touches: tuple[FaceTouch, ...],
    targets: Sequence[tuple[FaceName, Triple]],
) -> FacePlan:
    _refuse_unfit(bench, rules, nominal)
    frame = frame_so_far(bench, rules, nominal, touches)
    here = touches[-1].hover_rad if touches else bench.joints_rad
    before = touches[-1].face if touches else None
    start, model = here, load_model(bench.model)
    ways: list[tuple[Joints, ...]] = []
    approaches: list[ProbeApproach] = []
    for face, at in targets:
        standoff = _standoff_joints(bench, rules, frame, face, at)
        lifted = (
            ()
            if before == face
            else _corners_over(bench, rules, frame, (here, standoff), first=before is None)
        )
        ways.append((here, *lifted, standoff))
        approaches.append(_approach_to(bench, rules, frame, face, at))
        here, before = standoff, face
    _refuse_crossing(model, bench, rules, frame, ways)
    limits = replace(
        survey_limits(None, rules.room, bench.limits.speed_rad_s),
        clearances=clearance_check(bench.model, rules.room.surroundings),
    )
    motion = checked_plan(model, start, [np.array(way[1:]) for way in ways], limits, bench.limits.speed_rad_s)
    for way, approach in zip(ways, approaches, strict=True):
        _refuse_unreachable(model, way[-1], approach, limits)
    speeds = zip(approaches, motion.speeds_rad_s, strict=True)
    slow = tuple(replace(one, travel_rad_s=min(one.travel_rad_s, speed)) for one, speed in speeds)
    return FacePlan(tuple(ways), slow, motion)


def _approach_to(
    bench: ProbeBench, rules: CornerRules, frame: Pose, face: FaceName, at: Triple
) -> ProbeApproach:
    away = frame.rotation_matrix() @ outward_in_frame(face, rules.corner)
    contact = np.array(_ball_centre(bench, rules, frame, face, at))
    return ProbeApproach(
        start_rad=_joints_for(bench, contact + rules.search_way_m * away),
        end_rad=_joints_for(bench, contact - rules.search_way_m * away),
        search_m_s=rules.search_speed_m_s,
        measure_m_s=rules.measure_speed_m_s,
        repeats=rules.repeats,
        retreat_m=rules.retreat_m,
    )


def _ball_centre(bench: ProbeBench, rules: CornerRules, frame: Pose, face: FaceName, at: Triple) -> Triple:
    """Return where the ball's centre is when it touches a face there."""
    local = np.array(at) + bench.radius_m * outward_in_frame(face, rules.corner)
    return _as_triple(frame.rotation_matrix() @ local + np.array(frame.position_m))


def _standoff_joints(
    bench: ProbeBench, rules: CornerRules, frame: Pose, face: FaceName, at: Triple
) -> Joints:
    away = frame.rotation_matrix() @ outward_in_frame(face, rules.corner)
    return _joints_for(bench, np.array(_ball_centre(bench, rules, frame, face, at)) + rules.clear_m * away)


def _corners_over(
    bench: ProbeBench, rules: CornerRules, frame: Pose, ends: tuple[Joints, Joints], *, first: bool
) -> tuple[Joints, ...]:
    """Return the corners of a way over the top from one face to another; none where an end is up there already."""
    height, corners = rules.clear_m + bench.radius_m, list[Joints]()
    for end in ends[1:] if first else ends:
        local = _tip_in_frame(bench, frame, end)
        if abs(local[2] - height) > 1e-4:
            lifted = np.array([local[0], local[1], height])
            corners.append(_joints_for(bench, frame.rotation_matrix() @ lifted + np.array(frame.position_m)))
    return tuple(corners)


def _tip_in_frame(bench: ProbeBench, frame: Pose, joints_rad: Joints) -> Array:
    """Return the tip (3,) seen from the frame."""
    tip = load_model(bench.model).tip_positions(np.array([joints_rad]), np.array(bench.tip_in_flange_m))[0]
    return np.asarray((tip - np.array(frame.position_m)) @ frame.rotation_matrix())


def _joints_for(bench: ProbeBench, tip_m: Array) -> Joints:
    try:
        found = joints_for_tip(load_model(bench.model), bench.tip_in_flange_m, bench.joints_rad, tip_m)
    except DegenerateDataError as error:
        x, y, z = tip_m * 1e3
        raise DegenerateDataError(
            make_message(
                "the tip cannot be brought to x {x:.0f}, y {y:.0f}, z {z:.0f} mm with the attitude in "
                "which it stands.",
                x=x,
                y=y,
                z=z,
            ),
            remedy="Give the frame as it is drawn (nominal), or turn the probe so that the whole corner is in reach.",
        ) from error
    return as_joints(np.array(found))


def _refuse_unfit(bench: ProbeBench, rules: CornerRules, nominal: Pose) -> None:
    """Refuse a ball that would meet an edge or the next face, and a stylus that lies along a face."""
    least = bench.radius_m + rules.search_way_m
    if min(rules.inset_m, rules.depth_m) <= least:
        raise DegenerateDataError(
            make_message(
                "inset_m and depth_m must be more than {least:.1f} mm, the ball's radius and "
                "search_way_m: the ball would meet an edge or the next face.",
                least=least * 1000.0,
            ),
            remedy="Feel farther from the edges, or search less far.",
        )
    axis = load_model(bench.model).base_flange(np.array([bench.joints_rad]))[0, :3, :3] @ bench.axis_in_flange
    lean = math.acos(float(np.clip(-axis @ nominal.rotation_matrix()[:, 2], -1.0, 1.0)))
    if lean > STEEPEST_RAD:
        raise DegenerateDataError(
            make_message(
                "the stylus stands {lean:.0f} deg from the first face's normal: its shank may touch.",
                lean=math.degrees(lean),
            ),
            remedy="Turn the probe so that it looks straight at the first face, its z towards you; then start a new "
            "run.",
        )


def _refuse_crossing(
    model: RobotModel,
    bench: ProbeBench,
    rules: CornerRules,
    frame: Pose,
    ways: Sequence[Sequence[Joints]],
) -> None:
    """Refuse ways on which the tip comes nearer to the corner than it may be off."""
    share = np.linspace(0.0, 1.0, _LOOKS)[:, None]
    legs = [(a, b) for way in ways for a, b in pairwise(way)]
    path = np.vstack([np.array(a) + share * (np.array(b) - np.array(a)) for a, b in legs])
    tips = model.tip_positions(path, np.array(bench.tip_in_flange_m))
    off = (tips - np.array(frame.position_m)) @ frame.rotation_matrix()
    heights = np.column_stack([off @ outward_in_frame(name, rules.corner) for name in FACES])
    nearest = heights.max(axis=1) if rules.corner == "outside" else heights.min(axis=1)
    least = bench.radius_m + rules.search_way_m
    if nearest.min() < least:
        raise DegenerateDataError(
            make_message(
                "the tip would pass the faces at {nearest:.1f} mm, {least:.1f} mm are kept.",
                nearest=nearest.min() * 1000.0,
                least=least * 1000.0,
            ),
            remedy="Bring the tip over the first face, well clear of it, then start a new run.",
        )


def _refuse_unreachable(
    model: RobotModel, hover_rad: Joints, approach: ProbeApproach, limits: MotionLimits
) -> None:
    """Refuse an approach that breaks a limit; there the tip comes near what it shall touch."""
    free = replace(limits, clearances=None)
    ends = np.array([approach.start_rad, approach.end_rad])
    refuse_broken(check_moves(model, hover_rad, ends, free, speed_rad_s=1e-3, stops=[True, True]))


def _as_triple(values: Array) -> Triple:
    x, y, z = (float(v) for v in values)
    return x, y, z
