"""A user frame that goes along with its workpiece: its points, which to touch again, where it is. Pure functions."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Pose, log_rotation
from cellcal.calibration.message import make_message
from cellcal.calibration.points.fixture import PlacedPoints, Triple, place_points, refuse_bad_points
from cellcal.calibration.points.frame_design import FramePrediction
from cellcal.calibration.points.frames import frame_offset as offset_between
from cellcal.calibration.points.offset_design import (
    OffsetGoal,
    point_covariance,
    predict_offset,
    touches_needed_in_rounds,
)
from cellcal.procedures.setting_texts import (
    CHECK_ABOVE,
    FRAME_NUMBER,
    MAX_TOUCHES,
    TIP_IN_FLANGE,
    TOUCH_SIGMA,
    WRITE_ANYWAY,
    describe_setting,
)
from cellcal.procedures.steps.meters import tip_in_base
from cellcal.procedures.teaching.point_remarks import smaller_turn_remarks
from cellcal.procedures.write_review import WriteAnyway


@dataclass(frozen=True, slots=True)
class FrameOffset:
    """Which user frame moved, the points that are touched again, and with which pointer."""

    frame_number: Annotated[int, Field(ge=0, le=99), FRAME_NUMBER]
    tip_in_flange_m: Annotated[Triple, TIP_IN_FLANGE]
    points_in_frame_m: Annotated[
        tuple[Triple, ...],
        Field(max_length=50),
        describe_setting(
            "Points to touch, in the user frame",
            "Three or more points of the workpiece, by the drawing, in x, y and z of the user frame.",
            "place",
            unit="m",
            basic=True,
            drawing="frame",
        ),
    ] = ()
    old_points_in_base_m: Annotated[
        tuple[Triple, ...],
        Field(max_length=50),
        describe_setting(
            "The same points before the move",
            "Where the points were touched before the workpiece moved, in the robot's base; in place of the drawing.",
            "place",
            unit="m",
            basic=True,
            drawing="frame",
        ),
    ] = ()
    old_frame: Annotated[
        Pose | None,
        describe_setting(
            "User frame before the move",
            "Empty: as the controller has it.",
            "place",
            unit="m",
            drawing="frame",
        ),
    ] = None
    far_point_in_frame_m: Annotated[
        Triple | None,
        describe_setting(
            "Far end of the workpiece",
            "The shift is also told at this point; empty: the given point furthest out.",
            "place",
            unit="m",
            drawing="frame",
        ),
    ] = None
    sigma_m: Annotated[float, Field(gt=0, le=0.1), TOUCH_SIGMA] = 0.0005
    old_sigma_m: Annotated[
        float,
        Field(ge=0, le=0.1),
        describe_setting(
            "Spread of the earlier points",
            "How exactly the given points are known in one axis (standard deviation).",
            "doubt",
            unit="m",
        ),
    ] = 0.0005
    origin_u_m: Annotated[
        float,
        Field(gt=0, le=0.1),
        describe_setting(
            "Certainty of the origin",
            "The offset is accepted when its origin is known so well (k = 2).",
            "limits",
            unit="m",
        ),
    ] = 0.002
    angle_u_rad: Annotated[
        float,
        Field(gt=0, le=1),
        describe_setting(
            "Certainty of the direction",
            "The offset is accepted when its turn is known so well (k = 2).",
            "limits",
            unit="rad",
        ),
    ] = math.radians(0.5)
    max_touches: Annotated[int, Field(ge=3, le=100), MAX_TOUCHES] = 12
    check_above: Annotated[bool, CHECK_ABOVE] = False
    write_anyway: Annotated[WriteAnyway, WRITE_ANYWAY] = ""

    @property
    def offset_goal(self) -> OffsetGoal:
        """The uncertainty of a touch, and the one that is asked for."""
        return OffsetGoal(self.sigma_m, self.old_sigma_m, self.origin_u_m, self.angle_u_rad)

    @property
    def named_count(self) -> int:
        """The number of points that are touched in any case."""
        return len(self.points_in_frame_m or self.old_points_in_base_m)

    @property
    def most_touches(self) -> int:
        """The largest number of touches."""
        return max(self.max_touches, self.named_count)


@dataclass(frozen=True, slots=True)
class PointTouch:
    """One touch of a point of the workpiece, counted from 0."""

    point: int
    base_flange: Pose


@dataclass(frozen=True, slots=True)
class FoundFrameOffset:
    """The frame before and after, and what lies between: ``old_new`` is UF_T_UF' of Eq. 7."""

    base_frame_old: Pose
    base_frame_new: Pose
    old_new: Pose
    shift_m: float  # of the origin
    turn_rad: float
    far_point_in_frame_m: Triple
    far_shift_m: float  # by how much the far end of the workpiece moved
    placed: PlacedPoints
    touches: tuple[int, ...] = ()  # of each point; none in results older than version 3


def find_offset(
    spec: FrameOffset, base_frame_old: Pose, touches: tuple[PointTouch, ...], above: Pose | None
) -> FoundFrameOffset:
    """Fit the moved frame to its points by least squares; compare it with the old one."""
    points = points_in_frame(spec, base_frame_old)
    tips = [tip_in_base(touch.base_flange, spec.tip_in_flange_m) for touch in touches]
    of = [
        [tip for tip, touch in zip(tips, touches, strict=True) if touch.point == k]
        for k in range(len(points))
    ]
    counts = tuple(map(len, of))
    touched = [np.mean(each, axis=0) for each in of]
    variance = point_covariance(counts, spec.sigma_m, spec.old_sigma_m)
    placed = place_points(points, touched, variance, sigma_point_m=0.0)
    new = placed.outer_inner
    if above is not None:
        _refuse_below(new, tip_in_base(above, spec.tip_in_flange_m))
    old_new = offset_between(base_frame_old, new)
    far = spec.far_point_in_frame_m or max(points, key=lambda point: math.hypot(*point))
    moved = old_new.rotation_matrix() @ np.array(far) + np.array(old_new.position_m) - np.array(far)
    return FoundFrameOffset(
        base_frame_old=base_frame_old,
        base_frame_new=new,
        old_new=old_new,
        shift_m=math.hypot(*old_new.position_m),
        turn_rad=float(np.linalg.norm(log_rotation(old_new.rotation_matrix()))),
        far_point_in_frame_m=far,
        far_shift_m=float(np.linalg.norm(moved)),
        placed=placed,
        touches=counts,
    )


def exchange_remarks(spec: FrameOffset, found: FoundFrameOffset) -> tuple[str, ...]:
    """Return what another order of the points would have given, where it is likelier."""
    points = np.array(points_in_frame(spec, found.base_frame_old))
    fitted = points @ found.base_frame_new.rotation_matrix().T + np.array(found.base_frame_new.position_m)
    return smaller_turn_remarks(
        [str(number) for number in range(1, len(points) + 1)],
        points,
        fitted + np.array(found.placed.residuals_m),
        found.base_frame_old.rotation_matrix(),
    )


def points_in_frame(spec: FrameOffset, base_frame_old: Pose) -> tuple[Triple, ...]:
    """Return the workpiece's points in its user frame.

    Raises
    ------
    CalibrationError
        Neither or both kinds of points are given; too few, too close, or on one line.
    """
    if bool(spec.points_in_frame_m) == bool(spec.old_points_in_base_m):
        raise CalibrationError(
            "the points are given either in the user frame or as touched before the move.",
            remedy="Set points_in_frame_m or old_points_in_base_m, not both.",
        )
    points = spec.points_in_frame_m
    if not points:
        back = base_frame_old.inverse()
        in_frame = np.array(spec.old_points_in_base_m) @ back.rotation_matrix().T + np.array(back.position_m)
        points = tuple((float(x), float(y), float(z)) for x, y, z in in_frame)
    refuse_bad_points(points, "points of the workpiece")
    return points


def _refuse_below(base_frame: Pose, above_m: Triple) -> None:
    height = float((np.array(above_m) - np.array(base_frame.position_m)) @ base_frame.rotation_matrix()[:, 2])
    if not height > 0:
        raise CalibrationError(
            make_message(
                "the check point lies {height:.1f} mm below the frame: z points the wrong way.",
                height=-height * 1000.0,
            ),
            remedy="The points were touched in another order than they are listed. Start a new run.",
        )


def predict_touches(spec: FrameOffset, points: tuple[Triple, ...]) -> FramePrediction:
    """Return what is worth touching again once every point was touched."""
    return predict_offset(points, [1] * len(points), spec.offset_goal, spec.most_touches)


def further_touches(spec: FrameOffset, points: tuple[Triple, ...]) -> tuple[int, ...]:
    """Return the points to touch again, from 0; none where no number of touches that is allowed would do."""
    planned = predict_touches(spec, points)
    return planned.again if planned.reached else ()


def saving_text(spec: FrameOffset, found: FoundFrameOffset) -> str:
    """Return what choosing the touches saved, or why nothing more was asked for, as a sentence."""
    points, touches = points_in_frame(spec, found.base_frame_old), sum(found.touches)
    planned, in_turn = predict_touches(spec, points), touches_needed_in_rounds(points, spec.offset_goal)
    if not planned.reached or in_turn is None:
        origin_mm, angle_deg = planned.origin_u_m * 1e3, math.degrees(planned.angle_u_rad)
        return make_message(
            "{touches} touches; further ones were not asked for: {most_touches} would leave the "
            "origin within {origin_mm:.2f} mm and the angle within {angle_deg:.3f} deg (k=2)",
            touches=touches,
            most_touches=spec.most_touches,
            origin_mm=origin_mm,
            angle_deg=angle_deg,
        )
    if touches >= in_turn:
        return make_message(
            "no saving: {touches} touches, as many as the points in turn would take", touches=touches
        )
    return make_message(
        "{touches} touches, each further one where it tells most; the points touched in turn "
        "would take {in_turn} for the U of the limits",
        touches=touches,
        in_turn=in_turn,
    )
