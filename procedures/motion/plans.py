"""Plans of motion as pure functions: which poses, in which order, how fast. Plans are shown, then obeyed."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
from pydantic import Field

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.pose_design import kit_poses
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath, check_moves, seems_free
from cellcal.calibration.motion.position_uncertainty import PositionUncertainty
from cellcal.calibration.wires.model import WirePrior
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.motion.detours import ways_through
from cellcal.procedures.motion.plan_ways import (
    as_way,
    corners_of,
    refuse_broken,
    winding_after,
    wire_has_side,
)
from cellcal.procedures.motors import MotorState
from cellcal.procedures.setting_texts import BOX_HIGH, BOX_LOW, describe_setting
from cellcal.procedures.surroundings import NOTHING_KNOWN, Surroundings, clearance_check

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MotionBounds:
    """The bounds of motion, and how far a lost robot may be from where it seems to be."""

    lost_turns: Annotated[
        int,
        Field(ge=0, le=50),
        describe_setting(
            "Motor turns that may be lost",
            "Space is kept free for an arm that stands so many motor turns from where it seems to be.",
            "motion",
            unit="1",
        ),
    ] = 2
    tip_speed_m_s: Annotated[
        float,
        Field(gt=0, le=0.25),
        describe_setting(
            "Speed of the tip",
            "The tip moves no faster than this; halved while the cell's obstacles are unknown.",
            "motion",
            unit="m/s",
        ),
    ] = 0.05
    wire_low: Annotated[
        float,
        Field(ge=0, lt=1),
        describe_setting(
            "Shortest wire, share of the range",
            "Below this share of its range the draw-wire is not used.",
            "motion",
            unit="1",
        ),
    ] = 0.08
    wire_high: Annotated[
        float,
        Field(gt=0, le=1),
        describe_setting(
            "Longest wire, share of the range",
            "Above this share of its range the draw-wire is not used.",
            "motion",
            unit="1",
        ),
    ] = 0.92
    box_low_m: Annotated[Triple | None, BOX_LOW] = None
    box_high_m: Annotated[Triple | None, BOX_HIGH] = None
    surroundings: Annotated[
        Surroundings,
        describe_setting(
            "Obstacles of the cell", "What stands around the arm; usually from the cell file.", "shapes"
        ),
    ] = NOTHING_KNOWN

    def __post_init__(self) -> None:
        if self.wire_low >= self.wire_high:
            raise ValueError("wire_low must be below wire_high: no pose has its wire between them")
        low, high = self.box_m()
        if low is not None and high is not None and any(a >= b for a, b in zip(low, high, strict=True)):
            raise ValueError("box_low_m must be below box_high_m in x, y and z: no pose lies between them")

    @property
    def capped_tip_speed_m_s(self) -> float:
        """The speed cap: half of it while the cell's obstacles are unknown."""
        return self.tip_speed_m_s * self.surroundings.speed_share

    def box_m(self) -> tuple[Triple | None, Triple | None]:
        """Return the corners of the workspace: of the run, or else of the cell file."""
        surroundings = self.surroundings
        return (self.box_low_m or surroundings.box_low_m, self.box_high_m or surroundings.box_high_m)


@dataclass(frozen=True, slots=True)
class MotionPlan:
    """Poses in the order of travel, the speeds that keep every cap, and what was not checked."""

    poses_rad: tuple[Joints, ...]
    speed_rad_s: float  # of the slowest way: it keeps the caps on every one
    travel_rad: float  # of the slowest axis, added over all moves
    not_checked: tuple[str, ...]
    ways_rad: tuple[
        tuple[Joints, ...], ...
    ] = ()  # to each pose, with the corners in between; empty: straight
    speeds_rad_s: tuple[float, ...] = ()  # of each way, as fast as its own corners allow
    moving_s: float = 0.0  # with each way at its own speed, or each turn of a single axis
    doubt: PositionUncertainty | None = None  # about where the arm stands: kept again right before each move


def wire_prior(state: MotorState) -> WirePrior:
    """Return what the cell file says about the wire."""
    at = state.gauge_setup
    return WirePrior(
        anchor_in_base_m=at.anchor_in_base_m,
        hook_in_flange_m=at.hook_in_flange_m,
        sigma_anchor_m=at.sigma_anchor_m,
        sigma_hook_m=at.sigma_hook_m,
    )


def motion_limits(state: MotorState, drive: DriveTrain, room: MotionBounds) -> MotionLimits:
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
        clearances=clearance_check(state.model, room.surroundings, wire),
    )


def plan_kit(state: MotorState, room: MotionBounds, poses: int, seed: int) -> MotionPlan:
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
            [seems_free(model, here, drawn, limits), wire_has_side(model, drawn, limits)]
        ),
    )
    ways = ways_through(state.joints_rad, kit, partial(winding_after, model, limits))
    if len(ways) < min(poses, model.axis_count + 6):
        raise DegenerateDataError(
            make_message(
                "only {way_count} of {poses} planned poses can be reached without breaking a limit",
                way_count=len(ways),
                poses=poses,
            ),
            remedy="Move the robot nearer to the middle of its range, or move the wire's anchor.",
        )
    before, gone = here, []
    for way in ways:
        before = way[-2] if len(way) > 1 else before
        gone.append(np.array([*way[:-1], *corners_of(before, way[-1], False)]))
        before = way[-1]
    plan = checked_plan(model, state.joints_rad, gone, limits, state.limits.speed_rad_s)
    return replace(plan, ways_rad=tuple(map(as_way, ways)))


def timed_plan(
    model: RobotModel,
    start_rad: Joints,
    poses: list[Array],
    limits: MotionLimits,
    speed_rad_s: float,
    *,
    one_by_one: bool = False,
) -> MotionPlan:
    """Return the plan of poses that are gone to one after the other; as ``checked_plan``."""
    ways, here = [], np.array(start_rad)
    for pose in poses:
        ways.append(corners_of(here, pose, one_by_one))
        here = pose
    return checked_plan(model, start_rad, ways, limits, speed_rad_s, each_leg=one_by_one)


def checked_plan(
    model: RobotModel,
    start_rad: Joints,
    ways: list[Array],
    limits: MotionLimits,
    speed_rad_s: float,
    *,
    each_leg: bool = False,
) -> MotionPlan:
    """Return the plan of ways that are gone one after the other, as slow as its caps ask; refuse a broken one.

    ``each_leg`` goes at its own pace where joints turn one after the other; else a way is as slow as its slowest.
    """
    corners = np.concatenate(ways)
    stops = [last for way in ways for last in [*([False] * (len(way) - 1)), True]]
    verdict = check_moves(model, start_rad, corners, limits, speed_rad_s=speed_rad_s, stops=stops)
    refuse_broken(verdict)
    way_of = np.repeat(np.arange(len(ways)), [len(way) for way in ways])
    fastest = np.ones(len(ways))  # tip speed over its cap, at the speed asked for
    too_fast = verdict.times_too_fast(len(corners), 1.01)
    np.maximum.at(fastest, way_of, too_fast)
    steps = np.abs(np.diff(np.vstack([np.array(start_rad), corners]), axis=0)).max(axis=1)
    return MotionPlan(
        poses_rad=as_way([way[-1] for way in ways]),
        speed_rad_s=float(speed_rad_s / fastest.max()),
        travel_rad=float(steps.sum()),
        not_checked=verdict.not_checked,
        speeds_rad_s=tuple(float(v) for v in speed_rad_s / fastest),
        moving_s=float(np.sum(steps * (too_fast if each_leg else fastest[way_of])) / speed_rad_s),
        doubt=limits.position_uncertainty,
    )
