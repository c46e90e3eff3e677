"""Plans of motion as pure functions: which poses, in which order, how fast. Plans are shown, then obeyed."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from calibration.errors import DegenerateDataError
from calibration.geometry import Array
from calibration.kinematics import RobotModel, load_model
from calibration.mastering import DriveTrain, MasteringRecord
from calibration.motion_check import MotionLimits, WirePath, check_moves
from calibration.pose_design import candidate_joints, kit_poses, next_poses
from calibration.turn_recovery import verification_power
from calibration.wire_model import WirePrior
from drivers.interfaces import Joints
from procedures.steps.mastering import MotorState

Triple = tuple[float, float, float]
VERIFICATION_SIGMAS = 6.0
SAME_POSE_RAD = 0.02
SPARE_CANDIDATES = 60


@dataclass(frozen=True, slots=True)
class Room:
    """What motion must keep to, and how far a lost robot may be from where it seems to be."""

    lost_turns: Annotated[int, Field(ge=0, le=50)] = 2
    tip_speed_m_s: Annotated[float, Field(gt=0, le=0.25)] = 0.05  # no faster than a robot is taught by hand
    wire_low: Annotated[float, Field(ge=0, lt=1)] = 0.08  # of the range; a lost robot needs more room
    wire_high: Annotated[float, Field(gt=0, le=1)] = 0.92
    box_low_m: Triple | None = None
    box_high_m: Triple | None = None


@dataclass(frozen=True, slots=True)
class MotionPlan:
    """Poses in the order of travel, the speed that keeps every cap, and what nobody checked."""

    poses_rad: tuple[Joints, ...]
    speed_rad_s: float
    travel_rad: float  # of the slowest axis, added over all moves
    not_checked: tuple[str, ...]


def wire_prior(state: MotorState) -> WirePrior:
    """Return what the cell file says about the wire."""
    at = state.gauge_setup
    return WirePrior(
        anchor_in_base_m=at.anchor_in_base_m,
        hook_in_flange_m=at.hook_in_flange_m,
        sigma_anchor_m=at.sigma_anchor_m,
        sigma_hook_m=at.sigma_hook_m,
    )


def motion_limits(state: MotorState, drive: DriveTrain, room: Room) -> MotionLimits:
    """Return the limits of motion while up to ``room.lost_turns`` turns of every motor are unknown."""
    doubt = room.lost_turns * np.abs(drive.radians_per_turn()).sum(axis=1)
    at = state.gauge_setup
    wire = WirePath(
        at.anchor_in_base_m,
        at.hook_in_flange_m,
        state.gauge_range_m,
        lowest_fraction=room.wire_low,
        highest_fraction=room.wire_high,
    )
    return MotionLimits(
        mastering_uncertainty_rad=tuple(float(v) for v in doubt),
        joint_speed_rad_s=state.limits.speed_rad_s,
        tip_speed_m_s=room.tip_speed_m_s,
        box_low_m=room.box_low_m,
        box_high_m=room.box_high_m,
        wire=wire,
    )


def plan_kit(state: MotorState, room: Room, poses: int, seed: int) -> MotionPlan:
    """Plan the captures of a mastering record from where the robot stands."""
    model, limits = load_model(state.model), motion_limits(state, state.drive, room)
    kit = kit_poses(model, state.drive, wire_prior(state), limits, poses, seed=seed)
    ordered = _travel_order(model, state.joints_rad, kit, limits)
    if len(ordered) < min(poses, model.axes + 8):
        raise DegenerateDataError(
            f"only {len(ordered)} of {poses} planned poses can be reached without breaking a limit",
            remedy="Move the robot nearer to the middle of its range, or move the wire's anchor.",
        )
    return _timed(model, state.joints_rad, ordered, limits, state.limits.speed_rad_s)


def plan_first(
    record: MasteringRecord, state: MotorState, room: Room, here_rad: Joints, poses: int
) -> MotionPlan:
    """Plan the first captures after a loss: the record's poses that tell most about the turns."""
    model, limits = load_model(record.model), motion_limits(state, record.drive, room)
    kit = record.capture_joints_rad()
    order = next_poses(model, record, np.empty((0, model.axes)), kit, min(poses, len(kit)))
    ordered = _travel_order(model, here_rad, kit[list(order)], limits, one_by_one=True)
    if not ordered:
        raise _unreachable()
    return _timed(model, here_rad, ordered, limits, state.limits.jog_speed_rad_s, one_by_one=True)


def plan_next(
    record: MasteringRecord, state: MotorState, room: Room, here_rad: Joints, measured: tuple[Joints, ...]
) -> MotionPlan:
    """Plan one more capture: the reachable pose that tells most, given what is measured."""
    model, limits = load_model(record.model), motion_limits(state, record.drive, room)
    candidates = _unmeasured(_candidates(model, record, limits), measured)
    for index in next_poses(model, record, np.array(measured), candidates, len(candidates)):
        target = candidates[index]
        if _allowed(model, here_rad, target, limits, one_by_one=True):
            return _timed(model, here_rad, [target], limits, state.limits.jog_speed_rad_s, one_by_one=True)
    raise _unreachable()


def plan_checks(
    record: MasteringRecord,
    state: MotorState,
    room: Room,
    here_rad: Joints,
    measured: tuple[Joints, ...],
    poses: int,
) -> MotionPlan:
    """Plan check captures at poses not fitted, which together see a wrong turn of every motor."""
    model, limits = load_model(record.model), motion_limits(state, record.drive, room)
    candidates = _unmeasured(_candidates(model, record, limits), measured)
    power = verification_power(model, record, candidates) / VERIFICATION_SIGMAS
    chosen: list[int] = []
    while len(chosen) < min(poses, len(candidates)):
        seen = power[chosen].max(axis=0) if chosen else np.zeros(model.axes)
        gain = np.minimum(np.maximum(power, seen), 2.0).sum(axis=1)
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
    ordered = _travel_order(model, here_rad, candidates[chosen], limits, one_by_one=True)
    if not ordered:
        raise _unreachable()
    return _timed(model, here_rad, ordered, limits, state.limits.jog_speed_rad_s, one_by_one=True)


def plan_finals(
    record: MasteringRecord, state: MotorState, room: Room, checks: tuple[Joints, ...], poses: int
) -> MotionPlan:
    """Plan joint moves from the last check pose to earlier ones; where none is reachable, look from there."""
    model, limits = load_model(record.model), motion_limits(state, record.drive, room)
    here = checks[-1]
    ordered = _travel_order(model, here, np.array(checks[:-1]).reshape(-1, model.axes), limits)[:poses]
    return _timed(model, here, ordered or [np.array(here)], limits, state.limits.jog_speed_rad_s)


def index_travel(record: MasteringRecord, here_rad: Joints, turns: float) -> Joints:
    """Return by how much to turn each joint so that its motor passes its index, towards mid-range."""
    model = load_model(record.model)
    middle = (model.lower_rad + model.upper_rad) / 2.0
    per_turn = np.abs(np.diag(record.drive.radians_per_turn()))
    signs = np.where(np.array(here_rad) > middle, -1.0, 1.0)
    return tuple(float(v) for v in signs * per_turn * turns)


def _candidates(model: RobotModel, record: MasteringRecord, limits: MotionLimits) -> Array:
    extra = candidate_joints(
        model, limits, SPARE_CANDIDATES, seed=2, hook_in_flange_m=record.prior.hook_in_flange_m
    )
    return np.vstack([record.capture_joints_rad(), extra])


def _unmeasured(candidates: Array, measured: tuple[Joints, ...]) -> Array:
    if not measured:
        return candidates
    apart = np.abs(candidates[:, None, :] - np.array(measured)[None]).max(axis=2).min(axis=1)
    unmeasured: Array = candidates[apart > SAME_POSE_RAD]
    return unmeasured


def _travel_order(
    model: RobotModel, start_rad: Joints, poses: Array, limits: MotionLimits, *, one_by_one: bool = False
) -> list[Array]:
    """Order poses by nearest neighbour along allowed ways; poses that cannot be reached are left out."""
    here, left, ordered = np.array(start_rad), list(poses), []
    while left:
        left.sort(key=lambda pose: _travel(here, pose, one_by_one))
        reachable = (
            k for k, pose in enumerate(left) if _allowed(model, here, pose, limits, one_by_one=one_by_one)
        )
        nearest = next(reachable, None)
        if nearest is None:
            break
        here = left.pop(nearest)
        ordered.append(here)
    return ordered


def _travel(here: Array, there: Array, one_by_one: bool) -> float:
    apart = np.abs(there - here)
    return float(apart.sum() if one_by_one else apart.max())


def _ways(here: Array, there: Array, one_by_one: bool) -> Array:
    """Return the corners of the way: all joints at once, or one after the other."""
    if not one_by_one:
        return there[None]
    return np.array([np.concatenate([there[: k + 1], here[k + 1 :]]) for k in range(len(there))])


def _allowed(
    model: RobotModel, here: Array | Joints, there: Array, limits: MotionLimits, *, one_by_one: bool
) -> bool:
    start = np.array(here)
    ways = _ways(start, there, one_by_one)
    stops = [False] * (len(ways) - 1) + [True]
    return check_moves(model, start, ways, limits, speed_rad_s=1e-3, stops=stops).allowed


def _timed(
    model: RobotModel,
    start_rad: Joints,
    poses: list[Array],
    limits: MotionLimits,
    speed_rad_s: float,
    *,
    one_by_one: bool = False,
) -> MotionPlan:
    corners, here, travel = [], np.array(start_rad), 0.0
    for pose in poses:
        corners.append(_ways(here, pose, one_by_one))
        travel += _travel(here, pose, one_by_one)
        here = pose
    verdict = check_moves(model, start_rad, np.concatenate(corners), limits, speed_rad_s=speed_rad_s)
    fastest = max((f.found / f.limit for f in verdict.findings if f.check == "tip speed"), default=1.0)
    return MotionPlan(
        poses_rad=tuple(tuple(float(v) for v in pose) for pose in poses),
        speed_rad_s=speed_rad_s / (fastest * 1.01) if fastest > 1.0 else speed_rad_s,
        travel_rad=travel,
        not_checked=verdict.not_checked,
    )


def _unreachable() -> DegenerateDataError:
    return DegenerateDataError(
        "none of the poses still needed can be reached from here without breaking a limit",
        remedy="Jog the robot towards the middle of its range, then resume.",
    )
