"""How a tool is taught: the textbook's method and the makers', as the touches and moves that each asks for.

Textbook: F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, 3.2.
FANUC six-point: three approaches, an orient origin, a direction of x and one of z or y (B-83284EN/09, 3.9).
"World" and "two points" are KUKA's ABC methods after XYZ 4-point; four points and more are every maker's.
"""

import math
from dataclasses import dataclass
from typing import Literal

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.points.tool_point import (
    AxesLimits,
    ToolAxes,
    axes_from_attitude,
    axes_from_plane,
    tool_axes,
)
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.run import Run
from cellcal.procedures.steps.meters import move_meter
from cellcal.procedures.steps.pages import point_states, points_page
from cellcal.procedures.steps.teach import teach_pose

Method = Literal["textbook", "four_point", "three_plus_orientation", "six_point_xz", "six_point_xy"]
Orientation = Literal["world", "two_points"]
ToolAttitude = Literal["as_base", "z_down", "x_down"]

_HALF = math.sqrt(0.5)
TOOL_ATTITUDES: dict[ToolAttitude, tuple[Pose, str]] = {
    "as_base": (Pose((0.0, 0.0, 0.0)), "its axes parallel to those of the robot's base"),
    "z_down": (
        Pose((0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)),
        "its +z straight down, its +x along the base's +x",
    ),
    "x_down": (
        Pose((0.0, 0.0, 0.0), (_HALF, 0.0, _HALF, 0.0)),
        "its +x straight down, its +y along the base's +y, its +z along the base's +x",
    ),
}

TOUCH = Instruction("touch", "Touch the pin with the tool's tip. Hold the tool square to the robot's base.")
ABOUT_X = Instruction("touch_about_x", "Turn the tool about its x axis by up to 180 degrees; touch the pin.")
ABOUT_Y = Instruction("touch_about_y", "Turn the tool about its y axis; touch the pin again.")
FIRST = Instruction(
    "touch", "Touch the pin with the tool's tip, in an attitude that can be tilted to all sides."
)
ORIGIN = Instruction(
    "orient_origin", "Bring the tool's axes to where they can be told, by eye or level; the place is free."
)


@dataclass(frozen=True, slots=True)
class TeachingMethod:
    """A method with its choices."""

    method: Method
    orientation: Orientation
    attitude: ToolAttitude
    check_handedness: bool
    min_move_m: float

    @property
    def named_touches(self) -> tuple[tuple[str, Instruction], ...]:
        """The touches that the method names itself."""
        if self.method != "textbook":
            return (("touch the pin", FIRST),)
        return (
            ("touch the pin", TOUCH),
            ("touch, turned about x", ABOUT_X),
            ("touch, turned about y", ABOUT_Y),
        )

    @property
    def least_touches(self) -> int:
        """The number of touches of the method."""
        return 4 if self.method == "four_point" else 3

    @property
    def move_axes(self) -> str:
        """The axes along which the tool is moved: letters, in the order of teaching."""
        if self.method == "textbook":
            return "xyz"
        if self.method == "four_point" or self.is_by_attitude:
            return ""
        second = "z" if self.method == "six_point_xz" else "y"
        third = "y" if second == "z" else "z"
        return f"x{second}{third if self.check_handedness else ''}"

    @property
    def is_by_attitude(self) -> bool:
        """Whether the axes come from one attitude that the tool is held in."""
        return self.method == "three_plus_orientation" and self.orientation == "world"

    @property
    def is_in_plane(self) -> bool:
        """Whether the second move only tells the plane."""
        return self.method == "three_plus_orientation" and self.orientation == "two_points"

    @property
    def origin_step(self) -> str | None:
        """The step that teaches where the moves start, or the attitude; None where a touch is the start."""
        if self.method in ("textbook", "four_point"):
            return None
        return "hold the tool" if self.is_by_attitude else "teach the orient origin"


async def take_axes(run: Run, way: TeachingMethod, square: Pose) -> ToolAxes | None:
    """Have the tool's axes taught; None where the method finds a place only. ``square`` is the first touch."""
    if way.method == "four_point":
        return None
    origin = square
    if way.origin_step is not None:
        names = [way.origin_step, *(f"move along {axis}" for axis in way.move_axes)]
        instruction = points_page(_origin_instruction(way), point_states(names, 0), None)
        origin = (await run.step(way.origin_step, teach_pose, instruction)).base_flange
    ends = [
        (await run.step(f"move along {axis}", teach_pose, _move_page(way, axis, origin))).base_flange
        for axis in way.move_axes
    ]
    return await run.solve("find the axes", find_axes, way, origin, tuple(ends))


def _move_page(way: TeachingMethod, axis: str, origin: Pose) -> Instruction:
    names = [f"move along {each}" for each in way.move_axes]
    meter = move_meter(origin, way.min_move_m)
    return points_page(_move_instruction(way, axis), point_states(names, way.move_axes.index(axis)), meter)


def find_axes(way: TeachingMethod, origin: Pose, ends: tuple[Pose, ...]) -> ToolAxes:
    """Return the tool's axes from what was taught for them."""
    limits = AxesLimits(min_move_m=way.min_move_m)
    if way.is_by_attitude:
        return axes_from_attitude(origin, TOOL_ATTITUDES[way.attitude][0])
    if way.is_in_plane:
        above = ends[2] if len(ends) > 2 else None
        return axes_from_plane(origin, ends[0], ends[1], above=above, limits=limits)
    taught = dict(zip(way.move_axes, ends, strict=True))
    return tool_axes(
        origin, along_x=taught.get("x"), along_y=taught.get("y"), along_z=taught.get("z"), limits=limits
    )


def _origin_instruction(way: TeachingMethod) -> Instruction:
    if way.is_by_attitude:
        return Instruction(
            "hold_tool",
            make_message(
                "Hold the tool with {tool_attitudes}; a level tells better than the eye.",
                tool_attitudes=TOOL_ATTITUDES[way.attitude][1],
            ),
        )
    return ORIGIN


def _move_instruction(way: TeachingMethod, axis: str) -> Instruction:
    start = "the first touch" if way.method == "textbook" else "the orient origin"
    where = f"straight along the tool's own +{axis}"
    if way.is_in_plane and axis == "y":
        where = "straight into the tool's x-y plane, to the side of +y"
    if way.is_in_plane and axis == "z":
        where = "to the side of the tool's +z"
    return Instruction(
        f"along_{axis}",
        make_message(
            "Go back to {start}. Without turning the tool, move {where}, {min_move_mm:.0f} mm or more.",
            start=start,
            where=where,
            min_move_mm=way.min_move_m * 1000.0,
        ),
    )
