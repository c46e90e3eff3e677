"""A user frame from points touched with a pointer: origin, a point on +x, a point on the +y side; more make it surer.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.3.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, TypeAdapter
from pydantic_core import to_jsonable_python

from calibration.geometry import Pose
from calibration.points.frames import TaughtFrame, frame_from_more_points, frame_from_three_points
from drivers.interfaces import Instruction
from procedures.canonical import sha256_of
from procedures.entry import Entry, Keepsake, Phase
from procedures.forecast import ANSWER_S, PERSON_S, Forecast, Knowledge, Prediction
from procedures.judged_write import (
    WriteAnyway,
    frame_changes,
    ordered,
    refuse_failed,
    shift_told,
    with_verdict,
)
from procedures.limits import FRAME, AccuracyClass, FrameLimits, chosen, told
from procedures.past import Finding
from procedures.refit import (
    STANDS_OUT,
    FitPoint,
    Refit,
    RefitError,
    Refitted,
    TooFewPointsError,
    Use,
    kept,
    misses_in_space,
    pose_values,
    values_of,
)
from procedures.run import Run
from procedures.steps.ask import accept, ask
from procedures.steps.meters import frame_meter
from procedures.steps.pages import (
    frame_displacement,
    point_states,
    points_page,
    with_changes,
)
from procedures.steps.teach import TaughtPose, teach
from procedures.steps.write import read_user_frame, write_user_frame
from procedures.verdict import Contribution, Verdict, held, known_within

Triple = tuple[float, float, float]
Role = Literal["origin", "on_x", "in_plane", "above"]
Asked = tuple[str, Role, Instruction]  # step, what the point is, words
LEAST = 3
ORIGIN_STEP, Y_SIDE_STEP = "touch the origin", "touch a point on the y side"
_FREE: dict[Role, int] = {"origin": 0, "on_x": 1, "in_plane": 2}  # coordinates that such a point leaves open
_TAUGHT: TypeAdapter[TaughtPose] = TypeAdapter(TaughtPose)
_FRAME: TypeAdapter[TaughtFrame] = TypeAdapter(TaughtFrame)
ASSUMED_SIDE_M = 0.3  # of the triangle, in a dry run

POINTER = Instruction(
    "pointer_is_mounted", "Mount the pointer whose tip is known; keep the workpiece clamped."
)
ORIGIN = Instruction("touch_origin", "Touch the origin of the frame with the pointer.")
ON_X = Instruction("touch_on_x", "Touch a point on the +x axis, as far from the origin as possible.")
ON_XY = Instruction(
    "touch_on_xy", "Touch a point of the x-y plane on the +y side, well away from the x axis."
)
MORE_ON_X = Instruction("touch_more_on_x", "Touch another point on the +x axis.")
MORE_ON_XY = Instruction(
    "touch_more_on_xy", "Touch another point of the x-y plane, on any side of the x axis."
)
ABOVE = Instruction("touch_above", "Touch any point that lies above the plane, on the +z side.")


@dataclass(frozen=True, slots=True)
class ThreePointFrame:
    """Which user frame to write, and with which pointer it is taught."""

    frame_number: Annotated[int, Field(ge=0, le=99)]
    tip_in_flange_m: Triple
    sigma_m: Annotated[float, Field(gt=0, le=0.1)] = 0.0005  # of one coordinate of one touch
    more_on_x: Annotated[int, Field(ge=0, le=20)] = 0  # further points; the frame is fitted by least squares
    more_in_plane: Annotated[int, Field(ge=0, le=50)] = 0
    check_above: bool = False  # one more touch, which catches points taught in the wrong order
    accuracy_class: AccuracyClass = "B"
    limits: FrameLimits | None = None
    write_anyway: WriteAnyway = ""


@dataclass(frozen=True, slots=True)
class FrameSetup:
    """The user frame as written and read back, and how well it is known."""

    frame_number: int
    taught: TaughtFrame
    before: Pose
    read_back: Pose


async def three_point_frame(run: Run, spec: ThreePointFrame) -> FrameSetup:
    """Construct a user frame from three touched points and write it."""
    await run.ensure("the pointer is mounted", ask, POINTER)
    before = await run.step("read the user frame", read_user_frame, spec.frame_number)

    poses: dict[Role, list[Pose]] = {"origin": [], "on_x": [], "in_plane": [], "above": []}
    asked = _asked(spec)
    for number, (step, role, instruction) in enumerate(asked):
        shown = _on_page(spec, asked, number, instruction, poses)
        poses[role].append((await run.step(step, teach, shown)).base_flange)

    taught = await run.solve(
        "construct the frame",
        construct_frame,
        spec,
        poses["origin"][0],
        tuple(poses["on_x"]),
        tuple(poses["in_plane"]),
        poses["above"][0] if spec.check_above else None,
    )
    base_user = taught.base_frame
    verdict = _judge(spec, taught)
    refuse_failed(verdict, spec.write_anyway, taught)
    result, sha256 = _shown(spec, taught, before, verdict), sha256_of(to_jsonable_python(base_user))
    await run.step("accept the result", accept, result, sha256)
    read_back = await run.write("write the user frame", write_user_frame, spec.frame_number, base_user)
    return FrameSetup(spec.frame_number, taught, before, read_back)


def _asked(spec: ThreePointFrame) -> tuple[Asked, ...]:
    """Return every point in the order of teaching: its step, what it is, and what the technician is told."""
    return (
        (ORIGIN_STEP, "origin", ORIGIN),
        ("touch a point on x", "on_x", ON_X),
        (Y_SIDE_STEP, "in_plane", ON_XY),
        *((f"touch another point on x {k}", "on_x", MORE_ON_X) for k in range(1, spec.more_on_x + 1)),
        *(
            (f"touch another point of the plane {k}", "in_plane", MORE_ON_XY)
            for k in range(1, spec.more_in_plane + 1)
        ),
        *((("touch a point above", "above", ABOVE),) if spec.check_above else ()),
    )


def _on_page(
    spec: ThreePointFrame,
    asked: tuple[Asked, ...],
    number: int,
    instruction: Instruction,
    poses: Mapping[Role, list[Pose]],
) -> Instruction:
    limits = chosen(FRAME, spec.accuracy_class, spec.limits)
    tip = spec.tip_in_flange_m
    meter = frame_meter(
        asked[number][1],
        {role: [tip_in_base(pose, tip) for pose in taught] for role, taught in poses.items()},
        tip_in_flange_m=tip,
        sigma_m=spec.sigma_m,
        limits=(limits.origin_m, limits.angle_rad),
    )
    return points_page(instruction, point_states([step for step, _, _ in asked], number), meter)


def construct_frame(
    spec: ThreePointFrame,
    origin: Pose,
    on_x: tuple[Pose, ...],
    in_plane: tuple[Pose, ...],
    above: Pose | None,
) -> TaughtFrame:
    """Return the frame through the pointer's tip at these flange poses; fitted where there are more than three."""
    tip = spec.tip_in_flange_m
    origin_m, on_x_m = tip_in_base(origin, tip), [tip_in_base(base_flange, tip) for base_flange in on_x]
    in_plane_m = [tip_in_base(base_flange, tip) for base_flange in in_plane]
    above_m = None if above is None else tip_in_base(above, tip)
    if len(on_x_m) + len(in_plane_m) > 2:
        return frame_from_more_points(origin_m, on_x_m, in_plane_m, above_m=above_m, sigma_m=spec.sigma_m)
    return frame_from_three_points(origin_m, on_x_m[0], in_plane_m[0], above_m=above_m, sigma_m=spec.sigma_m)


def tip_in_base(base_flange: Pose, tip_in_flange_m: Triple) -> Triple:
    """Return where the pointer's tip is."""
    x, y, z = base_flange.rotation() @ np.array(tip_in_flange_m) + np.array(base_flange.position_m)
    return (float(x), float(y), float(z))


def _shown(spec: ThreePointFrame, taught: TaughtFrame, before: Pose, verdict: Verdict) -> Instruction:
    x, y, z = (value * 1e3 for value in taught.base_frame.position_m)
    turn = max(taught.rotation_sigma_rad) * 2e3
    found = Instruction(
        "accept_frame",
        f"User frame {spec.frame_number}: origin x {x:.2f}, y {y:.2f}, z {z:.2f} mm from the base; its axes "
        f"are known to {turn:.2f} mm per metre (k=2). {shift_told(before, taught.base_frame)}",
    )
    asked = with_verdict(found, verdict, "Write it to the controller?", spec.write_anyway, writes=True)
    moved = frame_displacement(before, taught.base_frame)
    return with_changes(asked, frame_changes(before, taught.base_frame), **moved)


def _outline(spec: ThreePointFrame) -> tuple[Phase, ...]:
    return (
        Phase("read the user frame"),
        *(Phase("touch the origin"), Phase("touch a point on x"), Phase("touch a point on the y side")),
        *((Phase("touch another point on x", spec.more_on_x),) if spec.more_on_x else ()),
        *((Phase("touch another point of the plane", spec.more_in_plane),) if spec.more_in_plane else ()),
        *((Phase("touch a point above"),) if spec.check_above else ()),
        *(Phase("construct the frame"), Phase("accept the result"), Phase("write the user frame")),
    )


def _keeps(spec: ThreePointFrame, result: FrameSetup) -> Keepsake:
    return Keepsake("user_frame", str(spec.frame_number), result)


_NONE_TO_SPARE = "Three points fix a frame without one to spare: a wrong touch leaves no trace in a residual."


def _verdict(spec: ThreePointFrame, result: FrameSetup) -> Verdict:
    verdict = ordered(_judge(spec, result.taught), spec.write_anyway)
    return replace(verdict, changes=frame_changes(result.before, result.read_back))


def _judge(spec: ThreePointFrame, taught: TaughtFrame) -> Verdict:
    limits = chosen(FRAME, spec.accuracy_class, spec.limits)
    origin_u, turn_u = max(taught.origin_sigma_m), max(taught.rotation_sigma_rad)
    budget = Contribution("one coordinate of one touch, sigma_m", spec.sigma_m, "estimated")
    origin = known_within("origin of the frame", "m", u=origin_u, limit=limits.origin_m)
    turn = known_within("direction of the frame's axes", "rad", u=turn_u, limit=limits.angle_rad)
    above = held("handedness: a point above lies on +z", True, "refused where it does not")
    unseen = ("Nothing was touched on the +z side: the order of the points was not checked.",)
    return Verdict(
        (origin.with_budget(budget), turn, *((above,) if spec.check_above else ())),
        limits_from=told(spec.accuracy_class, spec.limits),
        not_verified=(
            *(() if taught.redundancy else (_NONE_TO_SPARE,)),
            "The pointer's tip was taken as given.",
            *(() if spec.check_above else unseen),
        ),
    )


def _forecast(spec: ThreePointFrame, known: Knowledge) -> Forecast:
    del known
    side = ASSUMED_SIDE_M
    points = ((0.0, 0.0, 0.0), (side, 0.0, 0.0), (0.0, side, 0.0))
    taught = frame_from_three_points(*points, sigma_m=spec.sigma_m)
    origin = {name: limit.origin_m for name, limit in FRAME.items()}
    turn = {name: limit.angle_rad for name, limit in FRAME.items()}
    count = 4 if spec.check_above else 3
    return Forecast(
        duration_s=count * PERSON_S + 2.0 * ANSWER_S,
        predictions=(
            Prediction("origin of the frame", 2.0 * max(taught.origin_sigma_m), "m", origin),
            Prediction("direction of the frame's axes", 2.0 * max(taught.rotation_sigma_rad), "rad", turn),
        ),
        assumed=(
            f"{count} points touched by a person, a minute each",
            f"the points are {side * 1e3:.0f} mm apart, at a right angle",
            f"a touch is good to {spec.sigma_m * 1e3:.2f} mm per coordinate (sigma_m)",
        ),
    )


def _refit(spec: ThreePointFrame, findings: Sequence[Finding]) -> Refit:
    found = values_of(findings)
    asked = [(step, role) for step, role, _ in _asked(spec) if role != "above"]
    poses = {step: _TAUGHT.validate_python(found[step]).base_flange for step, _ in asked}
    above = _TAUGHT.validate_python(found["touch a point above"]).base_flange if spec.check_above else None
    recorded = _FRAME.validate_python(found["construct the frame"]).base_frame

    def solve(use: Use) -> Refitted:
        used = kept(asked, use)
        for step in (ORIGIN_STEP, Y_SIDE_STEP):
            if step not in dict(used):
                raise RefitError(
                    f"the frame cannot do without {step!r}.",
                    remedy="Leave another point out, or touch this one anew in a new run.",
                )
        by_role = {wanted: tuple(poses[step] for step, role in used if role == wanted) for _, wanted in asked}
        if not by_role["on_x"]:
            raise TooFewPointsError(len(used), LEAST)
        taught = construct_frame(spec, by_role["origin"][0], by_role["on_x"], by_role["in_plane"], above)
        back = taught.base_frame.inverse()
        gaps = [tip_in_base(back @ poses[step], spec.tip_in_flange_m)[_FREE[role] :] for step, role in asked]
        misses = misses_in_space(gaps, spec.sigma_m, STANDS_OUT)
        return Refitted(misses, 2.0 * max(taught.origin_sigma_m), pose_values(taught.base_frame, recorded))

    return Refit("place", tuple(FitPoint(step) for step, _ in asked), LEAST, "origin", solve)


ENTRY = Entry(
    name="three_point_frame",
    title="User frame from three points",
    version=2,
    procedure=three_point_frame,
    spec_type=ThreePointFrame,
    needs=("writes_user_frame",),
    outline=_outline,
    keeps=_keeps,
    verdict=_verdict,
    forecast=_forecast,
    refit=_refit,
)
