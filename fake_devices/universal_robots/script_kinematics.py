"""Joints and tool poses as the branches of the control program compute them."""

from cellcal.fake_devices.universal_robots.control_script import ControlScript
from cellcal.fake_devices.universal_robots.frames import Vector, frame_of, multiply_frames, pose_of


def joints_for(script: ControlScript, pose: Vector, near_rad: Vector | None = None) -> Vector:
    """Return joints [rad] that put the tool at a pose in the base, near the present ones or those given."""
    c = script.controller
    near = c.joints_rad if near_rad is None else near_rad
    return c.inverse_kinematics(multiply_frames(frame_of(pose), c.tool_flange), near)


def tool_pose(script: ControlScript, joints_rad: Vector) -> Vector:
    """Return where the tool is in the base, as position [m] and rotation vector [rad]."""
    c = script.controller
    return pose_of(multiply_frames(c.kinematics.base_flange(joints_rad), c.flange_tool))


def joints_ago(script: ControlScript, steps: int) -> Vector:
    """Return the joints [rad] so many control steps ago; the oldest where the history is shorter."""
    history = script.controller.history
    return history[max(0, len(history) - 1 - max(0, steps))]
