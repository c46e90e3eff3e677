"""Plans of motion as pure functions: which poses, in which order, how fast. Plans are shown, then obeyed."""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
from pydantic import Field

from calibration.arm.kinematics import RobotModel, load_model
from calibration.errors import DegenerateDataError
from calibration.geometry import Array
from calibration.mastering.counts import DriveTrain, MasteringRecord
from calibration.mastering.drawn_walk import DrawnWalk, drawn_walk
from calibration.mastering.pose_design import candidate_joints, kit_poses, next_poses
from calibration.mastering.recovery_walk import Pace, WalkPlanner, nearby_joints
from calibration.mastering.turn_recovery import TurnRecovery, verification_power
from calibration.motion.doubt import PostureDoubt
from calibration.motion.motion_check import (
    MotionLimits,
    WirePath,
    allowed_postures,
    check_moves,
    seem_free,
)
from calibration.uncertainty import chi_square_limit
from calibration.wires.model import WirePrior
from drivers.interfaces import Joints
from procedures.motion.approach import OVERSHOOT_RAD, from_above
from procedures.motion.detours import ways_through
from procedures.motion.plan_ways import (
    arrive,
    as_joints,
    as_way,
    corners_allowed,
    corners_of,
    refuse_broken,
    travel_order,
    walk_allowed,
    way_allowed,
    wire_has_side,
)
from procedures.motion.surroundings import NOTHING_KNOWN, Surroundings, clearances
from procedures.steps.mastering import MotorState

Triple = tuple[float, float, float]
Turns = tuple[float, ...]
HALF_TURN = (
    0.5  # of each motor, brakes shut since its last healthy count: one that moved further is counted wrongly
)
SURE_SIGMAS = 4.0
VERIFICATION_SIGMAS = 6.0
SAME_POSE_RAD = 0.02
SPARE_CANDIDATES = 60
NEARBY_CANDIDATES = 300
QUICK_EFOLD_S, THOROUGH_EFOLD_S = 200.0, 800.0  # of robot time for one e-fold of one motor's certainty
QUICK_CAPTURES = 16  # who is not sure after these looks for better poses, also far away
FINER_GAIN = 0.15  # e-folds of all motors together: below this another capture is not worth its time
_SEEDS_TRIED, _CHOICES_TRIED = 2, 8


@dataclass(frozen=True, slots=True)
class Room:
    """What motion must keep to, and how far a lost robot may be from where it seems to be."""

    lost_turns: Annotated[int, Field(ge=0, le=50)] = 2
    tip_speed_m_s: Annotated[float, Field(gt=0, le=0.25)] = 0.05  # no faster than a robot is taught by hand
    wire_low: Annotated[float, Field(ge=0, lt=1)] = 0.08  # of the range; a lost robot needs more room
    wire_high: Annotated[float, Field(gt=0, le=1)] = 0.92
    box_low_m: Triple | None = None
    box_high_m: Triple | None = None
    surroundings: Surroundings = NOTHING_KNOWN  # of the cell file

    def __post_init__(self) -> None:
        if self.wire_low >= self.wire_high:
            raise ValueError("wire_low must be below wire_high: no pose has its wire between them")
        low, high = self.box_m()
        if low is not None and high is not None and any(a >= b for a, b in zip(low, high, strict=True)):
            raise ValueError("box_low_m must be below box_high_m in x, y and z: no pose lies between them")

    @property
    def capped_tip_speed_m_s(self) -> float:
        """The cap that holds here: half of it while nobody knows what stands in the cell."""
        return self.tip_speed_m_s * self.surroundings.speed_share

    def box_m(self) -> tuple[Triple | None, Triple | None]:
        """Return the corners of the workspace: of the run, or else of the cell file."""
        known = self.surroundings
        return (self.box_low_m or known.box_low_m, self.box_high_m or known.box_high_m)


@dataclass(frozen=True, slots=True)
class MotionPlan:
    """Poses in the order of travel, the speeds that keep every cap, and what nobody checked."""

    poses_rad: tuple[Joints, ...]
    speed_rad_s: float  # of the slowest way: it keeps the caps on every one
    travel_rad: float  # of the slowest axis, added over all moves
    not_checked: tuple[str, ...]
    ways_rad: tuple[
        tuple[Joints, ...], ...
    ] = ()  # to each pose, with the corners in between; empty: straight
    speeds_rad_s: tuple[float, ...] = ()  # of each way, as fast as its own corners allow
    moving_s: float = 0.0  # with each way at its own speed
    doubt: PostureDoubt | None = None  # about where the arm stands: kept again right before each move


@dataclass(frozen=True, slots=True)
class Known:
    """What a recovery knows when it plans its checks."""

    here_rad: Joints
    visited: tuple[Joints, ...]
    checked: tuple[Joints, ...]
    offset_covariance: tuple[tuple[float, ...], ...]  # turns^2
    doubt_turns: Turns = ()  # of each motor; none: what the covariance leaves


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
    low, high = room.box_m()
    return MotionLimits(
        mastering_uncertainty_rad=tuple(float(v) for v in doubt),
        joint_speed_rad_s=state.limits.speed_rad_s,
        tip_speed_m_s=room.capped_tip_speed_m_s,
        box_low_m=low,
        box_high_m=high,
        wire=wire,
        clearances=clearances(state.model, room.surroundings, wire),
    )


def first_doubt(room: Room, axes: int, *, seen: bool) -> Turns:
    """Return how far each motor may stand from where it is thought [turns], before anything is measured.

    ``seen``: its last healthy counts are known. Else a person brought the arm near its reference by the marks.
    """
    return (min(float(room.lost_turns), HALF_TURN) if seen else float(room.lost_turns),) * axes


def doubt_after(recovery: TurnRecovery, guess: tuple[int, ...], before: Turns) -> Turns:
    """Return the doubt that captures leave [turns]: how far off they find the guess, and how surely.

    Captures that do not fit their best explanation take no doubt away.
    """
    if recovery.mode == "geometry" or recovery.chi_square > chi_square_limit(recovery.degrees_of_freedom):
        return before
    left = np.abs(np.subtract(recovery.offset_turns, guess)) + SURE_SIGMAS * np.array(recovery.sigma_turns)
    return tuple(float(v) for v in np.minimum(before, left))


def posture_doubt(drive: DriveTrain, turns: Turns) -> PostureDoubt:
    """Return by how much each joint may stand elsewhere, for doubts of its motors and those that turn it too.

    The draw-wire passes so near the wrist that it could keep no distance at two turns of every motor: it keeps
    that for half a turn.
    """
    per_turn = np.abs(drive.radians_per_turn())
    bodies, wire = per_turn @ np.array(turns), per_turn @ np.minimum(turns, HALF_TURN)
    return PostureDoubt(tuple(float(v) for v in bodies), tuple(float(v) for v in wire))


def _lost_limits(state: MotorState, record: MasteringRecord, room: Room, turns: Turns) -> MotionLimits:
    """Return the limits of motion of a robot whose motors may stand so many turns from where they are thought."""
    return replace(motion_limits(state, record.drive, room), doubt=posture_doubt(record.drive, turns))


def plan_kit(state: MotorState, room: Room, poses: int, seed: int) -> MotionPlan:
    """Plan the captures of a mastering record from where the robot stands."""
    model, limits = load_model(state.model), motion_limits(state, state.drive, room)
    here = np.array(state.joints_rad)
    kit = kit_poses(
        model,
        state.drive,
        wire_prior(state),
        limits,
        poses,
        seed=seed,
        usable=lambda drawn: np.logical_and.reduce(
            [seem_free(model, here, drawn, limits), wire_has_side(model, drawn, limits)]
        ),
    )
    ways = ways_through(state.joints_rad, kit, partial(arrive, model, limits))
    if len(ways) < min(poses, model.axes + 6):
        raise DegenerateDataError(
            f"only {len(ways)} of {poses} planned poses can be reached without breaking a limit",
            remedy="Move the robot nearer to the middle of its range, or move the wire's anchor.",
        )
    before, gone = here, []
    for way in ways:
        before = way[-2] if len(way) > 1 else before
        gone.append(np.array([*way[:-1], *corners_of(before, way[-1], False)]))
        before = way[-1]
    plan = checked(model, state.joints_rad, gone, limits, state.limits.speed_rad_s)
    return replace(plan, ways_rad=tuple(map(as_way, ways)))


def plan_first(
    record: MasteringRecord,
    state: MotorState,
    room: Room,
    here_rad: Joints,
    poses: int,
    doubt_turns: Turns,
) -> MotionPlan:
    """Plan the first captures after a loss: a short walk that tells every motor's turns."""
    model, limits = load_model(record.model), _lost_limits(state, record, room, doubt_turns)
    planner = _walks(model, record, limits, state)
    here = np.array(here_rad)
    for tried in (walk for seed in range(_SEEDS_TRIED) for walk in planner.walks(here, poses, seed=seed)):
        walk = list(tried)
        if walk_allowed(model, here, walk, limits):
            break
    else:  # hard by a limit: the record's own poses, as many as can be reached
        kit = record.capture_joints_rad()
        order = next_poses(model, record, np.empty((0, model.axes)), kit, min(poses, len(kit)))
        walk = travel_order(model, here_rad, kit[list(order)], limits, one_by_one=True)
    if not walk:
        raise _unreachable(here, limits)
    return _timed(model, here_rad, walk, limits, state.limits.jog_speed_rad_s, one_by_one=True)


def plan_next(
    record: MasteringRecord,
    state: MotorState,
    room: Room,
    here_rad: Joints,
    measured: tuple[Joints, ...],
    doubt_turns: Turns,
) -> MotionPlan:
    """Plan one more capture: the reachable pose that tells most for the time it takes, given what is measured."""
    search = _NextPose(record, state, room, here_rad, measured, doubt_turns)
    plan = search.best(QUICK_EFOLD_S if len(measured) < QUICK_CAPTURES else THOROUGH_EFOLD_S)
    if plan is None:
        raise _unreachable(np.array(here_rad), search.limits())
    return plan


def plan_finer(
    record: MasteringRecord,
    state: MotorState,
    room: Room,
    here_rad: Joints,
    measured: tuple[Joints, ...],
    doubt_turns: Turns,
) -> MotionPlan | None:
    """Plan one more capture for offsets that are no whole turns, or none where no pose makes them much surer."""
    return _NextPose(record, state, room, here_rad, measured, doubt_turns).best(
        THOROUGH_EFOLD_S, least_gain=FINER_GAIN
    )


@dataclass(frozen=True)
class _NextPose:
    """The search for one more pose."""

    record: MasteringRecord
    state: MotorState
    room: Room
    here_rad: Joints
    measured: tuple[Joints, ...]
    doubt_turns: Turns

    def limits(self) -> MotionLimits:
        """Return what each way keeps."""
        return _lost_limits(self.state, self.record, self.room, self.doubt_turns)

    def best(self, efold_s: float, *, least_gain: float = 0.0) -> MotionPlan | None:
        """Return a plan of the best pose that is worth it and can be reached."""
        record, speed = self.record, self.state.limits.jog_speed_rad_s
        model, limits = load_model(record.model), self.limits()
        here = np.array(self.here_rad)
        known = np.array(self.measured).reshape(-1, model.axes)
        candidates = _unmeasured(_candidates(model, record, limits, here), self.measured)
        walks = _walks(model, record, limits, self.state)
        worth, gain = walks.worth(here, known, candidates, efold_s=efold_s)
        for index in np.argsort(-worth):
            if gain[index] >= least_gain and way_allowed(
                model, here, candidates[index], limits, one_by_one=True
            ):
                return _timed(model, self.here_rad, [candidates[index]], limits, speed, one_by_one=True)
        return None


def plan_checks(
    record: MasteringRecord,
    state: MotorState,
    room: Room,
    known: Known,
    poses: int,
    sigmas: float = VERIFICATION_SIGMAS,
) -> MotionPlan:
    """Plan check captures at poses not fitted, which together see a wrong turn of every one and two motors.

    ``sigmas`` are the deviations at which a wrong turn shall show; where more are wanted than for whole turns, a
    fraction of a turn is sought, and the captures are judged all together.
    """
    turns = known.doubt_turns or sure_to(known.offset_covariance)
    model, limits = load_model(record.model), _lost_limits(state, record, room, turns)
    here = np.array(known.here_rad)
    candidates = _unmeasured(_candidates(model, record, limits, here), known.visited)
    both = np.vstack([np.array(known.checked).reshape(-1, model.axes), candidates])
    power = verification_power(model, record, both, known.offset_covariance) / sigmas
    shown, power = power[: len(known.checked)], power[len(known.checked) :]
    together = sigmas > VERIFICATION_SIGMAS
    seen = np.sqrt(np.sum(shown**2, axis=0)) if together else shown.max(axis=0, initial=0.0)
    walks = _walks(model, record, limits, state)
    ordered: list[Array] = []
    for _ in range(_CHOICES_TRIED):  # the best that can be reached, where some of the best cannot
        chosen = walks.quick_checks(here, candidates, power, seen, poses, together=together)
        ordered = travel_order(model, known.here_rad, candidates[chosen], limits, one_by_one=True)
        if len(ordered) == len(chosen):
            break
        out_of_reach = [k for k in chosen if not any(np.array_equal(candidates[k], pose) for pose in ordered)]
        candidates, power = (
            np.delete(candidates, out_of_reach, axis=0),
            np.delete(power, out_of_reach, axis=0),
        )
    if not ordered:
        raise _unreachable(here, limits)
    return _timed(model, known.here_rad, ordered, limits, state.limits.jog_speed_rad_s, one_by_one=True)


def sure_to(covariance: tuple[tuple[float, ...], ...]) -> Turns:
    """Return how far each motor may be from where a solution puts it [turns]."""
    return tuple(float(v) for v in SURE_SIGMAS * np.sqrt(np.diag(np.array(covariance))))


@dataclass(frozen=True, slots=True)
class FinalPlan:
    """Check poses gone to again, and which of them from the other side."""

    motion: MotionPlan
    other_side: tuple[bool, ...]


def plan_finals(
    record: MasteringRecord,
    state: MotorState,
    room: Room,
    checks: tuple[Joints, ...],
    poses: int,
    doubt_turns: Turns,
) -> FinalPlan:
    """Plan joint moves from the last check pose to earlier ones; where none is reachable, look from there.

    All but the first come from the other side where the way beyond the pose is free.
    """
    model, limits = load_model(record.model), _lost_limits(state, record, room, doubt_turns)
    here = np.array(checks[-1])
    earlier = np.array(checks[:-1]).reshape(-1, model.axes)
    ordered = travel_order(model, checks[-1], earlier, limits)[:poses] or [here]
    ways: list[Array] = []
    sides: list[bool] = []
    at = here
    for pose in ordered:
        above = np.array(from_above(as_joints(at), as_joints(pose)))
        sides.append(bool(ways) and corners_allowed(model, here, [*ways, above], limits))
        ways.append(above if sides[-1] else corners_of(at, pose, False))
        at = pose
    return FinalPlan(checked(model, checks[-1], ways, limits, state.limits.jog_speed_rad_s), tuple(sides))


def compare_drawn(
    record: MasteringRecord, state: MotorState, room: Room, measured: tuple[Joints, ...]
) -> DrawnWalk | None:
    """Compare the captures of a recovery with evenly drawn ones; None where there is no walk to compare."""
    if len(measured) < 2:
        return None
    model, limits = load_model(record.model), motion_limits(state, record.drive, room)
    walked = np.array(measured)
    return drawn_walk(model, record, limits, walked[0], walked)


def index_travel(
    record: MasteringRecord, here_rad: Joints, turns: float, room: Room, doubt_turns: Turns
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
        clearances=clearances(record.model, room.surroundings),
        doubt=posture_doubt(record.drive, doubt_turns),
    )
    middle = (model.lower_rad + model.upper_rad) / 2.0
    per_turn = np.abs(np.diag(record.drive.radians_per_turn())) * turns
    here, travel = np.array(here_rad), np.where(np.array(here_rad) > middle, -per_turn, per_turn)
    for axis in range(model.axes):
        for turn in (travel[axis], -travel[axis]):
            beyond = turn if turn > 0 else turn - OVERSHOOT_RAD
            there = here + np.eye(model.axes)[axis] * beyond
            verdict = check_moves(model, here, there[None], limits, speed_rad_s=1e-3, stops=[False])
            if verdict.allowed:
                travel[axis] = turn
                break
        here = here + np.eye(model.axes)[axis] * travel[axis]
    return tuple(float(v) for v in travel)


def _walks(
    model: RobotModel, record: MasteringRecord, limits: MotionLimits, state: MotorState
) -> WalkPlanner:
    hook = record.lengths()[1].hook_in_flange_m
    pace = Pace(speed_rad_s=state.limits.jog_speed_rad_s, settle_s=state.limits.settle_s)
    return WalkPlanner(model, record, lambda joints: allowed_postures(model, joints, limits, hook), pace)


def _candidates(model: RobotModel, record: MasteringRecord, limits: MotionLimits, here: Array) -> Array:
    hook = record.lengths()[1].hook_in_flange_m
    near = nearby_joints(here, NEARBY_CANDIDATES, seed=3)
    near = near[allowed_postures(model, near, limits, hook)]
    spread = candidate_joints(model, limits, SPARE_CANDIDATES, seed=2, hook_in_flange_m=hook)
    return np.vstack([near, record.capture_joints_rad(), spread])


def _unmeasured(candidates: Array, measured: tuple[Joints, ...]) -> Array:
    if not measured:
        return candidates
    apart = np.abs(candidates[:, None, :] - np.array(measured)[None]).max(axis=2).min(axis=1)
    unmeasured: Array = candidates[apart > SAME_POSE_RAD]
    return unmeasured


def _timed(
    model: RobotModel,
    start_rad: Joints,
    poses: list[Array],
    limits: MotionLimits,
    speed_rad_s: float,
    *,
    one_by_one: bool = False,
) -> MotionPlan:
    ways, here = [], np.array(start_rad)
    for pose in poses:
        ways.append(corners_of(here, pose, one_by_one))
        here = pose
    return checked(model, start_rad, ways, limits, speed_rad_s)


def checked(
    model: RobotModel, start_rad: Joints, ways: list[Array], limits: MotionLimits, speed_rad_s: float
) -> MotionPlan:
    """Return the plan of ways that are gone one after the other, as slow as its caps ask; refuse a broken one."""
    corners = np.concatenate(ways)
    stops = [last for way in ways for last in [*([False] * (len(way) - 1)), True]]
    verdict = check_moves(model, start_rad, corners, limits, speed_rad_s=speed_rad_s, stops=stops)
    refuse_broken(verdict)
    way_of = np.repeat(np.arange(len(ways)), [len(way) for way in ways])
    fastest = np.ones(len(ways))  # tip speed over its cap, at the speed asked for
    np.maximum.at(fastest, way_of, verdict.times_too_fast(len(corners), 1.01))
    steps = np.abs(np.diff(np.vstack([np.array(start_rad), corners]), axis=0)).max(axis=1)
    return MotionPlan(
        poses_rad=as_way([way[-1] for way in ways]),
        speed_rad_s=float(speed_rad_s / fastest.max()),
        travel_rad=float(steps.sum()),
        not_checked=verdict.not_checked,
        speeds_rad_s=tuple(float(v) for v in speed_rad_s / fastest),
        moving_s=float(np.sum(steps * fastest[way_of]) / speed_rad_s),
        doubt=limits.doubt,
    )


def _unreachable(here: Array, limits: MotionLimits) -> DegenerateDataError:
    """Say that no pose can be reached, and what is too near where the arm stands, if it is that."""
    why, remedy = _trouble(here, limits), "Jog the robot towards the middle of its range, then resume."
    told = "none of the poses still needed can be reached from here without breaking a limit"
    return DegenerateDataError(f"{told}: {why}" if why else told, remedy=remedy)


def _trouble(here: Array, limits: MotionLimits) -> str:
    near = None if limits.clearances is None else limits.clearances.distances(here[None], limits.doubt)
    if near is None or not near.broken()[0]:
        return ""
    k = int(np.argmax(near.excess[0]))
    apart_mm, kept_mm = 1e3 * near.found[0, k], 1e3 * near.limit[0, k]
    doubt_mm = 0.0 if near.doubt is None else 1e3 * near.doubt[0, k]
    return (
        f"{near.names[k]} are {apart_mm:.0f} mm apart, {kept_mm:.0f} mm are kept, {doubt_mm:.0f} mm of them for "
        "turns that are not known yet"
    )
