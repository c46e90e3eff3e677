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
from cellcal.calibration.message import make_message
from cellcal.calibration.points.fixture import Triple
from cellcal.calibration.points.offset_design import predict_offset
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.forecast import ANSWER_S, PERSON_S, Forecast, Knowledge, Prediction
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.refit import (
    STANDS_OUT,
    FitPoint,
    Refit,
    RefitResult,
    Use,
    misses_in_space,
    pose_values,
    used_values,
    values_of,
)
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.run_history import Finding
from cellcal.procedures.steps.meters import known_points_meter, tip_in_base
from cellcal.procedures.steps.pages import point_states, points_page, with_changes
from cellcal.procedures.steps.teach import TaughtPose, teach_pose
from cellcal.procedures.steps.write import read_user_frame, write_user_frame
from cellcal.procedures.teaching.moved_frame import (
    FoundFrameOffset,
    FrameOffset,
    PointTouch,
    exchange_remarks,
    find_offset,
    further_touches,
    points_in_frame,
    predict_touches,
    saving_text,
)
from cellcal.procedures.teaching.point_remarks import with_remarks
from cellcal.procedures.verdict import (
    ProcedureVerdict,
    chi_square_rule,
    known_within,
    state_fact,
    state_figure,
)
from cellcal.procedures.write_review import (
    frame_changes,
    raise_first,
    refuse_failed,
    with_order_remark,
    with_verdict,
)

__all__ = ["DEFINITION", "FrameOffset", "OffsetResult", "frame_offset"]

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
    found: FoundFrameOffset
    before: Pose  # as the controller had it; the frame before the move may have been given otherwise
    read_back: Pose


LEAST = 3
ABOVE_STEP, AGAIN_STEP = "touch a point above", "touch a point again"
_TAUGHT: TypeAdapter[TaughtPose] = TypeAdapter(TaughtPose)
_FOUND: TypeAdapter[FoundFrameOffset] = TypeAdapter(FoundFrameOffset)


async def frame_offset(run: Run, spec: FrameOffset) -> OffsetResult:
    """Touch known points of a moved workpiece, and move its user frame with it."""
    await run.ensure("the pointer is mounted", ask_confirmation, POINTER)
    before = await run.step("read the user frame", read_user_frame, spec.frame_number)
    old = spec.old_frame or before

    points = points_in_frame(spec, old)  # those that fix no frame are refused before they are touched

    touches = await _touch_points(run, spec, points)
    above = None
    if spec.check_above:
        above = (
            await run.step(
                ABOVE_STEP, teach_pose, _touch_above_page(spec.named_count, len(touches) - spec.named_count)
            )
        ).base_flange

    found = await run.solve("find the offset", find_offset, spec, old, touches, above)
    raise_first((_bad_shape_error(found), _uncertain_error(found, spec)), spec.write_anyway)
    verdict = _judge_result(spec, found)
    refuse_failed(verdict, spec.write_anyway, found)
    shown, sha256 = (
        _result_instruction(spec, found, verdict),
        sha256_of(to_jsonable_python(found.base_frame_new)),
    )
    await run.step("accept the result", ask_acceptance, shown, sha256)
    new = found.base_frame_new
    read_back = await run.write("write the user frame", write_user_frame, spec.frame_number, new)
    return OffsetResult(spec.frame_number, found, before, read_back)


async def _touch_points(run: Run, spec: FrameOffset, points: tuple[Triple, ...]) -> tuple[PointTouch, ...]:
    """Have every point touched, and those again that tell most, until the frame will be known well enough."""
    touches: list[PointTouch] = []
    for k in range(spec.named_count):
        taught = await run.step(f"touch point {k + 1}", teach_pose, _touch_page(spec, k, touches))
        touches.append(PointTouch(k, taught.base_flange))
    for number, k in enumerate(further_touches(spec, points), 1):
        taught = await run.step(f"{AGAIN_STEP} {number}", teach_pose, _touch_again_page(spec, k, touches))
        touches.append(PointTouch(k, taught.base_flange))
    return tuple(touches)


def _bad_shape_error(found: FoundFrameOffset) -> RefusalError | None:
    placed = found.placed
    if placed.is_consistent():
        return None
    return RefusalError(
        make_message(
            "points {i} and {j} are {worst_gap_mm:.2f} mm {detail} each other than before the move "
            "({worst_deviation:.1f} deviations): this is not the same shape",
            **placed.worst_gap_arguments(),
        ),
        code="procedure.wrong_shape",
        remedy="See that the points are those listed, in this order, and that pointer and workpiece are whole.",
        evidence=found,
    )


def _uncertain_error(found: FoundFrameOffset, spec: FrameOffset) -> RefusalError | None:
    placed = found.placed
    if placed.origin_u_m <= spec.origin_u_m and placed.angle_u_rad <= spec.angle_u_rad:
        return None
    return RefusalError(
        make_message(
            "the moved frame is known within {origin_u_mm:.2f} mm and {angle_u_deg:.3f} deg (k=2); "
            "{origin_limit_mm:.2f} mm and {angle_limit_deg:.3f} deg are asked for",
            origin_u_mm=placed.origin_u_m * 1000.0,
            angle_u_deg=math.degrees(placed.angle_u_rad),
            origin_limit_mm=spec.origin_u_m * 1000.0,
            angle_limit_deg=math.degrees(spec.angle_u_rad),
        ),
        code="procedure.undecided",
        remedy="Touch more points, or points further apart.",
        evidence=found,
    )


def _touch_page(spec: FrameOffset, k: int, touches: list[PointTouch]) -> Instruction:
    in_frame = bool(spec.points_in_frame_m)
    points_m = spec.points_in_frame_m or spec.old_points_in_base_m
    x, y, z = (v * 1e3 for v in points_m[k])
    where = "in the user frame" if in_frame else "from the base before the move"
    instruction = Instruction(
        f"touch_point_{k + 1}",
        make_message(
            "Touch point {k} of the workpiece with the pointer (x {x:.1f}, y {y:.1f}, z {z:.1f} mm {where}).",
            k=k + 1,
            x=x,
            y=y,
            z=z,
            where=where,
        ),
    )
    names = [f"touch point {number}" for number in range(1, len(points_m) + 1)]
    meter = known_points_meter(k, points_m, _tip_positions(spec, touches), spec.tip_in_flange_m)
    return points_page(instruction, point_states(names, k), meter)


def _touch_again_page(spec: FrameOffset, k: int, touches: list[PointTouch]) -> Instruction:
    points_m = spec.points_in_frame_m or spec.old_points_in_base_m
    instruction = Instruction(
        f"touch_point_{k + 1}_again",
        make_message(
            "Go away from point {k} and touch it once more: it tells most of what is not known well "
            "enough yet.",
            k=k + 1,
        ),
    )
    further = len(touches) - len(points_m) + 1
    names = [f"touch point {number}" for number in range(1, len(points_m) + 1)]
    names += [f"{AGAIN_STEP} {number}" for number in range(1, further + 1)]
    touched_points = [points_m[touch.point] for touch in touches]
    meter = known_points_meter(
        len(touched_points),
        [*touched_points, points_m[k]],
        _tip_positions(spec, touches),
        spec.tip_in_flange_m,
    )
    return points_page(instruction, point_states(names, len(touches)), meter)


def _tip_positions(spec: FrameOffset, touches: list[PointTouch]) -> list[Triple]:
    return [tip_in_base(touch.base_flange, spec.tip_in_flange_m) for touch in touches]


def _touch_above_page(touched: int, further: int) -> Instruction:
    names = [f"touch point {k}" for k in range(1, touched + 1)]
    names += [f"{AGAIN_STEP} {k}" for k in range(1, further + 1)]
    return points_page(ABOVE, point_states([*names, ABOVE_STEP], touched + further), None)


def _result_instruction(spec: FrameOffset, found: FoundFrameOffset, verdict: ProcedureVerdict) -> Instruction:
    before = ", ".join(f"{v * 1e3:.2f}" for v in found.base_frame_old.position_m)
    after = ", ".join(f"{v * 1e3:.2f}" for v in found.base_frame_new.position_m)
    x, y, z = (v * 1e3 for v in found.old_new.position_m)
    shown = Instruction(
        "accept_offset",
        make_message(
            "User frame {frame_number}: origin {before} mm before, {after} mm after, from the base. "
            "The workpiece moved by x {x:.2f}, y {y:.2f}, z {z:.2f} mm in its old frame and turned "
            "by {turn_deg:.3f} deg; its far end moved by {far_shift_mm:.2f} mm. Known within "
            "{origin_u_mm:.2f} mm and {angle_u_deg:.3f} deg (k=2).",
            frame_number=spec.frame_number,
            before=before,
            after=after,
            x=x,
            y=y,
            z=z,
            turn_deg=math.degrees(found.turn_rad),
            far_shift_mm=found.far_shift_m * 1000.0,
            origin_u_mm=found.placed.origin_u_m * 1000.0,
            angle_u_deg=math.degrees(found.placed.angle_u_rad),
        ),
    )
    shown = replace(shown, text=with_remarks(shown.text, exchange_remarks(spec, found)))
    question = "Write it to the controller? Every point recorded in this frame goes along."
    instruction = with_verdict(shown, verdict, question, spec.write_anyway, writes=True)
    changed = frame_changes(found.base_frame_old, found.base_frame_new)
    return with_changes(instruction, changed, most_m=found.far_shift_m, at="far_point")


def _outline_phases(spec: FrameOffset) -> tuple[Phase, ...]:
    points = _known_points(spec)
    return (
        Phase("read the user frame"),
        Phase("touch point", spec.named_count),
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


def _results_to_store(spec: FrameOffset, result: OffsetResult) -> StoredResult:
    return StoredResult("user_frame", str(spec.frame_number), result)


def _make_verdict(spec: FrameOffset, result: OffsetResult) -> ProcedureVerdict:
    verdict = with_order_remark(_judge_result(spec, result.found), spec.write_anyway)
    return replace(verdict, changes=frame_changes(result.before, result.read_back))


def _judge_result(spec: FrameOffset, found: FoundFrameOffset) -> ProcedureVerdict:
    return ProcedureVerdict(
        characteristics=(
            known_within("frame's origin", "m", u=found.placed.origin_u_m / 2.0, limit=spec.origin_u_m),
            known_within("frame's angle", "rad", u=found.placed.angle_u_rad / 2.0, limit=spec.angle_u_rad),
            state_fact(
                "shape of the points",
                found.placed.is_consistent(),
                chi_square_rule("chi square of the points touched against those given, 99.9 %"),
                found=found.placed.chi_square,
                limit=found.placed.most_chi_square,
            ),
            state_figure("shift of the origin", found.shift_m, "m"),
            state_figure("turn", found.turn_rad, "rad"),
            state_figure("shift of the far end", found.far_shift_m, "m"),
        ),
        limits_from="limits of the settings",
        not_verified=("the workpiece's other points: only those touched were looked at",),
        remarks=(*((saving_text(spec, found),) if found.touches else ()), *exchange_remarks(spec, found)),
    )


def _forecast_run(spec: FrameOffset, knowledge: Knowledge) -> Forecast:
    del knowledge
    framed = bool(spec.points_in_frame_m) or spec.old_frame is not None
    points = points_in_frame(spec, spec.old_frame or Pose((0.0, 0.0, 0.0)))
    planned = predict_touches(spec, points)
    touches = spec.named_count + len(further_touches(spec, points))
    expected = (
        planned
        if planned.reached
        else predict_offset(points, [1] * len(points), spec.offset_goal, spec.named_count)
    )
    origin_mm, angle_deg = spec.origin_u_m * 1e3, math.degrees(spec.angle_u_rad)
    words = make_message(
        "after {touches} touches; {origin_mm:.2f} mm and {angle_deg:.3f} deg are asked for",
        touches=touches,
        origin_mm=origin_mm,
        angle_deg=angle_deg,
    )
    at_origin = Prediction("frame's origin", expected.origin_u_m, "m", sentence=words)
    return Forecast(
        duration_s=(touches + spec.check_above + 1) * PERSON_S + 2.0 * ANSWER_S,
        predictions=(
            *((at_origin,) if framed else ()),
            Prediction("frame's angle", expected.angle_u_rad, "rad", sentence=words),
        ),
        assumed=(
            "a person brings the pointer to every point",
            make_message(
                "a touch is good to {sigma_mm:.2f} mm per coordinate (sigma_m), a given point to "
                "{old_sigma_mm:.2f} mm (old_sigma_m)",
                sigma_mm=spec.sigma_m * 1000.0,
                old_sigma_mm=spec.old_sigma_m * 1000.0,
            ),
        ),
        not_checked=() if framed else ("the frame's origin: where the frame is now is read in the run",),
    )


def _make_refit(spec: FrameOffset, findings: Sequence[Finding]) -> Refit:
    found = values_of(findings)
    recorded = _FOUND.validate_python(found["find the offset"])
    points_m, old = points_in_frame(spec, recorded.base_frame_old), recorded.base_frame_old
    again = further_touches(spec, points_m)
    steps = tuple(f"touch point {k}" for k in range(1, len(points_m) + 1))
    steps += tuple(f"{AGAIN_STEP} {k}" for k in range(1, len(again) + 1))
    touches = tuple(
        PointTouch(k, _TAUGHT.validate_python(found[step]).base_flange)
        for k, step in zip((*range(len(points_m)), *again), steps, strict=True)
    )
    above = _TAUGHT.validate_python(found[ABOVE_STEP]).base_flange if spec.check_above else None

    def solve_again(use: Use) -> RefitResult:
        used = used_values(touches, use)
        point_numbers = sorted({touch.point for touch in used})
        fewer = replace(
            spec,
            points_in_frame_m=tuple(points_m[k] for k in point_numbers),
            old_points_in_base_m=(),
            far_point_in_frame_m=recorded.far_point_in_frame_m,
        )
        renumbered = tuple(PointTouch(point_numbers.index(touch.point), touch.base_flange) for touch in used)
        offset = find_offset(fewer, old, renumbered, above)
        back = offset.base_frame_new.inverse()
        gaps = [
            np.subtract(
                tip_in_base(back @ touch.base_flange, spec.tip_in_flange_m), points_m[touch.point]
            ).tolist()
            for touch in touches
        ]
        misses = misses_in_space(gaps, math.hypot(spec.sigma_m, spec.old_sigma_m), STANDS_OUT)
        values = pose_values(offset.base_frame_new, recorded.base_frame_new)
        return RefitResult(misses, offset.placed.origin_u_m, values)

    return Refit("place", tuple(FitPoint(step) for step in steps), LEAST, "origin", solve_again)


DEFINITION = ProcedureDefinition(
    name="frame_offset",
    title="Offset of a user frame after the workpiece moved",
    version=3,
    procedure=frame_offset,
    spec_type=FrameOffset,
    needs=("writes_user_frame",),
    commands_motion=False,
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
    refit=_make_refit,
)
