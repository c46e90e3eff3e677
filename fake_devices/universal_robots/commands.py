"""What each command code of the control program does.

Imitates
    The branches of ur_rtde's control program.
Source
    The control program in the source distribution of ur_rtde 1.6.5 (README, commands).
Modelled
    All codes of the table; argument and result registers as in the table, stale ones included.
Not modelled
    Force mode, zeroing and damping change nothing; joint torques and dynamics are zero.
"""

from cellcal.fake_devices.universal_robots.control_script import Act, ControlScript
from cellcal.fake_devices.universal_robots.frames import Vector, frame_of, multiply_frames, origin_of, pose_of
from cellcal.fake_devices.universal_robots.motion import NoSolutionError
from cellcal.fake_devices.universal_robots.motion_commands import MOTION_ACTS
from cellcal.fake_devices.universal_robots.script_kinematics import joints_ago, joints_for, tool_pose


def _set_payload(script: ControlScript) -> None:
    c = script.controller
    c.payload_kg = script.double_arguments(0, 1)[0]
    cog = script.double_arguments(1, 3)
    if any(cog):
        c.cog_m = (cog[0], cog[1], cog[2])


def _set_target_payload(script: ControlScript) -> None:
    _set_payload(script)
    inertia = script.double_arguments(4, 6)
    script.controller.inertia = (inertia[0], inertia[1], inertia[2], inertia[3], inertia[4], inertia[5])


def _tool_contact(script: ControlScript) -> None:
    script.answer_integer(script.controller.contact_steps)


def _joint_history(script: ControlScript) -> None:
    script.answer_vector(joints_ago(script, script.integer_argument(1)))


def _step_time(script: ControlScript) -> None:
    script.answer_vector((1.0 / script.controller.identity.base_rate_hz,))


def _target_waypoint(script: ControlScript) -> None:
    script.answer_vector(tool_pose(script, script.controller.point.joints_rad))


def _set_tcp(script: ControlScript) -> None:
    script.controller.set_tcp(script.double_arguments(0, 6))


def _inverse_default(script: ControlScript) -> None:
    script.answer_vector(joints_for(script, script.double_arguments(0, 6)))


def _inverse_near(script: ControlScript) -> None:
    script.answer_vector(joints_for(script, script.double_arguments(0, 6), script.double_arguments(6, 6)))


def _has_inverse_default(script: ControlScript) -> None:
    script.answer_integer(
        int(_is_reachable(script, script.double_arguments(0, 6), script.controller.joints_rad))
    )


def _has_inverse_near(script: ControlScript) -> None:
    script.answer_integer(
        int(_is_reachable(script, script.double_arguments(0, 6), script.double_arguments(6, 6)))
    )


def _is_reachable(script: ControlScript, pose: Vector, near_rad: Vector) -> bool:
    try:
        joints_for(script, pose, near_rad)
    except NoSolutionError:
        return False
    return True


def _pose_is_safe(script: ControlScript) -> None:
    script.answer_integer(
        int(_is_reachable(script, script.double_arguments(0, 6), script.controller.joints_rad))
    )


def _joints_are_safe(script: ControlScript) -> None:
    script.answer_integer(int(script.controller.within_limits(script.double_arguments(0, 6))))


def _protective_stop(script: ControlScript) -> None:
    script.controller.protective_stop()


def _set_watchdog(script: ControlScript) -> None:
    register = f"input_int_register_{script.offset if script.offset in (0, 24) else 0}"
    script.controller.set_watchdog(register, script.double_arguments(0, 1)[0])


def _answer_torques(script: ControlScript) -> None:
    script.answer_vector((0.0,) * 6)


def _pose_trans(script: ControlScript) -> None:
    a, b = frame_of(script.double_arguments(0, 6)), frame_of(script.double_arguments(6, 6))
    script.answer_vector(pose_of(multiply_frames(a, b)))


def _tcp_offset(script: ControlScript) -> None:
    script.answer_vector(script.controller.tcp)


def _forward_default(script: ControlScript) -> None:
    script.answer_vector(tool_pose(script, script.controller.joints_rad))


def _forward_given(script: ControlScript) -> None:
    flange = script.controller.kinematics.base_flange(script.double_arguments(0, 6))
    script.answer_vector(pose_of(multiply_frames(flange, frame_of(script.double_arguments(6, 6)))))


def _flange_pose(script: ControlScript) -> None:
    c = script.controller
    script.answer_vector(pose_of(c.kinematics.base_flange(c.joints_rad)))


def _is_steady(script: ControlScript) -> None:
    script.answer_integer(int(not any(script.controller.velocity_rad_s)))


def _contact_detection(script: ControlScript) -> None:
    script.contact_direction = script.double_arguments(0, 6)


def _read_contact(script: ControlScript) -> None:
    watched = script.contact_direction is not None
    script.answer_integer(script.controller.contact_steps if watched else 0)


def _stop_contact(script: ControlScript) -> None:
    _read_contact(script)
    script.contact_direction = None


def _set_gravity(script: ControlScript) -> None:
    script.controller.gravity = script.double_arguments(0, 3)


def _freedrive_status(script: ControlScript) -> None:
    script.answer_integer(0)


def _answer_jacobian(script: ControlScript) -> None:
    c = script.controller
    tip = origin_of(multiply_frames(c.kinematics.base_flange(c.joints_rad), c.flange_tool))
    _answer_matrix(script, tuple(c.kinematics.tip_jacobian(c.joints_rad, tip).T.reshape(-1).tolist()))


def _zero_matrix(script: ControlScript) -> None:
    _answer_matrix(script, (0.0,) * 36)


def _answer_matrix(script: ControlScript, columns: Vector) -> None:
    if script.controller.identity.version >= (5, 23):
        script.answer_vector(columns[:24])
        script.answer_upper(columns[24:])


def _do_nothing(script: ControlScript) -> None:
    """Accept without an effect that this fake could show."""


ACTS: dict[int, Act] = MOTION_ACTS | {
    6: _do_nothing,
    8: _do_nothing,
    17: _set_payload,
    18: _do_nothing,
    19: _do_nothing,
    20: _do_nothing,
    21: _do_nothing,
    25: _tool_contact,
    26: _step_time,
    27: _joint_history,
    28: _target_waypoint,
    29: _set_tcp,
    30: _inverse_near,
    31: _protective_stop,
    35: _set_watchdog,
    36: _pose_is_safe,
    37: _joints_are_safe,
    38: _answer_torques,
    39: _pose_trans,
    40: _tcp_offset,
    43: _forward_default,
    44: _forward_given,
    46: _inverse_default,
    47: _is_steady,
    52: _do_nothing,
    53: _do_nothing,
    54: _freedrive_status,
    56: _do_nothing,
    57: _do_nothing,
    58: _flange_pose,
    59: _set_gravity,
    60: _has_inverse_default,
    61: _has_inverse_near,
    62: _contact_detection,
    63: _stop_contact,
    64: _read_contact,
    65: _set_target_payload,
    66: _do_nothing,
    67: _zero_matrix,
    68: _answer_torques,
    69: _answer_torques,
    70: _answer_jacobian,
    71: _zero_matrix,
}
