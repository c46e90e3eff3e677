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

from cellcal.fake_devices.universal_robots.control_script import Act, ControlScript, PathMove
from cellcal.fake_devices.universal_robots.frames import (
    IDENTITY,
    Vector,
    frame_of,
    multiply_frames,
    origin_of,
    pose_of,
    rotation_matrix,
)
from cellcal.fake_devices.universal_robots.motion import (
    BrakeMove,
    JointSpeedMove,
    NoSolutionError,
    ServoMove,
    SetPoint,
    SetPointMotion,
    ToolSpeedMove,
)


def _begin_move(script: ControlScript, motion: SetPointMotion) -> SetPointMotion | None:
    """Run a move in the loop, or as a thread when the client asked for that."""
    script.kill_asynchronous()
    if script.integer_argument(1) == 1:
        script.run_asynchronously(motion)
        return None
    return motion


def _move_joints(script: ControlScript) -> SetPointMotion | None:
    target = script.double_arguments(0, 6)
    return _begin_move(script, script.joint_move(target, *script.double_arguments(6, 2)))


def _move_joints_to_pose(script: ControlScript) -> SetPointMotion | None:
    return _begin_move(
        script,
        script.joint_move(_joints_for(script, script.double_arguments(0, 6)), *script.double_arguments(6, 2)),
    )


def _move_linear(script: ControlScript) -> SetPointMotion | None:
    return _begin_move(
        script, script.linear_move(script.double_arguments(0, 6), *script.double_arguments(6, 2))
    )


def _move_linear_to_joints(script: ControlScript) -> SetPointMotion | None:
    return _begin_move(
        script,
        script.linear_move(_tool_pose(script, script.double_arguments(0, 6)), *script.double_arguments(6, 2)),
    )


def _move_path(script: ControlScript) -> SetPointMotion | None:
    return _begin_move(script, PathMove(script, script.path, reports=script.integer_argument(1) == 1))


def _joints_for(script: ControlScript, pose: Vector, near_rad: Vector | None = None) -> Vector:
    c = script.controller
    near = c.joints_rad if near_rad is None else near_rad
    return c.inverse_kinematics(multiply_frames(frame_of(pose), c.tool_flange), near)


def _tool_pose(script: ControlScript, joints_rad: Vector) -> Vector:
    c = script.controller
    return pose_of(multiply_frames(c.kinematics.base_flange(joints_rad), c.flange_tool))


def _speed_joints(script: ControlScript) -> None:
    script.run_thread(JointSpeedMove(script.double_arguments(0, 6), script.double_arguments(6, 1)[0]))


def _speed_tool(script: ControlScript) -> None:
    _run_tool_speed(script, script.double_arguments(0, 6), script.double_arguments(6, 1)[0])


def _run_tool_speed(script: ControlScript, velocity: Vector, acceleration: float) -> None:
    running = script.background
    if isinstance(running, ToolSpeedMove):
        running.target, running.acceleration = velocity, acceleration
        return
    c = script.controller
    script.run_thread(ToolSpeedMove(c.kinematics, velocity, acceleration, c.flange_tool))


def _start_jog(script: ControlScript) -> None:
    speeds, feature, acceleration = (
        script.double_arguments(0, 6),
        script.double_arguments(6, 1)[0],
        script.double_arguments(7, 1)[0],
    )
    tool = frame_of(_tool_pose(script, script.controller.joints_rad))
    frame = {1: tool, 2: frame_of(script.double_arguments(8, 6))}.get(int(feature), IDENTITY)
    turn = (*frame[0][:3], 0.0), (*frame[1][:3], 0.0), (*frame[2][:3], 0.0)
    linear, angular = (
        origin_of(multiply_frames(turn, rotation_matrix((0.0,) * 3, part)))
        for part in (speeds[:3], speeds[3:])
    )
    _run_tool_speed(script, (*linear, *angular), acceleration)


def _servo_joints(script: ControlScript) -> None:
    _run_servo(script, script.double_arguments(0, 6))


def _servo_tool(script: ControlScript) -> None:
    _run_servo(script, _joints_for(script, script.double_arguments(0, 6)))


def _run_servo(script: ControlScript, target: Vector) -> None:
    script.run_thread(ServoMove(target, script.double_arguments(9, 1)[0], script.controller.limits_rad_s))


def _servo_circular(script: ControlScript) -> None:
    joints = _joints_for(script, script.double_arguments(0, 6))
    script.run_thread(ServoMove(joints, 0.1, script.controller.limits_rad_s))


def _stop_threads(script: ControlScript) -> SetPointMotion:
    script.kill_threads()
    return script.make_brake(script.double_arguments(0, 1)[0])


def _stop_jog(script: ControlScript) -> SetPointMotion:
    script.kill_threads()
    return script.make_brake(1.2)


def _stop_move(script: ControlScript) -> SetPointMotion | None:
    script.kill_asynchronous()
    brake = script.make_brake(script.double_arguments(0, 1)[0])
    if script.integer_argument(1) == 1:
        script.run_asynchronously(brake)
        return None
    return brake


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
    script.answer_vector(_joints_ago(script, script.integer_argument(1)))


def _joints_ago(script: ControlScript, steps: int) -> Vector:
    history = script.controller.history
    return history[max(0, len(history) - 1 - max(0, steps))]


def _step_time(script: ControlScript) -> None:
    script.answer_vector((1.0 / script.controller.identity.base_rate_hz,))


def _target_waypoint(script: ControlScript) -> None:
    script.answer_vector(_tool_pose(script, script.controller.point.joints_rad))


def _set_tcp(script: ControlScript) -> None:
    script.controller.set_tcp(script.double_arguments(0, 6))


def _inverse_default(script: ControlScript) -> None:
    script.answer_vector(_joints_for(script, script.double_arguments(0, 6)))


def _inverse_near(script: ControlScript) -> None:
    script.answer_vector(_joints_for(script, script.double_arguments(0, 6), script.double_arguments(6, 6)))


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
        _joints_for(script, pose, near_rad)
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
    script.answer_vector(_tool_pose(script, script.controller.joints_rad))


def _forward_given(script: ControlScript) -> None:
    flange = script.controller.kinematics.base_flange(script.double_arguments(0, 6))
    script.answer_vector(pose_of(multiply_frames(flange, frame_of(script.double_arguments(6, 6)))))


def _flange_pose(script: ControlScript) -> None:
    c = script.controller
    script.answer_vector(pose_of(c.kinematics.base_flange(c.joints_rad)))


def _is_steady(script: ControlScript) -> None:
    script.answer_integer(int(not any(script.controller.velocity_rad_s)))


class UntilContact:
    """Run until something is touched, stop, go back to where it was touched first."""

    def __init__(self, script: ControlScript, run: SetPointMotion) -> None:
        self._script, self._run = script, run
        self._stop: SetPointMotion | None = None
        self._back: SetPointMotion | None = None
        self._first: Vector = ()

    def advance(self, point: SetPoint, dt_s: float) -> bool:
        """Move on."""
        if self._back is not None:
            return self._back.advance(point, dt_s)
        if self._stop is not None:
            if self._stop.advance(point, dt_s):
                self._back = self._script.linear_move(_tool_pose(self._script, self._first), 0.25, 1.2)
            return False
        self._run.advance(point, dt_s)
        if self._script.controller.contact_steps > 0:
            self._first = _joints_ago(self._script, self._script.controller.contact_steps)
            self._stop = BrakeMove.of_joints(point, 3.0)
        return False


def _move_until_contact(script: ControlScript) -> SetPointMotion:
    c = script.controller
    run = ToolSpeedMove(
        c.kinematics, script.double_arguments(0, 6), script.double_arguments(12, 1)[0], c.flange_tool
    )
    return UntilContact(script, run)


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


ACTS: dict[int, Act] = {
    1: _move_joints,
    2: _move_joints_to_pose,
    3: _move_linear,
    4: _move_linear_to_joints,
    6: _do_nothing,
    7: _stop_jog,
    8: _do_nothing,
    9: _speed_joints,
    10: _speed_tool,
    11: _servo_joints,
    12: _servo_circular,
    15: _stop_threads,
    16: _stop_threads,
    17: _set_payload,
    18: _do_nothing,
    19: _do_nothing,
    20: _do_nothing,
    21: _do_nothing,
    24: _servo_tool,
    25: _tool_contact,
    26: _step_time,
    27: _joint_history,
    28: _target_waypoint,
    29: _set_tcp,
    30: _inverse_near,
    31: _protective_stop,
    33: _stop_move,
    34: _stop_move,
    35: _set_watchdog,
    36: _pose_is_safe,
    37: _joints_are_safe,
    38: _answer_torques,
    39: _pose_trans,
    40: _tcp_offset,
    41: _start_jog,
    42: _stop_jog,
    43: _forward_default,
    44: _forward_given,
    45: _move_path,
    46: _inverse_default,
    47: _is_steady,
    51: _move_until_contact,
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
