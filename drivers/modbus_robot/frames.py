"""Tool and user frames of the controller, and the flange pose behind them. W P R is converted here only."""

from typing import Literal

import numpy as np

from cellcal.calibration.geometry import Pose, homogeneous
from cellcal.calibration.orientation import rotation_from, values_from
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import ActiveFrames
from cellcal.drivers.modbus_robot.panel import Block, Panel

Kind = Literal["tool", "user"]
_CONVENTION = "fanuc_wpr"
_SAME_M = 1e-6  # float32 millimetres of a few metres are good to a quarter of this
_SAME_RAD = 2e-7 * 2 * np.pi


def pose_of(block: Block, prefix: str) -> Pose:
    """Return the pose in the registers ``<prefix>xyz`` and ``<prefix>wpr``."""
    rotation = rotation_from(_CONVENTION, np.array(block.numbers(f"{prefix}wpr")))
    return Pose.from_matrix(homogeneous(rotation, np.array(block.numbers(f"{prefix}xyz"))))


async def read_frame(panel: Panel, kind: Kind, number: int) -> Pose:
    """Return tool frame (seen from the flange) or user frame (seen from the base) ``number``."""
    return pose_of(await panel.read(f"{kind}_xyz", f"{kind}_wpr", number=number), f"{kind}_")


async def write_frame(panel: Panel, kind: Kind, number: int, pose: Pose) -> Pose:
    """Write a frame in one telegram, read it back, return what was read."""
    rest = await panel.read(f"{kind}_rest", number=number)
    wpr = values_from(_CONVENTION, pose.rotation())
    values = {
        f"{kind}_xyz": pose.position_m,
        f"{kind}_wpr": tuple(float(angle) for angle in wpr),
        f"{kind}_rest": rest.numbers(f"{kind}_rest"),
        f"{kind}_valid": (1,),
    }
    await panel.write(values, number=number)
    found = await read_frame(panel, kind, number)
    if not _same(found, pose):
        raise RefusedError(
            panel.device,
            f"{kind} frame {number} was not written as sent.",
            remedy="Check that the frame is not locked on the controller, then write again.",
        )
    return found


async def flange_pose(panel: Panel, position: Block) -> Pose:
    """Take the active tool and user frame off the pose that the controller shows.

    Their values come from the controller too, so a frame that somebody edited cannot bend the result.
    """
    if position.integer("pose_valid") != 1:
        raise RefusedError(
            panel.device,
            "the controller does not know its Cartesian position.",
            remedy="Recover the mastering first.",
        )
    user, tool = position.integer("user_number"), position.integer("tool_number")
    pose = pose_of(position, "")
    if user:  # user frame 0 is the base itself
        pose = await read_frame(panel, "user", user) @ pose
    if tool:
        pose = pose @ (await read_frame(panel, "tool", tool)).inverse()
    return pose


async def active_frames(panel: Panel, position: Block) -> ActiveFrames:
    """Return the numbers that are active, and the tool behind its number. No payload is assigned."""
    user, tool = position.integer("user_number"), position.integer("tool_number")
    flange_tool = await read_frame(panel, "tool", tool) if tool else Pose((0.0, 0.0, 0.0))
    return ActiveFrames(tool, flange_tool, user)


def _same(found: Pose, sent: Pose) -> bool:
    near = np.allclose(found.position_m, sent.position_m, rtol=0, atol=_SAME_M)
    return near and bool(np.allclose(found.rotation(), sent.rotation(), rtol=0, atol=_SAME_RAD))
