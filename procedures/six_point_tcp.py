"""A tool's tip and axes from poses the technician teaches: with the robot alone, by the textbook or as the makers do.

The touches go on in attitudes the program asks for until the tip is known well enough; `tcp_methods` has the ways.
F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.2.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import Field
from pydantic_core import to_jsonable_python

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.points.tool_point import ToolAxes, ToolPoint, tool_pose
from cellcal.calibration.points.touch_design import planned_attitudes, predicted_u_m
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.accuracy_limits import TOOL, AccuracyClass, ToolLimits, limits_in_force
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.forecast import ANSWER_S, PERSON_S, Forecast, Knowledge, Prediction
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.run import Run
from cellcal.procedures.setting_texts import (
    ACCURACY_CLASS,
    ARM_SIGMA,
    MAX_TOUCHES,
    OWN_LIMITS,
    TOOL_NUMBER,
    TOUCH_SIGMA,
    WRITE_ANYWAY,
    describe_setting,
)
from cellcal.procedures.steps.write import read_tool_frame, write_and_read_back
from cellcal.procedures.teaching.tcp_methods import (
    Method,
    Orientation,
    TeachingMethod,
    ToolAttitude,
    take_axes,
)
from cellcal.procedures.teaching.tcp_refit import refit_touches
from cellcal.procedures.teaching.tcp_touches import TouchRules, take_touches
from cellcal.procedures.teaching.tcp_verdict import TcpCriteria, arm_u, axes_u, verdict_on_tool
from cellcal.procedures.verdict import ProcedureVerdict, SetAside
from cellcal.procedures.write_review import (
    WriteAnyway,
    ask_to_write,
    refuse_failed,
    shift_text,
    with_order_remark,
)

FOOT_M = 0.3048

FIX_PIN = Instruction("pin_is_fixed", "Fix a pointed pin where the tool can reach it from several sides.")


@dataclass(frozen=True, slots=True)
class SixPointTcp:
    """Which tool frame to write, how it is taught, and when to be content."""

    tool_number: Annotated[int, Field(ge=0, le=99), TOOL_NUMBER]
    method: Annotated[
        Method,
        describe_setting(
            "How the tool is taught",
            "Which touches are made; the pages lead through them one by one.",
            "what",
            basic=True,
            choices={
                "textbook": "six points, as in the textbook",
                "four_point": "four points: tip only",
                "three_plus_orientation": "three points and an orientation",
                "six_point_xz": "six points: x and z of the tool",
                "six_point_xy": "six points: x and y of the tool",
            },
        ),
    ] = "textbook"
    orientation: Annotated[
        Orientation,
        describe_setting(
            "How the axes are shown",
            "How the directions of the tool's axes are told, where three points and an orientation are taught.",
            "what",
            choices={"world": "tool held square to the base", "two_points": "two more points"},
        ),
    ] = "two_points"
    held: Annotated[
        ToolAttitude,
        describe_setting(
            "How the tool is held",
            "The attitude in which the tool is held square to the robot's base.",
            "what",
            choices={
                "as_base": "axes as those of the base",
                "z_down": "z straight down",
                "x_down": "x straight down",
            },
        ),
    ] = "z_down"
    check_handedness: Annotated[
        bool,
        describe_setting(
            "One more move as a check", "Catches axes that were shown in the wrong order.", "effort"
        ),
    ] = False
    rms_limit_m: Annotated[
        float,
        Field(gt=0, le=0.1),
        describe_setting(
            "Largest disagreement of the touches",
            "Touches that disagree by more are not accepted (RMS).",
            "limits",
            unit="m",
        ),
    ] = 0.0005
    min_touches: Annotated[
        int,
        Field(ge=0, le=50),
        describe_setting(
            "Fewest touches", "At least so many touches; 0: as few as the method has.", "effort", unit="1"
        ),
    ] = 0
    max_touches: Annotated[int, Field(ge=3, le=50), MAX_TOUCHES] = 12
    min_turn_rad: Annotated[
        float,
        Field(gt=0, le=1),
        describe_setting(
            "Turn between the first touches",
            "The tool is turned at least so far between the first three touches.",
            "effort",
            unit="rad",
        ),
    ] = math.radians(20.0)
    most_tilt_rad: Annotated[
        float,
        Field(gt=0.3, le=1.6),
        describe_setting(
            "Most tilt asked for", "No touch asks for more tilt of the tool than this.", "effort", unit="rad"
        ),
    ] = math.radians(60.0)
    min_move_m: Annotated[
        float,
        Field(gt=0, le=10),
        describe_setting(
            "Distance to show an axis",
            "The tool moves at least so far along an axis to show its direction.",
            "effort",
            unit="m",
        ),
    ] = FOOT_M * 0.98
    touch_sigma_m: Annotated[float, Field(gt=0, le=0.1), TOUCH_SIGMA] = 0.0002
    arm_sigma_m: Annotated[float, Field(ge=0, le=0.01), ARM_SIGMA] = 0.0003
    square_sigma_rad: Annotated[
        float,
        Field(ge=0, le=0.2),
        describe_setting(
            "How squarely the tool is held",
            "Standard deviation of the angle when the tool is set square by eye or level.",
            "doubt",
            unit="rad",
        ),
    ] = math.radians(0.05)
    accuracy_class: Annotated[AccuracyClass, ACCURACY_CLASS] = "B"
    limits: Annotated[ToolLimits | None, OWN_LIMITS] = None
    write_anyway: Annotated[WriteAnyway, WRITE_ANYWAY] = ""

    @property
    def teaching_method(self) -> TeachingMethod:
        """The method with its choices."""
        return TeachingMethod(
            self.method, self.orientation, self.held, self.check_handedness, self.min_move_m
        )

    @property
    def touch_rules(self) -> TouchRules:
        """When there are enough touches."""
        least = max(self.min_touches, self.teaching_method.least_touches)
        limit_m, by_arm_m = (
            limits_in_force(TOOL, self.accuracy_class, self.limits).tip_m,
            arm_u(self.arm_sigma_m),
        )
        return TouchRules(
            least=least,
            most=max(self.max_touches, least),
            sigma_m=self.touch_sigma_m,
            arm_sigma_m=self.arm_sigma_m,
            tip_u_m=limit_m if by_arm_m < limit_m else math.hypot(limit_m, by_arm_m),
            rms_limit_m=self.rms_limit_m,
            min_turn_rad=self.min_turn_rad,
            most_tilt_rad=self.most_tilt_rad,
        )


@dataclass(frozen=True, slots=True)
class ToolSetup:
    """The tool frame as written and read back, and how well it is known."""

    tool_number: int
    flange_tool: Pose
    tip: ToolPoint
    axes: ToolAxes | None  # None: the method finds a place only, the axes are those of before
    touches: int
    fixed_plan_touches: int | None
    set_aside: tuple[SetAside, ...]
    before: Pose
    read_back: Pose


async def six_point_tcp(run: Run, spec: SixPointTcp) -> ToolSetup:
    """Find a tool's tip and axes from poses the technician teaches, and write the tool frame."""
    await run.ensure("the pin is fixed", ask_confirmation, FIX_PIN)
    before = await run.step("read the tool frame", read_tool_frame, spec.tool_number)

    touches = await take_touches(run, spec.touch_rules, spec.teaching_method.named_touches)
    axes = await take_axes(run, spec.teaching_method, touches.base_flange[0])

    tip = touches.tip.tip_in_flange_m
    flange_tool = Pose(tip, before.quaternion) if axes is None else tool_pose(tip, axes)
    found = ToolSetup(
        tool_number=spec.tool_number,
        flange_tool=flange_tool,
        tip=touches.tip,
        axes=axes,
        touches=len(touches.base_flange),
        fixed_plan_touches=touches.fixed_plan,
        set_aside=touches.set_aside,
        before=before,
        read_back=flange_tool,  # as it will be, if a person wants it
    )
    verdict = _judge_result(spec, found)
    refuse_failed(verdict, spec.write_anyway, found)
    sha256 = sha256_of(to_jsonable_python(flange_tool))
    await run.step("accept the result", ask_acceptance, _result_instruction(spec, found, verdict), sha256)
    read_back = await run.write("write the tool frame", write_and_read_back, spec.tool_number, flange_tool)
    return replace(found, read_back=read_back)


def _result_instruction(spec: SixPointTcp, found: ToolSetup, verdict: ProcedureVerdict) -> Instruction:
    tip, (x, y, z) = found.tip, (value * 1e3 for value in found.flange_tool.position_m)
    words = [
        make_message(
            "Tool {tool_number}: x {x:.2f}, y {y:.2f}, z {z:.2f} mm from the flange, within "
            "{tip_u_in_space_mm:.2f} mm (95 %); the touches agree within {rms_mm:.2f} mm RMS.",
            tool_number=spec.tool_number,
            x=x,
            y=y,
            z=z,
            tip_u_in_space_mm=tip.tip_u_in_space_m * 1000.0,
            rms_mm=tip.rms_m * 1000.0,
        ),
        *(["Its axes stay as they are."] if spec.method == "four_point" else []),
        shift_text(found.before, found.flange_tool),
    ]
    shown = Instruction("accept_tool", join_messages(" ", words))
    return ask_to_write(shown, verdict, found.before, found.flange_tool, spec.write_anyway, lever_m=0.0)


def _outline_phases(spec: SixPointTcp) -> tuple[Phase, ...]:
    way, named = spec.teaching_method, spec.teaching_method.named_touches
    expected = max(_expected_touches(spec), len(named))
    origin = () if way.origin_step is None else (Phase(way.origin_step),)
    return (
        Phase("read the tool frame"),
        *(Phase(step) for step, _ in named),
        Phase("touch in another attitude", expected - len(named), adaptive=True),
        Phase("touch anew", 0, adaptive=True),
        Phase("judge the touches", expected, adaptive=True),
        Phase("locate the tip"),
        *origin,
        *(Phase(f"move along {axis}") for axis in way.move_axes),
        *(() if spec.method == "four_point" else (Phase("find the axes"),)),
        *(Phase("accept the result"), Phase("write the tool frame")),
    )


def _results_to_store(spec: SixPointTcp, result: ToolSetup) -> StoredResult:
    return StoredResult("tool_frame", str(spec.tool_number), result)


def _make_verdict(spec: SixPointTcp, result: ToolSetup) -> ProcedureVerdict:
    return with_order_remark(_judge_result(spec, result), spec.write_anyway)


def _judge_result(spec: SixPointTcp, result: ToolSetup) -> ProcedureVerdict:
    judging = TcpCriteria(
        spec.teaching_method, spec.square_sigma_rad, spec.arm_sigma_m, spec.accuracy_class, spec.limits
    )
    return verdict_on_tool(judging, result)


def _expected_touches(spec: SixPointTcp) -> int:
    """Return after how many touches the tip will be known well enough if they are as good as stated."""
    rules = spec.touch_rules
    for count in range(rules.least, rules.most):
        u_m = _u_m(spec, count)
        if u_m is not None and u_m <= rules.tip_u_m:
            return count
    return rules.most


def _u_m(spec: SixPointTcp, count: int) -> float | None:
    attitudes = planned_attitudes(count, spec.most_tilt_rad)
    freedom = max(3.0 * count - 6.0, 1.0)
    return predicted_u_m(attitudes, spec.touch_sigma_m, freedom, arm_sigma_m=spec.arm_sigma_m)


def _forecast_run(spec: SixPointTcp, knowledge: Knowledge) -> Forecast:
    del knowledge
    rules, expected = spec.touch_rules, _expected_touches(spec)
    best = _u_m(spec, rules.most)
    limits = {name: limit.tip_m for name, limit in TOOL.items()}
    turn = {name: limit.orientation_rad for name, limit in TOOL.items()}
    poses = expected + len(spec.teaching_method.move_axes) + (spec.teaching_method.origin_step is not None)
    tip = (
        []
        if best is None
        else [
            Prediction(make_message("tip, after {most} touches at most", most=rules.most), best, "m", limits)
        ]
    )
    if spec.method != "four_point":
        u_rad = axes_u(spec.teaching_method, spec.touch_sigma_m, spec.square_sigma_rad)
        tip.append(Prediction("turn of the tool's axes", u_rad, "rad", turn))
    return Forecast(
        duration_s=poses * PERSON_S + 2.0 * ANSWER_S,
        predictions=tuple(tip),
        assumed=(
            make_message(
                "{poses} poses taught by a person, a minute each; {expected} of them touches, if all go well",
                poses=poses,
                expected=expected,
            ),
            make_message(
                "a touch repeats within {touch_sigma_mm:.2f} mm per coordinate (touch_sigma_m)",
                touch_sigma_mm=spec.touch_sigma_m * 1000.0,
            ),
            make_message(
                "the arm's own errors shift the tip by {arm_sigma_mm:.2f} mm per coordinate (arm_sigma_m)",
                arm_sigma_mm=spec.arm_sigma_m * 1000.0,
            ),
            make_message(
                "the tool can be turned by {most_tilt_deg:.0f} degrees to every side (most_tilt_rad)",
                most_tilt_deg=math.degrees(spec.most_tilt_rad),
            ),
            make_message(
                "the tool is held square within {square_sigma_deg:.2f} degrees (square_sigma_rad)",
                square_sigma_deg=math.degrees(spec.square_sigma_rad),
            ),
        ),
    )


DEFINITION = ProcedureDefinition(
    name="six_point_tcp",
    title="Tool frame from six points",
    version=3,
    procedure=six_point_tcp,
    spec_type=SixPointTcp,
    needs=("writes_tool_frame",),
    commands_motion=False,
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
    refit=refit_touches,
)
