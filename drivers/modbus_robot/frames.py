"""Tool and user frames of the controller, and the flange pose behind them. W P R is converted here only."""

from typing import Literal

import numpy as np

from cellcal.calibration.geometry import Pose, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from, values_from
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import ActiveFrames, ShownExternalAxis
from cellcal.drivers.modbus_robot.profile import SECOND_GROUP
from cellcal.drivers.modbus_robot.register_client import RegisterBlock, RegisterClient
from cellcal.drivers.wire.frame_readback import frames_agree

Kind = Literal["tool", "user"]
_CONVENTION = "fanuc_wpr"
_SAME_M = 1e-6  # float32 millimetres of a few metres are good to a quarter of this
_SAME_RAD = 2e-7 * 2 * np.pi


def pose_of(block: RegisterBlock, prefix: str) -> Pose:
    """Return the pose in the registers ``<prefix>xyz`` and ``<prefix>wpr``."""
    rotation = rotation_from(_CONVENTION, np.array(block.numbers_of(f"{prefix}wpr")))
    return Pose.from_matrix(homogeneous_matrix(rotation, np.array(block.numbers_of(f"{prefix}xyz"))))


async def read_frame(panel: RegisterClient, kind: Kind, number: int) -> Pose:
    """Return tool frame (seen from the flange) or user frame (seen from the base) ``number``."""
    return pose_of(await panel.read_registers(f"{kind}_xyz", f"{kind}_wpr", number=number), f"{kind}_")


async def write_frame(panel: RegisterClient, kind: Kind, number: int, pose: Pose) -> Pose:
    """Write a frame in one telegram, read it back, return what was read."""
    rest = await panel.read_registers(f"{kind}_rest", number=number)
    wpr = values_from(_CONVENTION, pose.rotation_matrix())
    values = {
        f"{kind}_xyz": pose.position_m,
        f"{kind}_wpr": tuple(float(angle) for angle in wpr),
        f"{kind}_rest": rest.numbers_of(f"{kind}_rest"),
        f"{kind}_valid": (1,),
    }
    await panel.write_registers(values, number=number)
    found = await read_frame(panel, kind, number)
    if not frames_agree(found, pose, within_m=_SAME_M, within_rad=_SAME_RAD):
        raise RefusedError(
            panel.device,
            make_message("{kind} frame {number} was not written as sent.", kind=kind, number=number),
            remedy="Check that the frame is not locked on the controller, then write again.",
        )
    return found


async def flange_pose(panel: RegisterClient, position: RegisterBlock) -> Pose:
    """Take the active tool and user frame off the pose that the controller shows.

    Their values come from the controller too, so an edited frame cannot falsify the result.
    """
    if position.integer_of("pose_valid") != 1:
        raise RefusedError(
            panel.device,
            "the controller does not know its Cartesian position.",
            remedy="Recover the mastering first.",
        )
    user, tool = position.integer_of("user_number"), position.integer_of("tool_number")
    pose = pose_of(position, "")
    if user:  # user frame 0 is the base itself
        pose = await read_frame(panel, "user", user) @ pose
    if tool:
        pose = pose @ (await read_frame(panel, "tool", tool)).inverse()
    return pose


async def active_frames(panel: RegisterClient, position: RegisterBlock, *, group_2: bool) -> ActiveFrames:
    """Return what is active and where axes beside the arm stand. No payload is assigned."""
    user, tool = position.integer_of("user_number"), position.integer_of("tool_number")
    flange_tool = await read_frame(panel, "tool", tool) if tool else Pose((0.0, 0.0, 0.0))
    places = enumerate(position.numbers_of("external"), 1)
    external_axes = tuple(ShownExternalAxis(f"E{axis}", shown) for axis, shown in places)
    external_axes += await _read_second_group(panel) if group_2 else ()
    return ActiveFrames(tool, flange_tool, user, external_axes=external_axes)


async def _read_second_group(panel: RegisterClient) -> tuple[ShownExternalAxis, ...]:
    """Return where the axes of motion group 2 stand.

    Where assignment 21 was not made its registers read 0, and so not valid.
    """
    block = await panel.read_block(SECOND_GROUP)
    if block.integer_of("group_2_valid") != 1:
        raise RefusedError(
            panel.device,
            "the controller tells no position of motion group 2.",
            remedy="Make assignment 21 of the set-up page, or take second_group out of the cell file.",
        )
    places = enumerate(block.numbers_of("group_2_joints"), 1)
    return tuple(ShownExternalAxis(f"group 2 J{axis}", shown) for axis, shown in places)
