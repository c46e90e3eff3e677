"""Frames that a controller has in its world, seen from a robot whose base is elsewhere there."""

from dataclasses import replace

import numpy as np

from cellcal.calibration.geometry import Pose, log_rotation
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.positions import ProgramFrames, Remark


def seen_from_base(frames: ProgramFrames, world_base: Pose | None) -> ProgramFrames:
    """Return frames with the base frames as the robot's base sees them, where a file has them in the world."""
    if world_base is None:
        return frames
    base_world = world_base.inverse()
    own, cell = (
        {name: base_world @ pose for name, pose in poses.items()}
        for poses in (frames.base_frame, frames.cell_base_frame)
    )
    return replace(frames, base_frame=own, cell_base_frame=cell)


def standing_remark(world_base: Pose) -> Remark:
    """Return what a person must know of a robot that does not stand at the origin of its controller's world."""
    x, y, z = (1e3 * value for value in world_base.position_m)
    text = make_message(
        "Its controller has the robot's base at {x:.1f}, {y:.1f}, {z:.1f} mm in the world, turned by {turn_deg:.1f} "
        "deg: frames of its files are taken from the base, and so are a change and the frames of the project. "
        "A clone is taken to stand there, too.",
        x=x,
        y=y,
        z=z,
        turn_deg=np.degrees(np.linalg.norm(log_rotation(world_base.rotation_matrix()))),
    )
    return Remark(0, "foreign", text)
