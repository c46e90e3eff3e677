"""The workpiece moved: the same points touched again give the offset of its user frame.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.3,
Eq. 7-8: with the offset written into the user frame, every recorded point goes along with the workpiece.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field, TypeAdapter
from pydantic_core import to_jsonable_python

from calibration.errors import CalibrationError
from calibration.geometry import Pose, log_rotation
from calibration.points.fixture import PlacedPoints, Triple, place_points, refuse_bad_points
from calibration.points.frames import frame_offset as offset_between
from drivers.interfaces import Instruction
from procedures.canonical import sha256_of
from procedures.entry import Entry, Keepsake, Phase
from procedures.forecast import PERSON_S, Forecast, Knowledge
from procedures.judged_write import (
    WriteAnyway,
    first_of,
    frame_changes,
    ordered,
    refuse_failed,
    with_verdict,
)
from procedures.past import Finding
from procedures.refit import (
    STANDS_OUT,
    FitPoint,
    Refit,
    Refitted,
    Use,
    kept,
    misses_in_space,
    pose_values,
    values_of,
)
from procedures.run import RefusalError, Run
from procedures.steps.ask import accept, ask
from procedures.steps.meters import known_points_meter, tip_in_base
from procedures.steps.pages import point_states, points_page, with_changes
from procedures.steps.teach import TaughtPose, teach
from procedures.steps.write import read_user_frame, write_user_frame
from procedures.verdict import Verdict, held, known_within, stated

POINTER = Instruction(
    "pointer_is_mounted", "Mount the pointer whose tip is known; clamp the workpiece in its new place."
)
ABOVE = Instruction(
    "touch_above", "Touch any point that lies above the workpiece's x-y plane, on the +z side."
)


@dataclass(frozen=True, slots=True)
class FrameOffset:
    """Which user frame moved, the points that are touched again, and with which pointer."""

    frame_number: Annotated[int, Field(ge=0, le=99)]
    tip_in_flange_m: Triple
    points_in_frame_m: Annotated[tuple[Triple, ...], Field(max_length=50)] = ()  # in the user frame, or …
    old_points_in_base_m: Annotated[
        tuple[Triple, ...], Field(max_length=50)
    ] = ()  # … as touched before the move
    old_frame: Pose | None = None  # None: as the controller has it
    far_point_in_frame_m: Triple | None = None  # the far end of the workpiece; None: the point furthest out
    sigma_m: Annotated[float, Field(gt=0, le=0.1)] = 0.0005  # of one coordinate of one touch, now
    old_sigma_m: Annotated[float, Field(ge=0, le=0.1)] = 0.0005  # the same of the points given
    origin_u_m: Annotated[float, Field(gt=0, le=0.1)] = 0.002
    angle_u_rad: Annotated[float, Field(gt=0, le=1)] = math.radians(0.5)
    check_above: bool = False  # one more touch, which catches points taken in the wrong order
    write_anyway: WriteAnyway = ""


@dataclass(frozen=True, slots=True)
class FoundOffset:
    """The frame before and after, and what lies between: ``old_new`` is UF_T_UF' of Eq. 7."""

    base_frame_old: Pose
    base_frame_new: Pose
    old_new: Pose
    shift_m: float  # of the origin
    turn_rad: float
    far_point_in_frame_m: Triple
    far_shift_m: float  # by how much the far end of the workpiece moved
    placed: PlacedPoints


@dataclass(frozen=True, slots=True)
class OffsetResult:
    """The user frame as written and read back, and by how much the workpiece moved."""

    frame_number: int
    found: FoundOffset
    before: Pose  # as the controller had it; the frame before the move may have been given otherwise
    read_back: Pose


LEAST = 3
_TAUGHT: TypeAdapter[TaughtPose] = TypeAdapter(TaughtPose)
_FOUND: TypeAdapter[FoundOffset] = TypeAdapter(FoundOffset)


async def frame_offset(run: Run, spec: FrameOffset) -> OffsetResult:
    """Touch known points of a moved workpiece, and move its user frame with it."""
    await run.ensure("the pointer is mounted", ask, POINTER)
    before = await run.step("read the user frame", read_user_frame, spec.frame_number)
    old = spec.old_frame or before

    count = len(spec.points_in_frame_m or spec.old_points_in_base_m)
    touches: list[TaughtPose] = []
    for k in range(1, count + 1):
        touches.append(await run.step(f"touch point {k}", teach, _on_page(spec, k, touches)))
    above = await run.step("touch a point above", teach, _above_on_page(count)) if spec.check_above else None

    flanges = tuple(taught.base_flange for taught in touches)
    above_flange = None if above is None else above.base_flange
    found = await run.solve("find the offset", find_offset, spec, old, flanges, above_flange)
    first_of((_bad_shape(found), _badly_known(found, spec)), spec.write_anyway)
    verdict = _judge(spec, found)
    refuse_failed(verdict, spec.write_anyway, found)
    shown, sha256 = _shown(spec, found, verdict), sha256_of(to_jsonable_python(found.base_frame_new))
    await run.step("accept the result", accept, shown, sha256)
    new = found.base_frame_new
    read_back = await run.write("write the user frame", write_user_frame, spec.frame_number, new)
    return OffsetResult(spec.frame_number, found, before, read_back)


def find_offset(
    spec: FrameOffset, base_frame_old: Pose, flanges: tuple[Pose, ...], above: Pose | None
) -> FoundOffset:
    """Fit the moved frame to its points by least squares; compare it with the old one."""
    points = points_in_frame(spec, base_frame_old)
    touched = [tip_in_base(base_flange, spec.tip_in_flange_m) for base_flange in flanges]
    variance = (spec.sigma_m**2 + spec.old_sigma_m**2) * np.eye(3 * len(points))
    placed = place_points(points, touched, variance, sigma_point_m=0.0)
    new = placed.outer_inner
    if above is not None:
        _refuse_below(new, tip_in_base(above, spec.tip_in_flange_m))
    old_new = offset_between(base_frame_old, new)
    far = spec.far_point_in_frame_m or max(points, key=lambda point: math.hypot(*point))
    moved = old_new.rotation() @ np.array(far) + np.array(old_new.position_m) - np.array(far)
    return FoundOffset(
        base_frame_old=base_frame_old,
        base_frame_new=new,
        old_new=old_new,
        shift_m=math.hypot(*old_new.position_m),
        turn_rad=float(np.linalg.norm(log_rotation(old_new.rotation()))),
        far_point_in_frame_m=far,
        far_shift_m=float(np.linalg.norm(moved)),
        placed=placed,
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
        in_frame = np.array(spec.old_points_in_base_m) @ back.rotation().T + np.array(back.position_m)
        points = tuple((float(x), float(y), float(z)) for x, y, z in in_frame)
    refuse_bad_points(points, "points of the workpiece")
    return points


def _refuse_below(base_frame: Pose, above_m: Triple) -> None:
    height = float((np.array(above_m) - np.array(base_frame.position_m)) @ base_frame.rotation()[:, 2])
    if not height > 0:
        raise CalibrationError(
            f"the check point lies {-height * 1e3:.1f} mm below the frame: z points the wrong way.",
            remedy="The points were touched in another order than they are listed. Start a new run.",
        )


def _bad_shape(found: FoundOffset) -> RefusalError | None:
    placed = found.placed
    if placed.consistent():
        return None
    i, j = placed.worst_pair
    return RefusalError(
        f"points {i + 1} and {j + 1} are {abs(placed.worst_gap_m) * 1e3:.2f} mm "
        f"{'further from' if placed.worst_gap_m > 0 else 'nearer to'} each other than before the move "
        f"({placed.worst_deviation:.1f} deviations): this is not the same shape",
        code="procedure.wrong_shape",
        remedy="See that the points are those listed, in this order, and that pointer and workpiece are whole.",
        evidence=found,
    )


def _badly_known(found: FoundOffset, spec: FrameOffset) -> RefusalError | None:
    placed = found.placed
    if placed.origin_u_m <= spec.origin_u_m and placed.angle_u_rad <= spec.angle_u_rad:
        return None
    return RefusalError(
        f"the moved frame is known within {placed.origin_u_m * 1e3:.2f} mm and "
        f"{math.degrees(placed.angle_u_rad):.3f} deg (k=2); {spec.origin_u_m * 1e3:.2f} mm and "
        f"{math.degrees(spec.angle_u_rad):.3f} deg are asked for",
        code="procedure.undecided",
        remedy="Touch more points, or points further apart.",
        evidence=found,
    )


def _touch(spec: FrameOffset, number: int) -> Instruction:
    in_frame = bool(spec.points_in_frame_m)
    x, y, z = (v * 1e3 for v in (spec.points_in_frame_m or spec.old_points_in_base_m)[number - 1])
    where = "in the user frame" if in_frame else "from the base before the move"
    return Instruction(
        f"touch_point_{number}",
        f"Touch point {number} of the workpiece with the pointer (x {x:.1f}, y {y:.1f}, z {z:.1f} mm {where}).",
    )


def _on_page(spec: FrameOffset, number: int, touches: list[TaughtPose]) -> Instruction:
    known, tip = spec.points_in_frame_m or spec.old_points_in_base_m, spec.tip_in_flange_m
    touched = [tip_in_base(touch.base_flange, tip) for touch in touches]
    names = [f"touch point {k}" for k in range(1, len(known) + 1)]
    meter = known_points_meter(number - 1, known, touched, tip)
    return points_page(_touch(spec, number), point_states(names, number - 1), meter)


def _above_on_page(count: int) -> Instruction:
    names = [*(f"touch point {k}" for k in range(1, count + 1)), "touch a point above"]
    return points_page(ABOVE, point_states(names, count), None)


def _shown(spec: FrameOffset, found: FoundOffset, verdict: Verdict) -> Instruction:
    before = ", ".join(f"{v * 1e3:.2f}" for v in found.base_frame_old.position_m)
    after = ", ".join(f"{v * 1e3:.2f}" for v in found.base_frame_new.position_m)
    x, y, z = (v * 1e3 for v in found.old_new.position_m)
    shown = Instruction(
        "accept_offset",
        f"User frame {spec.frame_number}: origin {before} mm before, {after} mm after, from the base. The workpiece "
        f"moved by x {x:.2f}, y {y:.2f}, z {z:.2f} mm in its old frame and turned by "
        f"{math.degrees(found.turn_rad):.3f} deg; its far end moved by {found.far_shift_m * 1e3:.2f} mm. Known "
        f"within {found.placed.origin_u_m * 1e3:.2f} mm and {math.degrees(found.placed.angle_u_rad):.3f} deg (k=2).",
    )
    question = "Write it to the controller? Every point recorded in this frame goes along."
    asked = with_verdict(shown, verdict, question, spec.write_anyway, writes=True)
    changed = frame_changes(found.base_frame_old, found.base_frame_new)
    return with_changes(asked, changed, most_m=found.far_shift_m, at="far_point")


def _outline(spec: FrameOffset) -> tuple[Phase, ...]:
    return (
        Phase("read the user frame"),
        Phase("touch point", len(spec.points_in_frame_m or spec.old_points_in_base_m)),
        *((Phase("touch a point above"),) if spec.check_above else ()),
        *(Phase("find the offset"), Phase("accept the result"), Phase("write the user frame")),
    )


def _keeps(spec: FrameOffset, result: OffsetResult) -> Keepsake:
    return Keepsake("user_frame", str(spec.frame_number), result)


def _verdict(spec: FrameOffset, result: OffsetResult) -> Verdict:
    verdict = ordered(_judge(spec, result.found), spec.write_anyway)
    return replace(verdict, changes=frame_changes(result.before, result.read_back))


def _judge(spec: FrameOffset, found: FoundOffset) -> Verdict:
    return Verdict(
        characteristics=(
            known_within("frame's origin", "m", u=found.placed.origin_u_m / 2.0, limit=spec.origin_u_m),
            known_within("frame's angle", "rad", u=found.placed.angle_u_rad / 2.0, limit=spec.angle_u_rad),
            held(
                "shape of the points",
                found.placed.consistent(),
                "chi square of the points touched against those given, 99.9 %",
                found=found.placed.chi_square,
            ),
            stated("shift of the origin", found.shift_m, "m"),
            stated("turn", found.turn_rad, "rad"),
            stated("shift of the far end", found.far_shift_m, "m"),
        ),
        limits_from="limits of the settings",
        not_verified=("the workpiece's other points: only those touched were looked at",),
    )


def _forecast(spec: FrameOffset, known: Knowledge) -> Forecast:
    del known
    touches = len(spec.points_in_frame_m or spec.old_points_in_base_m) + spec.check_above
    return Forecast(
        duration_s=(touches + 1) * PERSON_S, assumed=("a person brings the pointer to every point",)
    )


def _refit(spec: FrameOffset, findings: Sequence[Finding]) -> Refit:
    found = values_of(findings)
    recorded = _FOUND.validate_python(found["find the offset"])
    known, old = points_in_frame(spec, recorded.base_frame_old), recorded.base_frame_old
    steps = tuple(f"touch point {k}" for k in range(1, len(known) + 1))
    flanges = tuple(_TAUGHT.validate_python(found[step]).base_flange for step in steps)
    above = _TAUGHT.validate_python(found["touch a point above"]).base_flange if spec.check_above else None

    def solve(use: Use) -> Refitted:
        fewer = replace(
            spec,
            points_in_frame_m=kept(known, use),
            old_points_in_base_m=(),
            far_point_in_frame_m=recorded.far_point_in_frame_m,
        )
        offset = find_offset(fewer, old, kept(flanges, use), above)
        back = offset.base_frame_new.inverse()
        gaps = [
            np.subtract(tip_in_base(back @ flange, spec.tip_in_flange_m), point).tolist()
            for flange, point in zip(flanges, known, strict=True)
        ]
        misses = misses_in_space(gaps, math.hypot(spec.sigma_m, spec.old_sigma_m), STANDS_OUT)
        values = pose_values(offset.base_frame_new, recorded.base_frame_new)
        return Refitted(misses, offset.placed.origin_u_m, values)

    return Refit("place", tuple(FitPoint(step) for step in steps), LEAST, "origin", solve)


ENTRY = Entry(
    name="frame_offset",
    title="Offset of a user frame after the workpiece moved",
    version=2,
    procedure=frame_offset,
    spec_type=FrameOffset,
    needs=("writes_user_frame",),
    outline=_outline,
    keeps=_keeps,
    verdict=_verdict,
    forecast=_forecast,
    refit=_refit,
)
