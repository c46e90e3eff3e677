"""The workpiece moved: the same points touched again give the offset of its user frame.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.3,
Eq. 7-8: with the offset written into the user frame, every recorded point goes along with the workpiece.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Pose
from cellcal.calibration.points.fixture import Triple
from cellcal.calibration.points.offset_design import offset_outlook
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.canonical import sha256_of
from cellcal.procedures.entry import Entry, Keepsake, Phase
from cellcal.procedures.forecast import ANSWER_S, PERSON_S, Forecast, Knowledge, Prediction
from cellcal.procedures.judged_write import (
    first_of,
    frame_changes,
    ordered,
    refuse_failed,
    with_verdict,
)
from cellcal.procedures.past import Finding
from cellcal.procedures.questions import accept, ask
from cellcal.procedures.refit import (
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
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.steps.meters import known_points_meter, tip_in_base
from cellcal.procedures.steps.pages import point_states, points_page, with_changes
from cellcal.procedures.steps.teach import TaughtPose, teach
from cellcal.procedures.steps.write import read_user_frame, write_user_frame
from cellcal.procedures.teaching.moved_frame import (
    FoundOffset,
    FrameOffset,
    Touched,
    find_offset,
    further_touches,
    outlook,
    points_in_frame,
    saving,
)
from cellcal.procedures.verdict import Verdict, held, known_within, stated

__all__ = ["ENTRY", "FrameOffset", "OffsetResult", "frame_offset"]

POINTER = Instruction(
    "pointer_is_mounted", "Mount the pointer whose tip is known; clamp the workpiece in its new place."
)
ABOVE = Instruction(
    "touch_above", "Touch any point that lies above the workpiece's x-y plane, on the +z side."
)


@dataclass(frozen=True, slots=True)
class OffsetResult:
    """The user frame as written and read back, and by how much the workpiece moved."""

    frame_number: int
    found: FoundOffset
    before: Pose  # as the controller had it; the frame before the move may have been given otherwise
    read_back: Pose


LEAST = 3
ABOVE_STEP, AGAIN_STEP = "touch a point above", "touch a point again"
_TAUGHT: TypeAdapter[TaughtPose] = TypeAdapter(TaughtPose)
_FOUND: TypeAdapter[FoundOffset] = TypeAdapter(FoundOffset)


async def frame_offset(run: Run, spec: FrameOffset) -> OffsetResult:
    """Touch known points of a moved workpiece, and move its user frame with it."""
    await run.ensure("the pointer is mounted", ask, POINTER)
    before = await run.step("read the user frame", read_user_frame, spec.frame_number)
    old = spec.old_frame or before

    points = points_in_frame(spec, old)  # those that fix no frame are refused before anybody touches them

    touches = await _touch_points(run, spec, points)
    above = None
    if spec.check_above:
        above = (
            await run.step(ABOVE_STEP, teach, _above_on_page(spec.named, len(touches) - spec.named))
        ).base_flange

    found = await run.solve("find the offset", find_offset, spec, old, touches, above)
    first_of((_bad_shape(found), _badly_known(found, spec)), spec.write_anyway)
    verdict = _judge(spec, found)
    refuse_failed(verdict, spec.write_anyway, found)
    shown, sha256 = _shown(spec, found, verdict), sha256_of(to_jsonable_python(found.base_frame_new))
    await run.step("accept the result", accept, shown, sha256)
    new = found.base_frame_new
    read_back = await run.write("write the user frame", write_user_frame, spec.frame_number, new)
    return OffsetResult(spec.frame_number, found, before, read_back)


async def _touch_points(run: Run, spec: FrameOffset, points: tuple[Triple, ...]) -> tuple[Touched, ...]:
    """Have every point touched, and those again that tell most, until the frame will be known well enough."""
    touches: list[Touched] = []
    for k in range(spec.named):
        taught = await run.step(f"touch point {k + 1}", teach, _on_page(spec, k, touches))
        touches.append(Touched(k, taught.base_flange))
    for number, k in enumerate(further_touches(spec, points), 1):
        taught = await run.step(f"{AGAIN_STEP} {number}", teach, _again_on_page(spec, k, touches))
        touches.append(Touched(k, taught.base_flange))
    return tuple(touches)


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


def _on_page(spec: FrameOffset, k: int, touches: list[Touched]) -> Instruction:
    in_frame = bool(spec.points_in_frame_m)
    known = spec.points_in_frame_m or spec.old_points_in_base_m
    x, y, z = (v * 1e3 for v in known[k])
    where = "in the user frame" if in_frame else "from the base before the move"
    asked = Instruction(
        f"touch_point_{k + 1}",
        f"Touch point {k + 1} of the workpiece with the pointer (x {x:.1f}, y {y:.1f}, z {z:.1f} mm {where}).",
    )
    names = [f"touch point {number}" for number in range(1, len(known) + 1)]
    meter = known_points_meter(k, known, _tips(spec, touches), spec.tip_in_flange_m)
    return points_page(asked, point_states(names, k), meter)


def _again_on_page(spec: FrameOffset, k: int, touches: list[Touched]) -> Instruction:
    known = spec.points_in_frame_m or spec.old_points_in_base_m
    asked = Instruction(
        f"touch_point_{k + 1}_again",
        f"Go away from point {k + 1} and touch it once more: it tells most of what is not known well enough yet.",
    )
    further = len(touches) - len(known) + 1
    names = [f"touch point {number}" for number in range(1, len(known) + 1)]
    names += [f"{AGAIN_STEP} {number}" for number in range(1, further + 1)]
    seen = [known[touch.point] for touch in touches]
    meter = known_points_meter(len(seen), [*seen, known[k]], _tips(spec, touches), spec.tip_in_flange_m)
    return points_page(asked, point_states(names, len(touches)), meter)


def _tips(spec: FrameOffset, touches: list[Touched]) -> list[Triple]:
    return [tip_in_base(touch.base_flange, spec.tip_in_flange_m) for touch in touches]


def _above_on_page(touched: int, further: int) -> Instruction:
    names = [f"touch point {k}" for k in range(1, touched + 1)]
    names += [f"{AGAIN_STEP} {k}" for k in range(1, further + 1)]
    return points_page(ABOVE, point_states([*names, ABOVE_STEP], touched + further), None)


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
    points = _known_points(spec)
    return (
        Phase("read the user frame"),
        Phase("touch point", spec.named),
        Phase(
            "touch a point again", 0 if points is None else len(further_touches(spec, points)), adaptive=True
        ),
        *((Phase("touch a point above"),) if spec.check_above else ()),
        *(Phase("find the offset"), Phase("accept the result"), Phase("write the user frame")),
    )


def _known_points(spec: FrameOffset) -> tuple[Triple, ...] | None:
    """Return the points in the user frame as far as the settings tell them; None where they fix no frame."""
    try:
        return points_in_frame(spec, spec.old_frame or Pose((0.0, 0.0, 0.0)))
    except CalibrationError:
        return None  # refused when it is run


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
                limit=found.placed.most_chi_square,
            ),
            stated("shift of the origin", found.shift_m, "m"),
            stated("turn", found.turn_rad, "rad"),
            stated("shift of the far end", found.far_shift_m, "m"),
        ),
        limits_from="limits of the settings",
        not_verified=("the workpiece's other points: only those touched were looked at",),
        remarks=(saving(spec, found),) if found.touches else (),
    )


def _forecast(spec: FrameOffset, known: Knowledge) -> Forecast:
    del known
    framed = bool(spec.points_in_frame_m) or spec.old_frame is not None
    points = points_in_frame(spec, spec.old_frame or Pose((0.0, 0.0, 0.0)))
    planned = outlook(spec, points)
    touches = spec.named + len(further_touches(spec, points))
    told = planned if planned.reached else offset_outlook(points, [1] * len(points), spec.goal, spec.named)
    origin_mm, angle_deg = spec.origin_u_m * 1e3, math.degrees(spec.angle_u_rad)
    words = f"after {touches} touches; {origin_mm:.2f} mm and {angle_deg:.3f} deg are asked for"
    at_origin = Prediction("frame's origin", told.origin_u_m, "m", sentence=words)
    return Forecast(
        duration_s=(touches + spec.check_above + 1) * PERSON_S + 2.0 * ANSWER_S,
        predictions=(
            *((at_origin,) if framed else ()),
            Prediction("frame's angle", told.angle_u_rad, "rad", sentence=words),
        ),
        assumed=(
            "a person brings the pointer to every point",
            f"a touch is good to {spec.sigma_m * 1e3:.2f} mm per coordinate (sigma_m), "
            f"a given point to {spec.old_sigma_m * 1e3:.2f} mm (old_sigma_m)",
        ),
        not_checked=() if framed else ("the frame's origin: where the frame is now is read in the run",),
    )


def _refit(spec: FrameOffset, findings: Sequence[Finding]) -> Refit:
    found = values_of(findings)
    recorded = _FOUND.validate_python(found["find the offset"])
    known, old = points_in_frame(spec, recorded.base_frame_old), recorded.base_frame_old
    again = further_touches(spec, known)
    steps = tuple(f"touch point {k}" for k in range(1, len(known) + 1))
    steps += tuple(f"{AGAIN_STEP} {k}" for k in range(1, len(again) + 1))
    touches = tuple(
        Touched(k, _TAUGHT.validate_python(found[step]).base_flange)
        for k, step in zip((*range(len(known)), *again), steps, strict=True)
    )
    above = _TAUGHT.validate_python(found[ABOVE_STEP]).base_flange if spec.check_above else None

    def solve(use: Use) -> Refitted:
        used = kept(touches, use)
        left = sorted({touch.point for touch in used})
        fewer = replace(
            spec,
            points_in_frame_m=tuple(known[k] for k in left),
            old_points_in_base_m=(),
            far_point_in_frame_m=recorded.far_point_in_frame_m,
        )
        renumbered = tuple(Touched(left.index(touch.point), touch.base_flange) for touch in used)
        offset = find_offset(fewer, old, renumbered, above)
        back = offset.base_frame_new.inverse()
        gaps = [
            np.subtract(
                tip_in_base(back @ touch.base_flange, spec.tip_in_flange_m), known[touch.point]
            ).tolist()
            for touch in touches
        ]
        misses = misses_in_space(gaps, math.hypot(spec.sigma_m, spec.old_sigma_m), STANDS_OUT)
        values = pose_values(offset.base_frame_new, recorded.base_frame_new)
        return Refitted(misses, offset.placed.origin_u_m, values)

    return Refit("place", tuple(FitPoint(step) for step in steps), LEAST, "origin", solve)


ENTRY = Entry(
    name="frame_offset",
    title="Offset of a user frame after the workpiece moved",
    version=3,
    procedure=frame_offset,
    spec_type=FrameOffset,
    needs=("writes_user_frame",),
    outline=_outline,
    keeps=_keeps,
    verdict=_verdict,
    forecast=_forecast,
    refit=_refit,
)
