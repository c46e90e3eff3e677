"""A user frame from three points touched with a pointer: origin, a point on +x, a point on the +y side.

F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, section 3.3.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic_core import to_jsonable_python

from calibration.frames import TaughtFrame, frame_from_three_points
from calibration.geometry import Pose
from drivers.interfaces import Instruction
from procedures.canonical import sha256_of
from procedures.entry import Entry, Keepsake, Phase
from procedures.run import Run
from procedures.steps.ask import accept, ask
from procedures.steps.teach import teach
from procedures.steps.write import write_user_frame

Triple = tuple[float, float, float]

POINTER = Instruction(
    "pointer_is_mounted", "Mount the pointer whose tip is known; keep the workpiece clamped."
)
ORIGIN = Instruction("touch_origin", "Touch the origin of the frame with the pointer.")
ON_X = Instruction("touch_on_x", "Touch a point on the +x axis, as far from the origin as possible.")
ON_XY = Instruction(
    "touch_on_xy", "Touch a point of the x-y plane on the +y side, well away from the x axis."
)
ABOVE = Instruction("touch_above", "Touch any point that lies above the plane, on the +z side.")


@dataclass(frozen=True, slots=True)
class ThreePointFrame:
    """Which user frame to write, and with which pointer it is taught."""

    frame_number: Annotated[int, Field(ge=0, le=99)]
    tip_in_flange_m: Triple
    sigma_m: Annotated[float, Field(gt=0, le=0.1)] = 0.0005  # of one coordinate of one touch
    check_above: bool = False  # one more touch, which catches points taught in the wrong order


@dataclass(frozen=True, slots=True)
class FrameSetup:
    """The user frame as written and read back, and how well it is known."""

    frame_number: int
    taught: TaughtFrame
    read_back: Pose


async def three_point_frame(run: Run, spec: ThreePointFrame) -> FrameSetup:
    """Construct a user frame from three touched points and write it."""
    await run.ensure("the pointer is mounted", ask, POINTER)

    origin = await run.step("touch the origin", teach, ORIGIN)
    on_x = await run.step("touch a point on x", teach, ON_X)
    on_xy = await run.step("touch a point on the y side", teach, ON_XY)
    above = await run.step("touch a point above", teach, ABOVE) if spec.check_above else None

    taught = await run.solve(
        "construct the frame",
        construct_frame,
        spec,
        (origin.base_flange, on_x.base_flange, on_xy.base_flange),
        None if above is None else above.base_flange,
    )
    base_user = taught.base_frame
    shown, sha256 = _shown(spec, taught), sha256_of(to_jsonable_python(base_user))
    await run.step("accept the result", accept, shown, sha256)
    read_back = await run.write("write the user frame", write_user_frame, spec.frame_number, base_user)
    return FrameSetup(spec.frame_number, taught, read_back)


def construct_frame(
    spec: ThreePointFrame, flanges: tuple[Pose, Pose, Pose], above: Pose | None
) -> TaughtFrame:
    """Return the frame through the pointer's tip at three flange poses."""
    origin, on_x, on_xy = (tip_in_base(base_flange, spec.tip_in_flange_m) for base_flange in flanges)
    above_m = None if above is None else tip_in_base(above, spec.tip_in_flange_m)
    return frame_from_three_points(origin, on_x, on_xy, above_m=above_m, sigma_m=spec.sigma_m)


def tip_in_base(base_flange: Pose, tip_in_flange_m: Triple) -> Triple:
    """Return where the pointer's tip is."""
    x, y, z = base_flange.rotation() @ np.array(tip_in_flange_m) + np.array(base_flange.position_m)
    return (float(x), float(y), float(z))


def _shown(spec: ThreePointFrame, taught: TaughtFrame) -> Instruction:
    x, y, z = (value * 1e3 for value in taught.base_frame.position_m)
    turn = max(taught.rotation_sigma_rad) * 2e3
    return Instruction(
        "accept_frame",
        f"User frame {spec.frame_number}: origin x {x:.2f}, y {y:.2f}, z {z:.2f} mm from the base; its axes "
        f"are known to {turn:.2f} mm per metre (k=2). Write it to the controller?",
    )


def _outline(spec: ThreePointFrame) -> tuple[Phase, ...]:
    return (
        *(Phase("touch the origin"), Phase("touch a point on x"), Phase("touch a point on the y side")),
        *((Phase("touch a point above"),) if spec.check_above else ()),
        *(Phase("construct the frame"), Phase("accept the result"), Phase("write the user frame")),
    )


def _keeps(spec: ThreePointFrame, result: FrameSetup) -> Keepsake:
    return Keepsake("user_frame", str(spec.frame_number), result)


ENTRY = Entry(
    name="three_point_frame",
    title="User frame from three points",
    version=1,
    procedure=three_point_frame,
    spec_type=ThreePointFrame,
    needs=("writes_user_frame",),
    outline=_outline,
    keeps=_keeps,
)
