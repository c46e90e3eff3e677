"""A tool frame that a calibration found beside the arm: what may be claimed of it, and how it gets into the robot."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from pydantic_core import to_jsonable_python

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.points.fixture import PlacedPoints
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.accuracy_limits import ToolLimits
from cellcal.procedures.arm.tool_result import FoundTool
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.questions import ask_acceptance
from cellcal.procedures.run import Run
from cellcal.procedures.steps.end_effector import bad_shape_error
from cellcal.procedures.steps.write import write_and_read_back
from cellcal.procedures.verdict import (
    FAIL,
    PASS,
    Characteristic,
    ProcedureVerdict,
    chi_square_rule,
    known_within,
    state_fact,
    state_figure,
)
from cellcal.procedures.write_review import ask_to_write, shift_text

UNKNOWN_ORIENTATION = "the orientation: one point tells x, y, z only"


@dataclass(frozen=True, slots=True)
class WrittenTool:
    """The tool frame as written and read back, and how well it is known."""

    tool_number: int
    flange_tool: Pose
    position_only: bool  # from one point: the orientation is the rough frame's
    tip_u_m: float  # k = 2, worst direction
    angle_u_rad: float  # k = 2, worst axis; 0 where it was not measured
    placed: PlacedPoints | None
    before: Pose
    read_back: Pose


@dataclass(frozen=True, slots=True)
class ToolOrder:
    """The tool frame to write, what it was, and by whose order even if it is not proved."""

    number: int
    before: Pose
    write_anyway: str


class ToolByPoints(Protocol):
    """A tool frame that points of the end-effector tell."""

    @property
    def flange_tool(self) -> Pose: ...
    @property
    def tip_u_m(self) -> float: ...
    @property
    def angle_u_rad(self) -> float: ...
    @property
    def placed(self) -> PlacedPoints | None: ...


def frame_figures(found: ToolByPoints, tip_m: float, axes_rad: float) -> tuple[Characteristic, ...]:
    """Return what is claimed of a tool frame through points, whatever measured them."""
    tip = known_within("tip", "m", u=found.tip_u_m / 2.0, limit=tip_m)
    if found.placed is None:
        return (tip,)
    return (
        tip,
        known_within("axes", "rad", u=found.angle_u_rad / 2.0, limit=axes_rad),
        state_fact(
            "shape of the points",
            found.placed.is_consistent(),
            chi_square_rule("chi square of the points found against the drawing, 99.9 %"),
            found=found.placed.chi_square,
            limit=found.placed.most_chi_square,
        ),
        state_figure("points found against the drawing, RMS a coordinate", found.placed.rms_m, "m"),
    )


def tool_figures(found: FoundTool, limits: ToolLimits) -> tuple[Characteristic, ...]:
    """Return what is claimed of the tool frame."""
    places = zip("xyz", found.flange_tool.position_m, strict=True)
    checks = found.checks
    rule = chi_square_rule("chi square of the errors against what was predicted, 99.9 %")
    return (
        *(
            state_figure(make_message("tip {axis} in the flange", axis=axis), value, "m")
            for axis, value in places
        ),
        *frame_figures(found, limits.tip_m, limits.orientation_rad),
        state_fact(
            "the points' check poses agree with the stated uncertainty",
            checks.is_as_predicted,
            rule,
            found=checks.chi_square,
            limit=checks.most_chi_square,
        ),
        state_figure("RMS error at the points' check poses", checks.rms_m, "m"),
    )


def tool_words(found: ToolByPoints, number: int | None = None) -> str:
    """Return where the tool is, in words; ``number`` is that of the tool frame it is meant for."""
    x, y, z = (value * 1e3 for value in found.flange_tool.position_m)
    axes = (
        "One point tells x, y, z only: the axes are those of the rough frame."
        if found.placed is None
        else make_message("Axes within {angle_deg:.3f} deg.", angle_deg=math.degrees(found.angle_u_rad))
    )
    return make_message(
        "{name}: x {x:.2f}, y {y:.2f}, z {z:.2f} mm from the flange, within {u_mm:.3f} mm (k=2). {axes}",
        name="Tool" if number is None else make_message("Tool {number}", number=number),
        x=x,
        y=y,
        z=z,
        u_mm=found.tip_u_m * 1e3,
        axes=axes,
    )


def not_written_reason(found: FoundTool, verdict: ProcedureVerdict, order: ToolOrder) -> str:
    """Return why the tool frame stays as it is; empty where it may be written."""
    if order.write_anyway:
        return ""
    shape = bad_shape_error(found.placed, found)
    if shape is not None:
        return str(shape)
    if verdict.overall_decision is FAIL:
        return "the verdict is FAIL"
    open_left = [f.name for f in _tool_figures(verdict.characteristics) if f.decision is not PASS]
    return make_message("measure more: {open_left}", open_left=", ".join(open_left)) if open_left else ""


def tool_instruction(found: ToolByPoints, verdict: ProcedureVerdict, order: ToolOrder) -> Instruction:
    """Return the question whether the tool frame is written, with what it is and what it was."""
    text = join_messages(" ", (tool_words(found, order.number), shift_text(order.before, found.flange_tool)))
    instruction = Instruction("accept_tool", text)
    return ask_to_write(
        instruction, verdict, order.before, found.flange_tool, order.write_anyway, lever_m=0.0
    )


async def write_tool(run: Run, found: FoundTool, verdict: ProcedureVerdict, order: ToolOrder) -> WrittenTool:
    """Show the tool frame old and new, and write it once it is accepted."""
    shown = tool_instruction(found, verdict, order)
    await run.step("accept the tool", ask_acceptance, shown, sha256_of(to_jsonable_python(found.flange_tool)))
    read_back = await run.write("write the tool frame", write_and_read_back, order.number, found.flange_tool)
    return WrittenTool(
        order.number,
        found.flange_tool,
        found.placed is None,
        found.tip_u_m,
        found.angle_u_rad,
        found.placed,
        order.before,
        read_back,
    )


def _tool_figures(figures: Iterable[Characteristic]) -> list[Characteristic]:
    return [figure for figure in figures if figure.name in ("tip", "axes") and figure.decision is not None]
