"""A tool frame from measured points on the end-effector: the draw-wire's hook hangs in each of them in turn.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.2: three
points that lie on no line, whose places from the tip are known, give the whole tool frame; one gives x, y, z only.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

from pydantic import Field, TypeAdapter
from pydantic_core import to_jsonable_python

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.points.end_effector import points_in_flange, refuse_tool_points, tool_through
from cellcal.calibration.points.fixture import PlacedPoints, Triple
from cellcal.calibration.wires.network import WirePlace
from cellcal.calibration.wires.network_fit import WireNetwork
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.arm.tool_write import UNKNOWN_ORIENTATION, ToolOrder, frame_figures, tool_instruction
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.forecast import Forecast, Knowledge
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance, ask_confirmation
from cellcal.procedures.refit import Refit, RefitResult, pose_values, values_of
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.run_history import Finding
from cellcal.procedures.setting_texts import (
    POINTS_IN_TOOL,
    ROUGH_TOOL,
    RULES,
    TIP_U,
    TOOL_NUMBER,
    WRITE_ANYWAY,
    describe_setting,
)
from cellcal.procedures.steps.end_effector import bad_shape_error, point_instruction
from cellcal.procedures.steps.mastering import check_same_epoch
from cellcal.procedures.steps.write import read_tool_frame, write_and_read_back
from cellcal.procedures.survey.survey import (
    EACH_CAPTURE,
    Captures,
    Survey,
    SurveyGoal,
    SurveyPlan,
    SurveyRules,
    SurveyState,
    WireSpot,
    fit_survey,
)
from cellcal.procedures.survey.survey_choice import fixed_plan_captures, saving_text
from cellcal.procedures.survey.survey_forecast import survey_forecast
from cellcal.procedures.survey.survey_motion import (
    Wire,
)
from cellcal.procedures.survey.survey_plan import SpotLayout, plan_survey, survey_plan_page
from cellcal.procedures.survey.survey_refit import refit_lengths, survey_of
from cellcal.procedures.survey.wire_survey import measure_spots, read_survey_state
from cellcal.procedures.verdict import ProcedureVerdict, SetAside, state_figure
from cellcal.procedures.write_review import (
    WriteAnyway,
    frame_changes,
    raise_first,
    refuse_failed,
    with_order_remark,
)

WIRE_STANDS = Instruction(
    "wire_stands",
    "The draw-wire stands where the cell file says. Leave the wire itself off until you are asked.",
)


@dataclass(frozen=True, slots=True)
class EndEffectorPoints:
    """Which tool frame to write, where the points are from the tip, roughly where the tool is, when to be content."""

    tool_number: Annotated[int, Field(ge=0, le=99), TOOL_NUMBER]
    points_in_tool_m: Annotated[tuple[Triple, ...], Field(min_length=1, max_length=12), POINTS_IN_TOOL]
    rough_flange_tool: Annotated[Pose, ROUGH_TOOL]
    rough_sigma_m: Annotated[
        float,
        Field(gt=0, le=0.1),
        describe_setting(
            "How rough the rough tool is",
            "By how much a point may be off where the rough tool has it (standard deviation).",
            "doubt",
            unit="m",
        ),
    ] = 0.010
    tip_u_m: Annotated[float, Field(gt=0, le=0.1), TIP_U] = 0.0004
    angle_u_rad: Annotated[
        float,
        Field(gt=0, le=1),
        describe_setting(
            "Accuracy to reach of the axes",
            "The series ends once the tool's directions are known so well (k = 2).",
            "limits",
            unit="rad",
        ),
    ] = math.radians(0.2)
    rules: Annotated[SurveyRules, RULES] = field(default_factory=SurveyRules)
    write_anyway: Annotated[WriteAnyway, WRITE_ANYWAY] = ""


@dataclass(frozen=True, slots=True)
class MeasuredTool:
    """The tool frame as written and read back, and how well it is known."""

    tool_number: int
    flange_tool: Pose
    position_only: bool  # from one point: the orientation is the rough frame's
    tip_u_m: float  # k = 2, worst direction
    angle_u_rad: float  # k = 2, worst axis; 0 where it was not measured
    placed: PlacedPoints | None  # None with one point
    network: WireNetwork
    captures: int
    fixed_plan_captures: int | None
    before: Pose
    read_back: Pose
    set_aside: tuple[SetAside, ...] = ()


@dataclass(frozen=True, slots=True)
class FoundToolFrame:
    """A tool frame before a person accepted it."""

    flange_tool: Pose
    tip_u_m: float
    angle_u_rad: float
    placed: PlacedPoints | None
    network: WireNetwork
    captures: int
    fixed_plan_captures: int | None
    set_aside: tuple[SetAside, ...] = ()


_FOUND: TypeAdapter[FoundToolFrame] = TypeAdapter(FoundToolFrame)


async def end_effector_points(run: Run, spec: EndEffectorPoints) -> MeasuredTool:
    """Find the tool frame from wire lengths to points of the end-effector, and write it."""
    await run.ensure("the wire stands", ask_confirmation, WIRE_STANDS)
    state = await run.step("read the robot", read_survey_state)
    before = await run.step("read the tool frame", read_tool_frame, spec.tool_number)
    if state.epoch is not None:
        await run.ensure("the robot kept its position", check_same_epoch, state.epoch)

    plan = await run.solve("plan the poses", plan_tool, state, spec)
    await run.step(
        "accept the plan", ask_acceptance, _plan_instruction(plan, spec), sha256_of(to_jsonable_python(plan))
    )

    survey = Survey(state, plan, spec.rules)
    measured = await measure_spots(run, survey)

    tool = await run.solve("locate the tool", locate_tool, survey, spec, measured.captures)
    tool = replace(tool, set_aside=measured.set_aside)
    raise_first((bad_shape_error(tool.placed, tool), _uncertain_error(tool, spec)), spec.write_anyway)
    verdict = _judge_result(spec, tool)
    refuse_failed(verdict, spec.write_anyway, tool)
    shown = tool_instruction(tool, verdict, ToolOrder(spec.tool_number, before, spec.write_anyway))
    sha256 = sha256_of(to_jsonable_python(tool.flange_tool))
    await run.step("accept the result", ask_acceptance, shown, sha256)
    read_back = await run.write(
        "write the tool frame", write_and_read_back, spec.tool_number, tool.flange_tool
    )
    return MeasuredTool(
        tool_number=spec.tool_number,
        flange_tool=tool.flange_tool,
        position_only=tool.placed is None,
        tip_u_m=tool.tip_u_m,
        angle_u_rad=tool.angle_u_rad,
        placed=tool.placed,
        network=tool.network,
        captures=tool.captures,
        fixed_plan_captures=tool.fixed_plan_captures,
        before=before,
        read_back=read_back,
        set_aside=tool.set_aside,
    )


def plan_tool(state: SurveyState, spec: EndEffectorPoints) -> SurveyPlan:
    """Plan spots and the poses to choose from; refuse what cannot succeed before anything moves."""
    points, at = spec.points_in_tool_m, state.gauge_setup
    refuse_tool_points(points)
    rough = spec.rough_flange_tool
    places = tuple(WirePlace(hook, spec.rough_sigma_m) for hook in points_in_flange(rough, points))
    wires: tuple[Wire, ...] = tuple((at.anchor_in_base_m, p.at_m, state.gauge_range_m) for p in places)
    layout = SpotLayout(
        goal=SurveyGoal(rough, points, spec.tip_u_m, spec.angle_u_rad),
        exits=(WirePlace(at.anchor_in_base_m, at.sigma_anchor_m),),
        hooks=(WirePlace(at.hook_in_flange_m, at.sigma_hook_m), *places),
        spots=tuple(
            WireSpot(0, k, False, point_instruction("wire", k, points[k - 1]))
            for k in range(1, len(points) + 1)
        ),
        wires=wires,
        mouth_at_m=at.mouth_at_m,
        turns_mouth=False,  # the housing stays where it is
    )
    return plan_survey(state, spec.rules, layout)


def locate_tool(survey: Survey, spec: EndEffectorPoints, captures: Captures) -> FoundToolFrame:
    """Fit the tool frame to its points with all that the lengths say, and compare the effort with a fixed plan."""
    found = fit_tool(survey, spec, captures)
    fixed = fixed_plan_captures(survey, found.network.disturbance_factor, (found.tip_u_m, found.angle_u_rad))
    return replace(found, fixed_plan_captures=fixed)


def fit_tool(survey: Survey, spec: EndEffectorPoints, captures: Captures) -> FoundToolFrame:
    """Fit the tool frame to its points with all that the lengths say; with one point, its place only."""
    network, count = fit_survey(survey, captures), sum(map(len, captures))
    hooks = tuple(range(1, len(spec.points_in_tool_m) + 1))
    tool = tool_through(
        spec.rough_flange_tool,
        spec.points_in_tool_m,
        [network.hooks_m[k] for k in hooks],
        network.hook_covariance(hooks),
        spec.rules.point_sigma_m,
    )
    return FoundToolFrame(tool.flange_tool, tool.tip_u_m, tool.angle_u_rad, tool.placed, network, count, None)


def _uncertain_error(tool: FoundToolFrame, spec: EndEffectorPoints) -> RefusalError | None:
    if tool.tip_u_m <= spec.tip_u_m and tool.angle_u_rad <= spec.angle_u_rad:
        return None
    return RefusalError(
        make_message(
            "after {captures} captures the tip is known within {tip_u_mm:.3f} mm and the axes within "
            "{angle_u_deg:.3f} deg (k=2); {tip_limit_mm:.3f} mm and {angle_limit_deg:.3f} deg are asked "
            "for",
            captures=tool.captures,
            tip_u_mm=tool.tip_u_m * 1000.0,
            angle_u_deg=math.degrees(tool.angle_u_rad),
            tip_limit_mm=spec.tip_u_m * 1000.0,
            angle_limit_deg=math.degrees(spec.angle_u_rad),
        ),
        code="procedure.undecided",
        remedy="Use points further apart, a mastering record with more poses, or more captures (max_captures).",
        evidence=tool,
    )


def _plan_instruction(plan: SurveyPlan, spec: EndEffectorPoints) -> Instruction:
    rules, spots = spec.rules, len(plan.spots)
    what = make_message(
        "the robot, with the hook in each of {spots} points, to {min_captures} to {max_captures} "
        "of {map} poses, one chosen after the other",
        spots=spots,
        min_captures=rules.min_captures,
        max_captures=rules.max_captures,
        map=min(map(len, plan.pools)),
    )
    return survey_plan_page(plan, rules, what, "hang the hook into each point")


def _outline_phases(spec: EndEffectorPoints) -> tuple[Phase, ...]:
    points = len(spec.points_in_tool_m)
    expected = points * max(spec.rules.min_captures, min(12, spec.rules.max_captures))
    return (
        *(Phase("read the robot"), Phase("read the tool frame")),
        *(Phase("plan the poses"), Phase("accept the plan")),
        *(Phase("go to rest", points), Phase("move the wire", points)),
        *(Phase(name, expected, adaptive=True) for name in EACH_CAPTURE),
        *(Phase("look at the lengths", points, adaptive=True), Phase("locate the tool")),
        *(Phase("accept the result"), Phase("write the tool frame")),
    )


def _results_to_store(spec: EndEffectorPoints, result: MeasuredTool) -> StoredResult:
    return StoredResult("tool_frame", str(spec.tool_number), result)


def _make_verdict(spec: EndEffectorPoints, result: MeasuredTool) -> ProcedureVerdict:
    verdict = with_order_remark(_judge_result(spec, result), spec.write_anyway)
    return replace(verdict, changes=frame_changes(result.before, result.read_back))


def _judge_result(spec: EndEffectorPoints, result: MeasuredTool | FoundToolFrame) -> ProcedureVerdict:
    figures = frame_figures(result, spec.tip_u_m, spec.angle_u_rad)
    return ProcedureVerdict(
        characteristics=(
            *figures,
            state_figure("residual of the lengths", result.network.residual_rms_m, "m"),
        ),
        limits_from="limits of the settings",
        not_verified=(UNKNOWN_ORIENTATION,) if result.placed is None else (),
        remarks=(saving_text(result.captures, result.fixed_plan_captures),),
        set_aside=result.set_aside,
    )


def _forecast_run(spec: EndEffectorPoints, knowledge: Knowledge) -> Forecast:
    return survey_forecast(lambda state: plan_tool(state, spec), spec.rules, "tool's", knowledge)


def _make_refit(spec: EndEffectorPoints, findings: Sequence[Finding]) -> Refit:
    found = values_of(findings)
    survey, recorded = survey_of(found, spec.rules), _FOUND.validate_python(found["locate the tool"])

    def solve_again(captures: Captures) -> tuple[RefitResult, WireNetwork]:
        tool = fit_tool(survey, spec, captures)
        values = pose_values(tool.flange_tool, recorded.flange_tool)
        return RefitResult((), tool.tip_u_m, values), tool.network

    return refit_lengths(survey, findings, solve_again)


DEFINITION = ProcedureDefinition(
    name="end_effector_points",
    title="Tool frame from points on the end-effector",
    version=4,
    procedure=end_effector_points,
    spec_type=EndEffectorPoints,
    needs=("moves_joints", "tells_flange_pose", "gauge", "gauge_setup", "model", "writes_tool_frame"),
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=_make_verdict,
    forecast=_forecast_run,
    refit=_make_refit,
)
