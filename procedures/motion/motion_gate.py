"""The only place that commands motion: nothing else in the product moves a robot (a test checks the source).

Plans are checked before a person approves them. Here, right before each command, it is checked again from where
the arm really stands: that the numbers are numbers, the state is fresh, the robot ready, its encoders and tool
those of before, our right to command it unbroken, and the way free. The cell file says who then moves: this
software, a program that a person starts, or a person with the pendant. This is no safety function.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import MotionLimits, MotionVerdict, WirePath, check_moves
from cellcal.calibration.motion.position_uncertainty import PositionUncertainty
from cellcal.drivers.interfaces import Joints, Readiness
from cellcal.procedures.axis_texts import axis_name
from cellcal.procedures.cell import Cell, MotionLevel
from cellcal.procedures.motion.guided_jog import HandJog, jog_by_hand
from cellcal.procedures.motion.manual_moves import move_by_hand
from cellcal.procedures.motion.motion_approval import ensure_approved
from cellcal.procedures.motion.robot_readiness import (
    MotionRefusedError,
    check_still_allowed,
    read_ready_robot,
)
from cellcal.procedures.motion.speed_limit import SpeedLimit
from cellcal.procedures.motors import axis_jog
from cellcal.procedures.run import NeedsUnmetError, ProcedureError
from cellcal.procedures.surroundings import clearance_check

MARGIN_RAD = 0.034907  # 2 deg from a joint's limit: plans keep 3, and stops from below overshoot by 1
HAND_TOLERANCE_RAD = 0.0087266  # 0.5 deg: what a person sets on a pendant
HAND_JOG_TOLERANCE_RAD = 0.0523599  # 3 deg: a capture counts where it was taken, not where it was planned
SLACK_SHARE = 0.5  # of the distances that plans keep: an arm comes to rest beside its target by up to 0.1 deg
WRAP_RAD = 9.424778  # 540 deg: a plan winds the wire by up to 270 to either side of where it began
SLOWEST_RAD_S = 1e-5
_MANUAL = (
    Readiness.NOT_READY,
)  # a controller in manual mode: a person moves the arm there, and nothing else does
_STRAIGHT = 0.01  # smallest singular value of the Jacobian on a straight move; about 5 deg at a wrist


class OffTargetError(ProcedureError):
    """A move ended somewhere else than planned."""

    code = "procedure.off_target"


class MotionCare(Enum):
    """The distances that a way must keep, besides limits and the arm's distance from itself."""

    FREE = "free"  # distances to what stands in the cell
    WIRED = "wired"  # and the draw-wire, hung where the cell file says
    TOUCHING = "touching"  # a straight way to a surface that shall be touched: no distances to the cell


@dataclass(frozen=True, slots=True)
class JogMove:
    """A turn of one joint alone. ``here_rad``: where the arm most likely stands, to within ``doubt``."""

    axis: int
    delta_rad: float
    speed_rad_s: float
    here_rad: Joints | None = None  # None: unknown, and nothing is checked
    doubt: PositionUncertainty | None = None
    care: MotionCare = MotionCare.WIRED
    began_rad: Joints | None = None  # where the turn began, if this is its end: no nearer than it was there
    back_rad: float = 0.0  # turned back upwards at its end, by a person within one instruction
    tolerance_rad: float = HAND_TOLERANCE_RAD  # by which a person may miss its end


async def move_along(
    cell: Cell,
    way_rad: Sequence[Joints],
    speed_rad_s: float,
    *,
    care: MotionCare = MotionCare.FREE,
    pace: SpeedLimit | None = None,
    doubt: PositionUncertainty | None = None,
) -> None:
    """Bring the arm along corners to the last one, by this robot's mover; no leg faster than its ``pace``.

    ``doubt``: by how much its joints may be other than the controller shows; distances grow with it.

    Raises
    ------
    MotionRefusedError
        The way may not be gone, or the numbers are none; nothing has moved.
    DeviceError
        The robot is not ready, or not heard.
    PositionLostAgainError
        The encoders are not those that this run began with.
    FramesChangedError
        The active tool, user frame or payload is not the one that this run began with.
    """
    by_hand = cell.level is not MotionLevel.COMMANDED
    here = await read_ready_robot(cell, Readiness.READY, *(_MANUAL if by_hand else ()))
    speeds = _check_and_cap(cell, care, here.joints_rad, way_rad, speed_rad_s, doubt=doubt)
    if pace is not None:
        speeds = tuple(map(min, speeds, pace.leg_speeds(here.joints_rad, way_rad)))
    if cell.level is not MotionLevel.COMMANDED:
        wired = care is MotionCare.WIRED
        await move_by_hand(cell, way_rad, min(speeds), HAND_TOLERANCE_RAD, wired=wired)
        return
    await ensure_approved(cell, here.joints_rad, way_rad, max(speeds))
    for corner, speed in zip(way_rad, speeds, strict=True):
        await check_still_allowed(cell)
        await cell.robot.move_joints(tuple(corner), speed_rad_s=speed)


async def jog_axis(cell: Cell, jog: JogMove) -> None:
    """Turn one joint, also of a robot that does not know where it is; raises as ``move_along``."""
    by_hand = cell.is_jogged_by_hand
    await read_ready_robot(cell, Readiness.READY, Readiness.POSITION_LOST, *(_MANUAL if by_hand else ()))
    speed = min(jog.speed_rad_s, cell.limits.jog_speed_rad_s)
    _refuse_no_number((float(jog.axis), jog.delta_rad, speed))
    if jog.here_rad is not None:
        target = tuple(q + jog.delta_rad * (k == jog.axis) for k, q in enumerate(jog.here_rad))
        began = jog.began_rad or jog.here_rad
        speed = min(_check_and_cap(cell, jog.care, began, [target], speed, stops=False, doubt=jog.doubt))
    if cell.is_jogged_by_hand:
        turn_rad = jog.delta_rad + jog.back_rad
        await jog_by_hand(cell, HandJog(jog.axis, turn_rad, speed, jog.tolerance_rad, from_below=True))
        return
    await ensure_approved(cell, None, (), speed)
    await check_still_allowed(cell)
    await axis_jog(cell).jog_axis(jog.axis, jog.delta_rad, speed_rad_s=speed)


def tolerance_rad(cell: Cell, commanded_rad: float) -> float:
    """Return how far from its target an arm may come to rest: a person with a pendant is less exact."""
    return commanded_rad if cell.level is MotionLevel.COMMANDED else max(commanded_rad, HAND_TOLERANCE_RAD)


def refuse_off_target(cell: Cell, found: Joints, target: Joints, tolerance_rad: float) -> None:
    """Raise OffTargetError where an arm did not come to rest where it should."""
    errors = [abs(f - t) for f, t in zip(found, target, strict=True)]
    worst = max(range(len(errors)), key=errors.__getitem__)
    if not errors[worst] <= tolerance_rad:
        raise OffTargetError(
            make_message(
                "axis {worst} ended {errors:.3f} deg from its target",
                worst=axis_name(cell, worst),
                errors=math.degrees(errors[worst]),
            ),
            remedy="Look whether something blocks the arm, then resume.",
        )


def check_way(  # noqa: PLR0913 - as _capped
    cell: Cell,
    care: MotionCare,
    here_rad: Joints,
    way_rad: Sequence[Joints],
    speed_rad_s: float,
    *,
    stops: bool = True,
    doubt: PositionUncertainty | None = None,
) -> MotionVerdict:
    """Check a way from where the arm stands. The last corner has to keep every limit if the arm ``stops`` there."""
    model = _model_of(cell)
    limits = _motion_limits(cell, care, doubt)
    at = [False] * (len(way_rad) - 1) + [stops]
    tip = cell.surroundings.tip_in_flange_m or (0.0, 0.0, 0.0)
    if limits.wire is not None:
        tip = limits.wire.hook_in_flange_m
    ways = np.array(way_rad, dtype=float)
    return check_moves(model, here_rad, ways, limits, speed_rad_s=speed_rad_s, tip_in_flange_m=tip, stops=at)


def _motion_limits(cell: Cell, care: MotionCare, doubt: PositionUncertainty | None) -> MotionLimits:
    surroundings, model = cell.surroundings, _model_of(cell)
    wire = _wire_path(cell) if care is MotionCare.WIRED else None
    shapes = replace(
        surroundings,
        margin_m=SLACK_SHARE * surroundings.margin_m,
        wire_margin_m=SLACK_SHARE * surroundings.wire_margin_m,
    )
    if care is MotionCare.TOUCHING:
        shapes = replace(shapes, blocks=(), balls=(), planes=())
    return MotionLimits(
        joint_margin_rad=MARGIN_RAD,
        mastering_uncertainty_rad=() if doubt is None else doubt.bodies_rad,
        position_uncertainty=doubt,
        joint_speed_rad_s=cell.limits.speed_rad_s,
        tip_speed_m_s=cell.limits.tip_speed_m_s * surroundings.speed_share,
        box_low_m=surroundings.box_low_m,
        box_high_m=surroundings.box_high_m,
        smallest_singular_value=_STRAIGHT if care is MotionCare.TOUCHING else None,
        wire=wire,
        clearances=clearance_check(model.name, shapes, wire),
    )


def _wire_path(cell: Cell) -> WirePath | None:
    if cell.gauge is None or cell.gauge_setup is None:
        return None
    at, range_m = cell.gauge_setup, cell.gauge.capabilities.range_m
    return WirePath(at.anchor_in_base_m, at.hook_in_flange_m, range_m, wrap_rad=WRAP_RAD)


def _check_and_cap(  # noqa: PLR0913 - one way needs all of it
    cell: Cell,
    care: MotionCare,
    here_rad: Joints,
    way_rad: Sequence[Joints],
    speed_rad_s: float,
    *,
    stops: bool = True,
    doubt: PositionUncertainty | None = None,
) -> tuple[float, ...]:
    """Refuse a way that is not free; return for each leg the speed at which no part of the arm exceeds its cap."""
    _refuse_no_number((speed_rad_s, *here_rad, *(q for corner in way_rad for q in corner)))
    model = _model_of(cell)
    fastest_joint = min(cell.limits.speed_rad_s, float(np.min(model.max_speed_rad_s)))
    speed = min(speed_rad_s, fastest_joint)
    verdict = check_way(cell, care, here_rad, way_rad, speed, stops=stops, doubt=doubt)
    broken = [finding for finding in verdict.findings if finding.check != "tip speed"]
    if broken:
        raise MotionRefusedError(
            make_message("the way is not free: {broken_sentence}", broken_sentence=broken[0].sentence),
            remedy="Nothing has moved. Look whether the robot stands where it should, then start a new run.",
        )
    slower = verdict.times_too_fast(len(way_rad), 1.01)
    return tuple(max(speed / float(times), SLOWEST_RAD_S) if times > 1.0 else speed for times in slower)


def _refuse_no_number(numbers: Sequence[float]) -> None:
    if not all(math.isfinite(number) for number in numbers):
        raise MotionRefusedError(
            "a target or a speed is not a finite number", remedy="Nothing has moved. Report this run."
        )


def _model_of(cell: Cell) -> RobotModel:
    if cell.model is None:
        raise NeedsUnmetError("no kinematic model of the robot is known", missing=("model",))
    return cell.model
