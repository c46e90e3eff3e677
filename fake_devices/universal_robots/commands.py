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
    pose_of,
    product,
    rotation_matrix,
    translation,
)
from cellcal.fake_devices.universal_robots.motion import (
    Brake,
    JointSpeed,
    Motion,
    NoSolutionError,
    Servo,
    SetPoint,
    ToolSpeed,
)


def _begin(script: ControlScript, motion: Motion) -> Motion | None:
    """Run a move in the loop, or as a thread when the client asked for that."""
    script.kill_asynchronous()
    if script.integer(1) == 1:
        script.run_asynchronously(motion)
        return None
    return motion


def _move_joints(script: ControlScript) -> Motion | None:
    target = script.doubles(0, 6)
    return _begin(script, script.joint_move(target, *script.doubles(6, 2)))


def _move_joints_to_pose(script: ControlScript) -> Motion | None:
    return _begin(script, script.joint_move(_joints_for(script, script.doubles(0, 6)), *script.doubles(6, 2)))


def _move_linear(script: ControlScript) -> Motion | None:
    return _begin(script, script.linear_move(script.doubles(0, 6), *script.doubles(6, 2)))


def _move_linear_to_joints(script: ControlScript) -> Motion | None:
    return _begin(script, script.linear_move(_tool_pose(script, script.doubles(0, 6)), *script.doubles(6, 2)))


def _move_path(script: ControlScript) -> Motion | None:
    return _begin(script, PathMove(script, script.path, reports=script.integer(1) == 1))


def _joints_for(script: ControlScript, pose: Vector, near_rad: Vector | None = None) -> Vector:
    c = script.controller
    near = c.joints_rad if near_rad is None else near_rad
    return c.inverse_kinematics(product(frame_of(pose), c.tool_flange), near)


def _tool_pose(script: ControlScript, joints_rad: Vector) -> Vector:
    c = script.controller
    return pose_of(product(c.kinematics.flange(joints_rad), c.flange_tool))


def _speed_joints(script: ControlScript) -> None:
    script.speed_is_linear = False
    script.run_thread(JointSpeed(script.doubles(0, 6), script.doubles(6, 1)[0]))


def _speed_tool(script: ControlScript) -> None:
    _run_tool_speed(script, script.doubles(0, 6), script.doubles(6, 1)[0])


def _run_tool_speed(script: ControlScript, velocity: Vector, acceleration: float) -> None:
    script.speed_is_linear = True
    running = script.background
    if isinstance(running, ToolSpeed):
        running.target, running.acceleration = velocity, acceleration
        return
    c = script.controller
    script.run_thread(ToolSpeed(c.kinematics, velocity, acceleration, c.flange_tool))


def _jog(script: ControlScript) -> None:
    speeds, feature, acceleration = script.doubles(0, 6), script.doubles(6, 1)[0], script.doubles(7, 1)[0]
    tool = frame_of(_tool_pose(script, script.controller.joints_rad))
    frame = {1: tool, 2: frame_of(script.doubles(8, 6))}.get(int(feature), IDENTITY)
    turn = (*frame[0][:3], 0.0), (*frame[1][:3], 0.0), (*frame[2][:3], 0.0)
    linear, angular = (
        translation(product(turn, rotation_matrix((0.0,) * 3, part))) for part in (speeds[:3], speeds[3:])
    )
    _run_tool_speed(script, (*linear, *angular), acceleration)


def _servo_joints(script: ControlScript) -> None:
    _servo(script, script.doubles(0, 6))


def _servo_tool(script: ControlScript) -> None:
    _servo(script, _joints_for(script, script.doubles(0, 6)))


def _servo(script: ControlScript, target: Vector) -> None:
    script.run_thread(Servo(target, script.doubles(9, 1)[0], script.controller.limits_rad_s))


def _servo_circular(script: ControlScript) -> None:
    joints = _joints_for(script, script.doubles(0, 6))
    script.run_thread(Servo(joints, 0.1, script.controller.limits_rad_s))


def _stop_threads(script: ControlScript) -> Motion:
    script.kill_threads()
    return script.brake(script.doubles(0, 1)[0])


def _stop_jog(script: ControlScript) -> Motion:
    script.kill_threads()
    return script.brake(1.2)


def _stop_move(script: ControlScript) -> Motion | None:
    script.kill_asynchronous()
    brake = script.brake(script.doubles(0, 1)[0])
    if script.integer(1) == 1:
        script.run_asynchronously(brake)
        return None
    return brake


def _set_payload(script: ControlScript) -> None:
    c = script.controller
    c.payload_kg = script.doubles(0, 1)[0]
    cog = script.doubles(1, 3)
    if any(cog):
        c.cog_m = (cog[0], cog[1], cog[2])


def _set_target_payload(script: ControlScript) -> None:
    _set_payload(script)
    inertia = script.doubles(4, 6)
    script.controller.inertia = (inertia[0], inertia[1], inertia[2], inertia[3], inertia[4], inertia[5])


def _tool_contact(script: ControlScript) -> None:
    script.answer_integer(script.controller.contact_steps)


def _joint_history(script: ControlScript) -> None:
    script.answer(_joints_ago(script, script.integer(1)))


def _joints_ago(script: ControlScript, steps: int) -> Vector:
    history = script.controller.history
    return history[max(0, len(history) - 1 - max(0, steps))]


def _step_time(script: ControlScript) -> None:
    script.answer((1.0 / script.controller.identity.base_rate_hz,))


def _target_waypoint(script: ControlScript) -> None:
    script.answer(_tool_pose(script, script.controller.point.joints_rad))


def _set_tcp(script: ControlScript) -> None:
    script.controller.set_tcp(script.doubles(0, 6))


def _inverse_default(script: ControlScript) -> None:
    script.answer(_joints_for(script, script.doubles(0, 6)))


def _inverse_near(script: ControlScript) -> None:
    script.answer(_joints_for(script, script.doubles(0, 6), script.doubles(6, 6)))


def _has_inverse_default(script: ControlScript) -> None:
    script.answer_integer(int(_reaches(script, script.doubles(0, 6), script.controller.joints_rad)))


def _has_inverse_near(script: ControlScript) -> None:
    script.answer_integer(int(_reaches(script, script.doubles(0, 6), script.doubles(6, 6))))


def _reaches(script: ControlScript, pose: Vector, near_rad: Vector) -> bool:
    try:
        _joints_for(script, pose, near_rad)
    except NoSolutionError:
        return False
    return True


def _pose_is_safe(script: ControlScript) -> None:
    script.answer_integer(int(_reaches(script, script.doubles(0, 6), script.controller.joints_rad)))


def _joints_are_safe(script: ControlScript) -> None:
    script.answer_integer(int(script.controller.within_limits(script.doubles(0, 6))))


def _protective_stop(script: ControlScript) -> None:
    script.controller.protective_stop()


def _watchdog(script: ControlScript) -> None:
    register = f"input_int_register_{script.offset if script.offset in (0, 24) else 0}"
    script.controller.set_watchdog(register, script.doubles(0, 1)[0])


def _torques(script: ControlScript) -> None:
    script.answer((0.0,) * 6)


def _pose_trans(script: ControlScript) -> None:
    a, b = frame_of(script.doubles(0, 6)), frame_of(script.doubles(6, 6))
    script.answer(pose_of(product(a, b)))


def _tcp_offset(script: ControlScript) -> None:
    script.answer(script.controller.tcp)


def _forward_default(script: ControlScript) -> None:
    script.answer(_tool_pose(script, script.controller.joints_rad))


def _forward_given(script: ControlScript) -> None:
    flange = script.controller.kinematics.flange(script.doubles(0, 6))
    script.answer(pose_of(product(flange, frame_of(script.doubles(6, 6)))))


def _flange_pose(script: ControlScript) -> None:
    c = script.controller
    script.answer(pose_of(c.kinematics.flange(c.joints_rad)))


def _is_steady(script: ControlScript) -> None:
    script.answer_integer(int(not any(script.controller.velocity_rad_s)))


class UntilContact:
    """Run until something is touched, stop, go back to where it was touched first."""

    def __init__(self, script: ControlScript, run: Motion) -> None:
        self._script, self._run = script, run
        self._stop: Motion | None = None
        self._back: Motion | None = None
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
            self._stop = Brake.of_joints(point, 3.0)
        return False


def _move_until_contact(script: ControlScript) -> Motion:
    c = script.controller
    run = ToolSpeed(c.kinematics, script.doubles(0, 6), script.doubles(12, 1)[0], c.flange_tool)
    return UntilContact(script, run)


def _contact_detection(script: ControlScript) -> None:
    script.contact_direction = script.doubles(0, 6)


def _read_contact(script: ControlScript) -> None:
    watched = script.contact_direction is not None
    script.answer_integer(script.controller.contact_steps if watched else 0)


def _stop_contact(script: ControlScript) -> None:
    _read_contact(script)
    script.contact_direction = None


def _gravity(script: ControlScript) -> None:
    script.controller.gravity = script.doubles(0, 3)


def _freedrive_status(script: ControlScript) -> None:
    script.answer_integer(0)


def _jacobian(script: ControlScript) -> None:
    c = script.controller
    tip = translation(product(c.kinematics.flange(c.joints_rad), c.flange_tool))
    _matrix(script, tuple(c.kinematics.jacobian(c.joints_rad, tip).T.reshape(-1).tolist()))


def _zero_matrix(script: ControlScript) -> None:
    _matrix(script, (0.0,) * 36)


def _matrix(script: ControlScript, columns: Vector) -> None:
    if script.controller.identity.version >= (5, 23):
        script.answer(columns[:24])
        script.answer_upper(columns[24:])


def _nothing(script: ControlScript) -> None:
    """Accept without an effect that this fake could show."""


ACTS: dict[int, Act] = {
    1: _move_joints,
    2: _move_joints_to_pose,
    3: _move_linear,
    4: _move_linear_to_joints,
    6: _nothing,
    7: _stop_jog,
    8: _nothing,
    9: _speed_joints,
    10: _speed_tool,
    11: _servo_joints,
    12: _servo_circular,
    15: _stop_threads,
    16: _stop_threads,
    17: _set_payload,
    18: _nothing,
    19: _nothing,
    20: _nothing,
    21: _nothing,
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
    35: _watchdog,
    36: _pose_is_safe,
    37: _joints_are_safe,
    38: _torques,
    39: _pose_trans,
    40: _tcp_offset,
    41: _jog,
    42: _stop_jog,
    43: _forward_default,
    44: _forward_given,
    45: _move_path,
    46: _inverse_default,
    47: _is_steady,
    51: _move_until_contact,
    52: _nothing,
    53: _nothing,
    54: _freedrive_status,
    56: _nothing,
    57: _nothing,
    58: _flange_pose,
    59: _gravity,
    60: _has_inverse_default,
    61: _has_inverse_near,
    62: _contact_detection,
    63: _stop_contact,
    64: _read_contact,
    65: _set_target_payload,
    66: _nothing,
    67: _zero_matrix,
    68: _torques,
    69: _torques,
    70: _jacobian,
    71: _zero_matrix,
}
