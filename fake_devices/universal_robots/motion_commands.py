"""What the command codes of the control program do that move or stop the arm; source and limits: `commands`."""

from cellcal.fake_devices.universal_robots.control_script import Act, ControlScript, PathMove
from cellcal.fake_devices.universal_robots.frames import (
    IDENTITY,
    Vector,
    frame_of,
    multiply_frames,
    origin_of,
    rotation_matrix,
)
from cellcal.fake_devices.universal_robots.motion import (
    BrakeMove,
    JointSpeedMove,
    ServoMove,
    SetPoint,
    SetPointMotion,
    ToolSpeedMove,
)
from cellcal.fake_devices.universal_robots.script_kinematics import joints_ago, joints_for, tool_pose


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
        script.joint_move(joints_for(script, script.double_arguments(0, 6)), *script.double_arguments(6, 2)),
    )


def _move_linear(script: ControlScript) -> SetPointMotion | None:
    return _begin_move(
        script, script.linear_move(script.double_arguments(0, 6), *script.double_arguments(6, 2))
    )


def _move_linear_to_joints(script: ControlScript) -> SetPointMotion | None:
    return _begin_move(
        script,
        script.linear_move(tool_pose(script, script.double_arguments(0, 6)), *script.double_arguments(6, 2)),
    )


def _move_path(script: ControlScript) -> SetPointMotion | None:
    return _begin_move(script, PathMove(script, script.path, reports=script.integer_argument(1) == 1))


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
    tool = frame_of(tool_pose(script, script.controller.joints_rad))
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
    _run_servo(script, joints_for(script, script.double_arguments(0, 6)))


def _run_servo(script: ControlScript, target: Vector) -> None:
    script.run_thread(ServoMove(target, script.double_arguments(9, 1)[0], script.controller.limits_rad_s))


def _servo_circular(script: ControlScript) -> None:
    joints = joints_for(script, script.double_arguments(0, 6))
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
                self._back = self._script.linear_move(tool_pose(self._script, self._first), 0.25, 1.2)
            return False
        self._run.advance(point, dt_s)
        if self._script.controller.contact_steps > 0:
            self._first = joints_ago(self._script, self._script.controller.contact_steps)
            self._stop = BrakeMove.of_joints(point, 3.0)
        return False


def _move_until_contact(script: ControlScript) -> SetPointMotion:
    c = script.controller
    run = ToolSpeedMove(
        c.kinematics, script.double_arguments(0, 6), script.double_arguments(12, 1)[0], c.flange_tool
    )
    return UntilContact(script, run)


MOTION_ACTS: dict[int, Act] = {
    1: _move_joints,
    2: _move_joints_to_pose,
    3: _move_linear,
    4: _move_linear_to_joints,
    7: _stop_jog,
    9: _speed_joints,
    10: _speed_tool,
    11: _servo_joints,
    12: _servo_circular,
    15: _stop_threads,
    16: _stop_threads,
    24: _servo_tool,
    33: _stop_move,
    34: _stop_move,
    41: _start_jog,
    42: _stop_jog,
    45: _move_path,
    51: _move_until_contact,
}
