"""ur_rtde's control program, as the registers show it: commands in, states and results out.

Imitates
    The program rtde_control that ur_rtde 1.6.5 uploads.
Source
    The control program in the source distribution of ur_rtde 1.6.5 (README, register protocol).
Modelled
    The loop once per controller step with its "executing" rule; state 1 during a move and 2 at its end;
    immediate commands that run again every step; stale input and output registers, which are never cleared;
    the word of asynchronous progress; threads for asynchronous moves, servo, speed and jog.
Not modelled
    Two threads that move the arm at once (a real controller ends such a program).
"""

from collections.abc import Callable

from cellcal.fake_devices.universal_robots.controller import UrController
from cellcal.fake_devices.universal_robots.frames import Vector, frame_of, multiply_frames, pose_of
from cellcal.fake_devices.universal_robots.motion import (
    BrakeMove,
    JointMove,
    LinearMove,
    SetPointMotion,
)
from cellcal.fake_devices.universal_robots.programs import ParsedProgram, Waypoint

READY, DONE = 1, 2
CLEAR, STOP_SCRIPT = 0, 255
IMMEDIATE = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
_FINISHED = -1

Act = Callable[["ControlScript"], SetPointMotion | None]


class ControlScript:
    """The loop and its threads. ``acts`` maps command codes to what they do."""

    def __init__(self, controller: UrController, program: ParsedProgram, acts: dict[int, Act]) -> None:
        self.controller, self.name = controller, program.name
        self.offset, self.path = program.register_offset, program.path
        self.background: SetPointMotion | None = None
        self.background_reports = False
        self.contact_direction: Vector | None = None
        self._acts = acts
        self._foreground: SetPointMotion | None = None
        self._executing = False
        self._writes, self._operation = 0, 0
        self._started = False

    # the loop

    def step(self, dt_s: float) -> bool:
        """Run the loop once, then its threads."""
        if not self._started:
            self._started = True
            self.report_progress(_FINISHED)
            self._set_state(READY)
        alive = True
        if self._foreground is not None:
            if self._foreground.advance(self.controller.point, dt_s):
                self._foreground = None
                self._set_state(DONE)
            return True
        alive = self._run_turn()
        if self._foreground is None:
            self._run_background(dt_s)
        return alive

    def _run_turn(self) -> bool:
        command = self.controller.registers.input_integer(self.offset)
        if command in IMMEDIATE:
            self._process_command(command)
            self._set_state(READY)
        elif command == CLEAR:
            self._executing = False
            self._set_state(READY)
        elif not self._executing:
            self._executing = True
            if command == STOP_SCRIPT:
                return False
            self._process_command(command)
            if self._foreground is None:
                self._set_state(DONE)
        return True

    def _process_command(self, command: int) -> None:
        act = self._acts.get(command)
        if act is not None:
            self._foreground = act(self)

    def _run_background(self, dt_s: float) -> None:
        if self.background is None:
            return
        if self.background.advance(self.controller.point, dt_s):
            self.background = None
            if self.background_reports:
                self.report_progress(_FINISHED)

    # registers

    def double_arguments(self, first: int, count: int) -> Vector:
        """Read arguments."""
        return self.controller.registers.input_doubles(first + self.offset, count)

    def integer_argument(self, index: int) -> int:
        """Read an argument."""
        return self.controller.registers.input_integer(index + self.offset)

    def answer_vector(self, values: Vector) -> None:
        """Write a vector result; what lies behind it stays."""
        self.controller.registers.set_doubles(self.offset, tuple(values))

    def answer_upper(self, values: Vector) -> None:
        """Write the second part of a matrix."""
        self.controller.registers.set_doubles(36, tuple(values))

    def answer_integer(self, value: int) -> None:
        """Write an integer result."""
        self.controller.registers.set_integer(1 + self.offset, value)

    def _set_state(self, value: int) -> None:
        self.controller.registers.set_integer(self.offset, value)

    def report_progress(self, value: int) -> None:
        """Write the word of asynchronous progress; negative means finished, 0 a new operation."""
        self._writes = (self._writes + 1) % 128
        if value == 0:
            self._operation = (self._operation + 1) % 128
        word = self._writes << 16 | self._operation << 24
        if value >= 0:
            word |= 1 << 15 | min(value, 0x7FFF)
        self.controller.registers.set_integer(2 + self.offset, word)

    # threads

    def run_asynchronously(self, motion: SetPointMotion) -> None:
        """Start a motion as a thread that reports its progress."""
        self.background, self.background_reports = motion, True
        self.report_progress(0)

    def run_thread(self, motion: SetPointMotion) -> None:
        """Start or retune a servo, speed or jog thread."""
        self.background, self.background_reports = motion, False

    def kill_asynchronous(self) -> bool:
        """End an asynchronous operation if one runs, and say so."""
        if self.background is None or not self.background_reports:
            return False
        self.background = None
        self.report_progress(_FINISHED)
        return True

    def kill_threads(self) -> None:
        """End servo, speed and jog threads."""
        if not self.background_reports:
            self.background = None

    # motions

    def joint_move(self, joints_rad: Vector, speed: float, acceleration: float) -> JointMove:
        """Return a movej."""
        c = self.controller
        return JointMove(c.point.joints_rad, joints_rad, speed, acceleration, c.limits_rad_s)

    def linear_move(self, tool_pose: Vector, speed: float, acceleration: float) -> LinearMove:
        """Return a movel of the active TCP; raises NoSolutionError when its end is out of reach."""
        c = self.controller
        goal = frame_of(tool_pose)
        c.inverse_kinematics(multiply_frames(goal, c.tool_flange), c.point.joints_rad)
        start = multiply_frames(c.kinematics.base_flange(c.point.joints_rad), c.flange_tool)
        return LinearMove(c.kinematics, (start, goal), c.tool_flange, speed, acceleration)

    def make_brake(self, deceleration: float) -> BrakeMove:
        """Return a stop with a joint deceleration."""
        return BrakeMove.of_joints(self.controller.point, deceleration)


class PathMove:
    """The injected path: one waypoint after the other, its number as progress."""

    def __init__(self, script: ControlScript, path: tuple[Waypoint, ...], *, reports: bool) -> None:
        self._script, self._path, self._reports = script, path, reports
        self._next = 0
        self._motion: SetPointMotion | None = None

    def advance(self, point: object, dt_s: float) -> bool:
        """Run the present waypoint."""
        if self._motion is None:
            if self._next >= len(self._path):
                return True
            if self._reports:
                self._script.report_progress(self._next + 1)
            self._motion = self._begin_waypoint(self._path[self._next])
            self._next += 1
        if self._motion.advance(self._script.controller.point, dt_s):
            self._motion = None
        return self._motion is None and self._next >= len(self._path)

    def _begin_waypoint(self, waypoint: Waypoint) -> SetPointMotion:
        c, speed, acceleration = self._script.controller, waypoint.speed, waypoint.acceleration
        if waypoint.verb == "movej":
            target = waypoint.target
            if waypoint.is_pose:
                goal = multiply_frames(frame_of(target), c.tool_flange)
                target = c.inverse_kinematics(goal, c.point.joints_rad)
            return self._script.joint_move(target, speed, acceleration)
        pose = waypoint.target
        if not waypoint.is_pose:
            pose = pose_of(multiply_frames(c.kinematics.base_flange(pose), c.flange_tool))
        return self._script.linear_move(pose, speed, acceleration)


class ForeignProgram:
    """Any other program: its plain moves, between the states that a custom script of ur_rtde writes."""

    def __init__(self, controller: UrController, program: ParsedProgram) -> None:
        self.name = program.name
        self._script = ControlScript(controller, program, {})
        self._moves = PathMove(self._script, program.path, reports=False)
        self._steps = 0

    def step(self, dt_s: float) -> bool:
        registers = self._script.controller.registers
        self._steps += 1
        if self._steps == 1:
            registers.set_integer(0, READY)
            return True
        if not self._moves.advance(None, dt_s) or self._steps < 10:
            return True
        registers.set_integer(0, DONE)
        return False
