"""A tool's tip and axes from six poses the technician teaches: the textbook's method with the robot alone.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.2.
"""

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field
from pydantic_core import to_jsonable_python

from calibration.geometry import Pose
from calibration.tool_point import AxesLimits, ToolAxes, ToolPoint, locate_tool_point, tool_axes, tool_pose
from drivers.interfaces import Instruction
from procedures.canonical import sha256_of
from procedures.entry import Entry, Keepsake, Phase
from procedures.run import OutOfToleranceError, Run
from procedures.steps.ask import accept, ask
from procedures.steps.teach import teach
from procedures.steps.write import write_and_read_back

FOOT_M = 0.3048

FIX_PIN = Instruction("pin_is_fixed", "Fix a pointed pin where the tool can reach it from several sides.")
TOUCH = Instruction("touch", "Touch the pin with the tool's tip. Hold the tool square to the robot's base.")
ABOUT_X = Instruction("touch_about_x", "Turn the tool about its x axis by up to 180 degrees; touch the pin.")
ABOUT_Y = Instruction("touch_about_y", "Turn the tool about its y axis; touch the pin again.")
EXTRA = Instruction("touch_again", "Touch the pin once more in an attitude not used so far.")
ALONG_X = Instruction(
    "along_x", "Go back to the first touch. Move straight along the tool's +x, a foot or more."
)
ALONG_Y = Instruction(
    "along_y", "Go back to the first touch. Move straight along the tool's +y, a foot or more."
)
ALONG_Z = Instruction(
    "along_z", "Go back to the first touch. Move straight along the tool's +z, a foot or more."
)


@dataclass(frozen=True, slots=True)
class SixPointTcp:
    """Which tool frame to write, and when to be content."""

    tool_number: Annotated[int, Field(ge=0, le=99)]
    rms_limit_m: Annotated[float, Field(gt=0, le=0.1)] = 0.0005
    # three touches leave little redundancy for the RMS to speak
    extra_touches: Annotated[int, Field(ge=0, le=50)] = 0
    min_move_m: Annotated[float, Field(gt=0, le=10)] = FOOT_M * 0.98  # a foot by eye


@dataclass(frozen=True, slots=True)
class ToolSetup:
    """The tool frame as written and read back, and how well it is known."""

    tool_number: int
    flange_tool: Pose
    tip: ToolPoint
    axes: ToolAxes
    read_back: Pose


async def six_point_tcp(run: Run, spec: SixPointTcp) -> ToolSetup:
    """Find a tool's tip and axes from six poses the technician teaches, and write the tool frame."""
    await run.ensure("the pin is fixed", ask, FIX_PIN)

    square = await run.step("touch the pin", teach, TOUCH)
    about_x = await run.step("touch, turned about x", teach, ABOUT_X)
    about_y = await run.step("touch, turned about y", teach, ABOUT_Y)
    extra = [await run.step(f"extra touch {k}", teach, EXTRA) for k in range(1, spec.extra_touches + 1)]
    touches = tuple(taught.base_flange for taught in (square, about_x, about_y, *extra))
    tip = await run.solve("locate the tip", locate_tool_point, touches)
    if tip.rms_m > spec.rms_limit_m:
        raise OutOfToleranceError(
            f"the touches disagree by {tip.rms_m * 1e3:.2f} mm RMS, limit {spec.rms_limit_m * 1e3:.2f} mm.",
            found=tip.rms_m,
            limit=spec.rms_limit_m,
            unit="m",
            remedy=f"Check that the pin did not move, then redo touch {tip.worst_touch + 1}.",
        )

    along_x = await run.step("move along x", teach, ALONG_X)
    along_y = await run.step("move along y", teach, ALONG_Y)
    along_z = await run.step("move along z", teach, ALONG_Z)
    moves = (along_x.base_flange, along_y.base_flange, along_z.base_flange)
    axes = await run.solve("find the axes", find_axes, square.base_flange, moves, spec.min_move_m)

    flange_tool = tool_pose(tip.tip_in_flange_m, axes)
    shown, sha256 = _shown(spec, tip, flange_tool), sha256_of(to_jsonable_python(flange_tool))
    await run.step("accept the result", accept, shown, sha256)
    read_back = await run.write("write the tool frame", write_and_read_back, spec.tool_number, flange_tool)
    return ToolSetup(spec.tool_number, flange_tool, tip, axes, read_back)


def find_axes(square: Pose, moves: tuple[Pose, Pose, Pose], min_move_m: float) -> ToolAxes:
    """Return the tool's axes from straight moves along its x, y and z."""
    along_x, along_y, along_z = moves
    limits = AxesLimits(min_move_m=min_move_m)
    return tool_axes(square, along_x=along_x, along_y=along_y, along_z=along_z, limits=limits)


def _shown(spec: SixPointTcp, tip: ToolPoint, flange_tool: Pose) -> Instruction:
    x, y, z = (value * 1e3 for value in flange_tool.position_m)
    return Instruction(
        "accept_tool",
        f"Tool {spec.tool_number}: x {x:.2f}, y {y:.2f}, z {z:.2f} mm from the flange; the touches agree "
        f"within {tip.rms_m * 1e3:.2f} mm RMS. Write it to the controller?",
    )


def _outline(spec: SixPointTcp) -> tuple[Phase, ...]:
    return (
        *(Phase("touch the pin"), Phase("touch, turned about x"), Phase("touch, turned about y")),
        *((Phase("extra touch", spec.extra_touches),) if spec.extra_touches else ()),
        *(Phase("locate the tip"), Phase("move along x"), Phase("move along y"), Phase("move along z")),
        *(Phase("find the axes"), Phase("accept the result"), Phase("write the tool frame")),
    )


def _keeps(spec: SixPointTcp, result: ToolSetup) -> Keepsake:
    return Keepsake("tool_frame", str(spec.tool_number), result)


ENTRY = Entry(
    name="six_point_tcp",
    title="Tool frame from six points",
    version=1,
    procedure=six_point_tcp,
    spec_type=SixPointTcp,
    needs=("writes_tool_frame",),
    outline=_outline,
    keeps=_keeps,
)
