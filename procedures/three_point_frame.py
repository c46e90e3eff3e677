"""A user frame from points touched with a pointer: origin, a point on +x, a point on the +y side; more make it surer.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.3.
"""

from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import Field
from pydantic_core import to_jsonable_python

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.points.frame_design import (
    FrameGoal,
    FramePoint,
    FramePrediction,
    FrameRole,
    predict_frame,
)
from cellcal.calibration.points.frames import TaughtFrame, is_pointing_down
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.accuracy_limits import FRAME, AccuracyClass, FrameLimits, limits_in_force, limits_text
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.forecast import ANSWER_S, PERSON_S, Forecast, Knowledge, Prediction
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.run import Run
from cellcal.procedures.setting_texts import (
    ACCURACY_CLASS,
    CHECK_ABOVE,
    FRAME_NUMBER,
    MAX_TOUCHES,
    OWN_LIMITS,
    TIP_IN_FLANGE,
    TOUCH_SIGMA,
    WRITE_ANYWAY,
    describe_setting,
)
from cellcal.procedures.steps.write import read_user_frame, write_user_frame
from cellcal.procedures.teaching.frame_refit import refit_frame
from cellcal.procedures.teaching.frame_touches import (
    ABOVE_STEP,
    ANEW_STEP,
    FrameEffort,
    FrameRules,
    Triple,
    construct_frame,
    effort_of,
    further_step,
    named_touches,
    touch_points,
)
from cellcal.procedures.verdict import (
    Contribution,
    ProcedureVerdict,
    SetAside,
    known_within,
    state_evidence,
    state_fact,
)
from cellcal.procedures.write_review import (
    WriteAnyway,
    ask_to_write_user_frame,
    frame_changes,
    refuse_failed,
    with_order_remark,
)

LEAST = 3
ASSUMED_SIDE_M = 0.3  # of the triangle, in a dry run
_ASSUMED: dict[FrameRole, Triple] = {
    "origin": (0.0, 0.0, 0.0),
    "on_x": (ASSUMED_SIDE_M, 0.0, 0.0),
    "in_plane": (0.0, ASSUMED_SIDE_M, 0.0),
}

POINTER = Instruction(
    "pointer_is_mounted", "Mount the pointer whose tip is known; keep the workpiece clamped."
)


@dataclass(frozen=True, slots=True)
class ThreePointFrame:
    """Which user frame to write, and with which pointer it is taught."""

    frame_number: Annotated[int, Field(ge=0, le=99), FRAME_NUMBER]
    tip_in_flange_m: Annotated[Triple, TIP_IN_FLANGE]
    sigma_m: Annotated[float, Field(gt=0, le=0.1), TOUCH_SIGMA] = 0.0005
    more_on_x: Annotated[
        int,
        Field(ge=0, le=20),
        describe_setting(
            "Further points along x",
            "So many more points are touched along the x axis in any case.",
            "effort",
            unit="1",
        ),
    ] = 0
    more_in_plane: Annotated[
        int,
        Field(ge=0, le=50),
        describe_setting(
            "Further points on the surface",
            "So many more points are touched on the x-y surface in any case.",
            "effort",
            unit="1",
        ),
    ] = 0
    max_touches: Annotated[int, Field(ge=3, le=100), MAX_TOUCHES] = 12
    check_above: Annotated[bool, CHECK_ABOVE] = False
    accuracy_class: Annotated[AccuracyClass, ACCURACY_CLASS] = "B"
    limits: Annotated[FrameLimits | None, OWN_LIMITS] = None
    write_anyway: Annotated[WriteAnyway, WRITE_ANYWAY] = ""

    @property
    def frame_rules(self) -> FrameRules:
        """Which points are touched, and when there are enough."""
        limits = limits_in_force(FRAME, self.accuracy_class, self.limits)
        return FrameRules(
            tip_in_flange_m=self.tip_in_flange_m,
            more_on_x=self.more_on_x,
            more_in_plane=self.more_in_plane,
            check_above=self.check_above,
            most=max(self.max_touches, LEAST + self.more_on_x + self.more_in_plane),
            goal=FrameGoal(self.sigma_m, limits.origin_m, limits.angle_rad),
        )


@dataclass(frozen=True, slots=True)
class FrameSetup:
    """The user frame as written and read back, and how well it is known."""

    frame_number: int
    taught: TaughtFrame
    before: Pose
    read_back: Pose
    effort: FrameEffort | None = None  # of frames taught before version 3 nothing is told
    set_aside: tuple[SetAside, ...] = ()


async def three_point_frame(run: Run, spec: ThreePointFrame) -> FrameSetup:
    """Construct a user frame from touched points, three and as many more as it takes, and write it."""
    await run.ensure("the pointer is mounted", ask_confirmation, POINTER)
    before = await run.step("read the user frame", read_user_frame, spec.frame_number)

    touches = await touch_points(run, spec.frame_rules)

    taught = await run.solve(
        "construct the frame", construct_frame, spec.frame_rules, touches.points, touches.above
    )
    found = FrameSetup(
        frame_number=spec.frame_number,
        taught=taught,
        before=before,
        read_back=taught.base_frame,  # as it will be, if a person wants it
        effort=effort_of(spec.frame_rules, touches, taught),
        set_aside=touches.set_aside,
    )
    verdict = _judge_result(spec, found)
    refuse_failed(verdict, spec.write_anyway, taught)
    base_user = taught.base_frame
    result, sha256 = (
        _result_instruction(spec, taught, before, verdict),
        sha256_of(to_jsonable_python(base_user)),
    )
    await run.step("accept the result", ask_acceptance, result, sha256)
    read_back = await run.write("write the user frame", write_user_frame, spec.frame_number, base_user)
    return replace(found, read_back=read_back)


def _result_instruction(
    spec: ThreePointFrame, taught: TaughtFrame, before: Pose, verdict: ProcedureVerdict
) -> Instruction:
    turn_u_rad = 2.0 * max(taught.rotation_sigma_rad)
    return ask_to_write_user_frame(
        spec.frame_number, before, taught.base_frame, turn_u_rad, verdict, spec.write_anyway
    )


def _outline_phases(spec: ThreePointFrame) -> tuple[Phase, ...]:
    named, expected = named_touches(spec.frame_rules), _predict_expected(spec)
    again = [named[k][1] for k in expected.again] if expected.reached else []
    further: dict[FrameRole, int] = {"origin": 0, "on_x": spec.more_on_x, "in_plane": spec.more_in_plane}
    return (
        Phase("read the user frame"),
        *(Phase(step) for step, _, _ in named[:LEAST]),
        *(Phase(further_step(role), n + again.count(role), adaptive=True) for role, n in further.items()),
        Phase(ANEW_STEP, 0, adaptive=True),
        *((Phase(ABOVE_STEP),) if spec.check_above else ()),
        *(Phase("construct the frame"), Phase("accept the result"), Phase("write the user frame")),
    )


def _results_to_store(spec: ThreePointFrame, result: FrameSetup) -> StoredResult:
    return StoredResult("user_frame", str(spec.frame_number), result)


_NONE_TO_SPARE = "Three points fix a frame without one to spare: a wrong touch leaves no trace in a residual."
_HANGING = (
    "z of the frame points down in the robot's base: if it should point up, two of the three points are swapped "
    "(origin and x, or x and y)."
)
_UP = (0.0, 0.0, 1.0)  # of a robot that stands on its feet
_SPARE_RULE = "PASS if the points have coordinates to compare, else UNDECIDED: touch the origin once more"


def _make_verdict(spec: ThreePointFrame, result: FrameSetup) -> ProcedureVerdict:
    verdict = with_order_remark(_judge_result(spec, result), spec.write_anyway)
    return replace(verdict, changes=frame_changes(result.before, result.read_back))


def _judge_result(spec: ThreePointFrame, found: FrameSetup) -> ProcedureVerdict:
    taught, limits = found.taught, limits_in_force(FRAME, spec.accuracy_class, spec.limits)
    origin_u, turn_u = max(taught.origin_sigma_m), max(taught.rotation_sigma_rad)
    budget = Contribution("one coordinate of one touch, sigma_m", spec.sigma_m, "estimated")
    origin = known_within("origin of the frame", "m", u=origin_u, limit=limits.origin_m)
    turn = known_within("direction of the frame's axes", "rad", u=turn_u, limit=limits.angle_rad)
    spare = state_evidence(
        "coordinates beyond those that fix the frame",
        taught.redundancy > 0,
        _SPARE_RULE,
        found=taught.redundancy,
        limit=1,
    )
    above = state_fact("handedness: a point above lies on +z", True, "refused where it does not")
    unseen = (
        "Nothing was touched on the +z side: the order of the points was not checked.",
        *((_HANGING,) if is_pointing_down(taught.base_frame, _UP) else ()),
    )
    return ProcedureVerdict(
        (origin.with_budget(budget), turn, spare, *((above,) if spec.check_above else ())),
        limits_from=limits_text(spec.accuracy_class, spec.limits),
        not_verified=(
            *(() if taught.redundancy else (_NONE_TO_SPARE,)),
            "The pointer's tip was taken as given.",
            *(() if spec.check_above else unseen),
        ),
        remarks=() if found.effort is None else (found.effort.saving_text,),
        set_aside=found.set_aside,
    )


def _predict_expected(
    spec: ThreePointFrame, sharper: float = 1.0, most: int | None = None
) -> FramePrediction:
    """Return what a triangle of usual size would take beyond the touches that are made in any case."""
    points = [FramePoint(role, _ASSUMED[role]) for _, role, _ in named_touches(spec.frame_rules)]
    goal = spec.frame_rules.goal
    goal = FrameGoal(goal.sigma_m, goal.origin_u_m / sharper, goal.angle_u_rad / sharper)
    return predict_frame(Pose((0.0, 0.0, 0.0)), points, goal, most or spec.frame_rules.most)


def _forecast_run(spec: ThreePointFrame, knowledge: Knowledge) -> Forecast:
    del knowledge
    expected, best, most = (
        _predict_expected(spec),
        _predict_expected(spec, sharper=1e3),
        spec.frame_rules.most,
    )
    named = len(named_touches(spec.frame_rules))
    after = (
        expected if expected.reached else _predict_expected(spec, most=named)
    )  # out of reach: none is asked for
    touches = named + len(after.again)
    count = touches + spec.check_above
    origin = {name: limit.origin_m for name, limit in FRAME.items()}
    turn = {name: limit.angle_rad for name, limit in FRAME.items()}
    return Forecast(
        duration_s=count * PERSON_S + 2.0 * ANSWER_S,
        predictions=(
            Prediction(
                make_message("origin of the frame, after {touches} touches", touches=touches),
                after.origin_u_m,
                "m",
            ),
            Prediction(
                make_message("direction of the frame's axes, after {touches} touches", touches=touches),
                after.angle_u_rad,
                "rad",
            ),
            Prediction(
                make_message("origin of the frame, after {most} touches at most", most=most),
                best.origin_u_m,
                "m",
                origin,
            ),
            Prediction(
                make_message("direction of the frame's axes, after {most} touches at most", most=most),
                best.angle_u_rad,
                "rad",
                turn,
            ),
        ),
        assumed=(
            make_message("{count} points touched by a person, a minute each, if all go well", count=count),
            make_message(
                "the points are {assumed_side_m:.0f} mm apart, at a right angle",
                assumed_side_m=ASSUMED_SIDE_M * 1000.0,
            ),
            make_message(
                "a touch is good to {sigma_mm:.2f} mm per coordinate (sigma_m)",
                sigma_mm=spec.sigma_m * 1000.0,
            ),
        ),
    )


DEFINITION = ProcedureDefinition(
    name="three_point_frame",
    title="User frame from three points",
    version=3,
    procedure=three_point_frame,
    spec_type=ThreePointFrame,
    needs=("writes_user_frame",),
    commands_motion=False,
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
    refit=refit_frame,
)
