"""Plans of a robot that has lost its position: one axis at a time, slowly, to where lengths tell its turns."""

import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.drawn_walk import DrawnWalk, drawn_walk
from cellcal.calibration.mastering.pose_design import candidate_joints, next_poses
from cellcal.calibration.mastering.recovery_walk import JogTiming, WalkPlanner, nearby_joints
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import MotionLimits, allowed_postures, check_moves
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.cell import MotionCaps as SpeedLimits
from cellcal.procedures.motion.approach import OVERSHOOT_RAD, from_above
from cellcal.procedures.motion.plan_ways import (
    allowed_start,
    as_joints,
    corners_allowed,
    corners_of,
    travel_order,
    walk_allowed,
    way_allowed,
)
from cellcal.procedures.motion.plans import MotionBounds, MotionPlan, checked_plan, motion_limits, timed_plan
from cellcal.procedures.motion.speed_limit import SpeedLimit as JogPace
from cellcal.procedures.motion.turn_uncertainty import Turns, lost_limits, posture_uncertainty
from cellcal.procedures.motors import MotorState
from cellcal.procedures.surroundings import clearance_check

SAME_POSE_RAD = 0.02
SPARE_CANDIDATES = 60
NEARBY_CANDIDATES = (
    2500  # among few of them none may be near that shows what is sought: a robot then goes far
)
QUICK_EFOLD_S, THOROUGH_EFOLD_S = 200.0, 800.0  # of robot time for one e-fold of one motor's certainty
QUICK_CAPTURES = 16  # who is not sure after these looks for better poses, also far away
FINER_GAIN = 0.15  # e-folds of all motors together: below this another capture is not worth its time
# Each brings two walks. One of the first is nearly always allowed; where the wire soon winds up too far, as few
# as a quarter are.
_SEEDS_TRIED = 8


def jogging_timing(model: str, limits: SpeedLimits, room: MotionBounds) -> JogPace:
    """Return the pace of turns of single axes, while a robot does not know where it is."""
    return JogPace(model, (0.0, 0.0, 0.0), limits.jog_speed_rad_s, room.capped_tip_speed_m_s)


def plan_first(
    record: MasteringRecord,
    state: MotorState,
    room: MotionBounds,
    here_rad: Joints,
    poses: int,
    doubt_turns: Turns,
) -> MotionPlan:
    """Plan the first captures after a loss: a short walk that tells every motor's turns."""
    model, limits = load_model(record.model), lost_limits(state, record, room, doubt_turns)
    planner = walk_planner(model, record, limits, state)
    here = np.array(here_rad)
    walk = _find_first_walk(planner, here, poses, limits)
    if not walk:
        raise unreachable_error(here, limits)
    return timed_plan(model, here_rad, walk, limits, state.limits.jog_speed_rad_s, one_by_one=True)


def _find_first_walk(planner: WalkPlanner, here: Array, poses: int, limits: MotionLimits) -> list[Array]:
    """Return a planned walk that is allowed as a whole; else the longest start of one, or of the record's poses.

    What the start leaves open, later captures one at a time decide.
    """
    model, record = planner.model, planner.record
    refused: list[list[Array]] = []
    for seed in range(_SEEDS_TRIED):
        for planned in planner.plan_walks(here, poses, seed=seed):
            walk = list(planned)
            if walk_allowed(model, here, walk, limits):
                return walk
            refused.append(walk)
    kit = record.capture_joints_rad()
    order = next_poses(model, record, np.empty((0, model.axis_count)), kit, min(poses, len(kit)))
    known = travel_order(model, as_joints(here), kit[list(order)], limits, one_by_one=True)
    return max(known, *(allowed_start(model, here, walk, limits) for walk in refused), key=len)


def plan_next(
    record: MasteringRecord,
    state: MotorState,
    room: MotionBounds,
    here_rad: Joints,
    measured: tuple[Joints, ...],
    doubt_turns: Turns,
) -> MotionPlan:
    """Plan one more capture: the reachable pose that tells most for the time it takes, given what is measured."""
    search = _NextPose(record, state, room, here_rad, measured, doubt_turns)
    plan = search.plan_best(QUICK_EFOLD_S if len(measured) < QUICK_CAPTURES else THOROUGH_EFOLD_S)
    if plan is None:
        raise unreachable_error(np.array(here_rad), search.motion_limits())
    return plan


def plan_finer(
    record: MasteringRecord,
    state: MotorState,
    room: MotionBounds,
    here_rad: Joints,
    measured: tuple[Joints, ...],
    doubt_turns: Turns,
) -> MotionPlan | None:
    """Plan one more capture for offsets that are no whole turns, or none where no pose makes them much surer."""
    return _NextPose(record, state, room, here_rad, measured, doubt_turns).plan_best(
        THOROUGH_EFOLD_S, least_gain=FINER_GAIN
    )


@dataclass(frozen=True)
class _NextPose:
    """The search for one more pose."""

    record: MasteringRecord
    state: MotorState
    room: MotionBounds
    here_rad: Joints
    measured: tuple[Joints, ...]
    doubt_turns: Turns

    def motion_limits(self) -> MotionLimits:
        """Return what each way keeps."""
        return lost_limits(self.state, self.record, self.room, self.doubt_turns)

    def plan_best(self, efold_s: float, *, least_gain: float = 0.0) -> MotionPlan | None:
        """Return a plan of the best pose that is worth it and can be reached."""
        record, speed = self.record, self.state.limits.jog_speed_rad_s
        model, limits = load_model(record.model), self.motion_limits()
        here = np.array(self.here_rad)
        measured_rad = np.array(self.measured).reshape(-1, model.axis_count)
        near = nearby_joints(here, NEARBY_CANDIDATES, seed=3)
        found = unmeasured_postures(candidate_postures(model, record, limits, near), self.measured)
        planner = walk_planner(model, record, limits, self.state)
        worth, gain = planner.rate_candidates(here, measured_rad, found, efold_s=efold_s)
        for index in np.argsort(-worth):
            if gain[index] >= least_gain and way_allowed(model, here, found[index], limits, one_by_one=True):
                return timed_plan(model, self.here_rad, [found[index]], limits, speed, one_by_one=True)
        return None


@dataclass(frozen=True, slots=True)
class FinalPlan:
    """Check poses gone to again, and which of them from the other side."""

    motion: MotionPlan
    other_side: tuple[bool, ...]


def plan_finals(
    record: MasteringRecord,
    state: MotorState,
    room: MotionBounds,
    checks: tuple[Joints, ...],
    poses: int,
    doubt_turns: Turns,
) -> FinalPlan:
    """Plan joint moves from the last check pose to earlier ones; where none is reachable, look from there.

    All but the first come from the other side where the way beyond the pose is free.
    """
    model, limits = load_model(record.model), lost_limits(state, record, room, doubt_turns)
    here = np.array(checks[-1])
    earlier = np.array(checks[:-1]).reshape(-1, model.axis_count)
    ordered = travel_order(model, checks[-1], earlier, limits)[:poses] or [here]
    ways: list[Array] = []
    sides: list[bool] = []
    at = here
    for pose in ordered:
        above = np.array(from_above(as_joints(at), as_joints(pose)))
        sides.append(bool(ways) and corners_allowed(model, here, [*ways, above], limits))
        ways.append(above if sides[-1] else corners_of(at, pose, False))
        at = pose
    return FinalPlan(
        checked_plan(model, checks[-1], ways, limits, state.limits.jog_speed_rad_s), tuple(sides)
    )


def compare_drawn(
    record: MasteringRecord, state: MotorState, room: MotionBounds, measured: tuple[Joints, ...]
) -> DrawnWalk | None:
    """Compare the captures of a recovery with evenly drawn ones; None where there is no walk to compare."""
    if len(measured) < 2:
        return None
    model, limits = load_model(record.model), motion_limits(state, record.drive, room)
    walked = np.array(measured)
    return drawn_walk(model, record, limits, walked[0], walked)


def index_travel(
    record: MasteringRecord, here_rad: Joints, turns: float, room: MotionBounds, doubt_turns: Turns
) -> Joints:
    """Return by how much to turn each joint so that its motor passes its index: towards mid-range, if that is free.

    Where neither way is, the gate says at the turn what is in it.
    """
    model = load_model(record.model)
    low, high = room.box_m()
    limits = MotionLimits(
        joint_margin_rad=0.0,
        tip_speed_m_s=math.inf,
        box_low_m=low,
        box_high_m=high,
        clearances=clearance_check(record.model, room.surroundings),
        position_uncertainty=posture_uncertainty(record.drive, doubt_turns),
    )
    middle = (model.lower_rad + model.upper_rad) / 2.0
    per_turn = np.abs(np.diag(record.drive.radians_per_turn())) * turns
    here, travel = np.array(here_rad), np.where(np.array(here_rad) > middle, -per_turn, per_turn)
    for axis in range(model.axis_count):
        for turn in (travel[axis], -travel[axis]):
            beyond = turn if turn > 0 else turn - OVERSHOOT_RAD
            there = here + np.eye(model.axis_count)[axis] * beyond
            verdict = check_moves(model, here, there[None], limits, speed_rad_s=1e-3, stops=[False])
            if verdict.allowed:
                travel[axis] = turn
                break
        here = here + np.eye(model.axis_count)[axis] * travel[axis]
    return tuple(float(v) for v in travel)


def walk_planner(
    model: RobotModel, record: MasteringRecord, limits: MotionLimits, state: MotorState
) -> WalkPlanner:
    """Return what compares walks of this robot by what they tell and the time they take."""
    hook = record.wire_lengths()[1].hook_in_flange_m
    pace = JogTiming(speed_rad_s=state.limits.jog_speed_rad_s, settle_s=state.limits.settle_s)
    return WalkPlanner(model, record, lambda joints: allowed_postures(model, joints, limits, hook), pace)


def candidate_postures(
    model: RobotModel, record: MasteringRecord, limits: MotionLimits, near: Array
) -> Array:
    """Return postures to choose from: those (M, n) [rad] drawn near that are allowed, the record's, and others."""
    hook = record.wire_lengths()[1].hook_in_flange_m
    near = near[allowed_postures(model, near, limits, hook)]
    spread = candidate_joints(model, limits, SPARE_CANDIDATES, seed=2, hook_in_flange_m=hook)
    return np.vstack([near, record.capture_joints_rad(), spread])


def unmeasured_postures(candidates: Array, measured: tuple[Joints, ...]) -> Array:
    """Return those (M, n) of the candidates (N, n) [rad] at which nothing was measured yet."""
    if not measured:
        return candidates
    apart = np.abs(candidates[:, None, :] - np.array(measured)[None]).max(axis=2).min(axis=1)
    unmeasured: Array = candidates[apart > SAME_POSE_RAD]
    return unmeasured


def unreachable_error(here: Array, limits: MotionLimits) -> DegenerateDataError:
    """Say that no pose can be reached, and what is too near where the arm stands, if it is that."""
    why, remedy = _collision_text(here, limits), "Jog the robot towards the middle of its range, then resume."
    message = "none of the poses still needed can be reached from here without breaking a limit"
    return DegenerateDataError(
        make_message("{message}: {why}", message=message, why=why) if why else message,
        remedy=remedy,
    )


def _collision_text(here: Array, limits: MotionLimits) -> str:
    near = (
        None
        if limits.clearances is None
        else limits.clearances.compute_clearances(here[None], limits.position_uncertainty)
    )
    if near is None or not near.is_broken()[0]:
        return ""
    k = int(np.argmax(near.excess[0]))
    apart_mm, kept_mm = 1e3 * near.found[0, k], 1e3 * near.limit[0, k]
    doubt_mm = 0.0 if near.uncertainty is None else 1e3 * near.uncertainty[0, k]
    return make_message(
        "{quantity_names}: {apart_mm:.0f} mm, {kept_mm:.0f} mm are kept, {doubt_mm:.0f} mm of "
        "them for turns that are not known yet",
        quantity_names=near.quantity_names[k],
        apart_mm=apart_mm,
        kept_mm=kept_mm,
        doubt_mm=doubt_mm,
    )
