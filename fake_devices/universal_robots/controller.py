"""The controller behind the ports: modes, the program that runs, the set point, one step at a time.

Imitates
    The control box of a Universal Robots arm of the e-Series, software 5.6 to 5.22.
Source
    The maker's RTDE guide and dashboard pages; the behaviour that ur_rtde 1.6.5 counts on (README).
Modelled
    Robot, safety and runtime state; one program at a time; protective and emergency stop; power on, brake
    release; active TCP, payload, speed slider, digital and analog outputs; the watchdog of rtde_set_watchdog.
Not modelled
    Dynamics: forces, torques and currents are constants. A protective stop is at standstill at once.

Motion runs in the world's time, so a world that runs 60 times as fast moves the arm 60 times as fast; the
RTDE time stamp, the watchdog and the rate of the script loop are agreements with the client: real time.
"""

from collections import deque
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellcal.fake_devices.universal_robots.frames import IDENTITY, Frame, Vector, frame_of, invert_frame
from cellcal.fake_devices.universal_robots.identity import UrIdentity
from cellcal.fake_devices.universal_robots.kinematics import UrArmKinematics, factory_calibration
from cellcal.fake_devices.universal_robots.motion import BrakeMove, NoSolutionError, SetPoint, SetPointMotion
from cellcal.fake_devices.universal_robots.registers import GeneralRegisters
from cellcal.fake_devices.universal_robots.states import RobotMode, RuntimeState, SafetyMode

_HISTORY_STEPS = 200


class ArmPort(Protocol):
    """The arm's functions that the controller needs."""

    known_dh: NDArray[np.float64]  # (6, 5): what this controller's factory calibration says
    nominal_dh: NDArray[np.float64]
    lower_rad: NDArray[np.float64]
    upper_rad: NDArray[np.float64]
    max_speed_rad_s: NDArray[np.float64]

    @property
    def joints_rad(self) -> NDArray[np.float64]: ...
    @property
    def controller_joints_rad(self) -> NDArray[np.float64]: ...
    def follow_set_point(self, joints_rad: ArrayLike) -> None: ...
    def put_joints(self, joints_rad: ArrayLike) -> None: ...
    def update_backlash(self, dt_s: float = 0.0) -> None: ...


class RunningProgram(Protocol):
    """A program that the controller executes."""

    name: str

    def step(self, dt_s: float) -> bool:
        """Run one step; return whether the program goes on."""
        ...


class UrController:
    """State of one control box. Only its methods change the state; the ports read it."""

    def __init__(self, arm: ArmPort, identity: UrIdentity) -> None:
        self.arm, self.identity = arm, identity
        self.kinematics = UrArmKinematics(factory_calibration(arm.known_dh), arm.nominal_dh)
        self.limits_rad_s: Vector = tuple(float(value) for value in arm.max_speed_rad_s)
        self.registers = GeneralRegisters()
        self.robot_mode, self.safety_mode = RobotMode.RUNNING, SafetyMode.NORMAL
        self.runtime, self.remote, self.automatic = RuntimeState.STOPPED, True, True
        self.program: RunningProgram | None = None
        self.loaded_program = "cell.urp"
        self.joints_rad: Vector = tuple(arm.controller_joints_rad.tolist())
        self.point = SetPoint(self.joints_rad)
        self.history: deque[Vector] = deque([self.joints_rad], maxlen=_HISTORY_STEPS)
        self.tcp: Vector = (0.0,) * 6
        self.flange_tool: Frame = IDENTITY
        self.tool_flange: Frame = IDENTITY
        self.payload_kg, self.cog_m, self.inertia = 0.0, (0.0, 0.0, 0.0), (0.0,) * 6
        self.gravity: Vector = (0.0, 0.0, 9.82)
        self.speed_fraction, self.digital_outputs, self.analog_outputs = 1.0, 0, [0.0, 0.0]
        self.timestamp_s, self.steps = 0.0, 0
        self.no_inverse_kinematics = False
        self.contact_steps = 0
        self._world_s: float | None = None
        self._braking: SetPointMotion | None = None
        self._watchdog: tuple[str, float] | None = None
        self.watchdog_stops = 0  # programs that it ended
        self._locked_until_s = 0.0

    # one step

    def step(self, timestamp_s: float, world_s: float) -> None:
        """Advance to a time stamp (real) and a world time."""
        dt_s = 0.0 if self._world_s is None else max(0.0, world_s - self._world_s)
        self.timestamp_s, self._world_s = timestamp_s, world_s
        self.steps += 1
        self._look_at_watchdog()
        self._read_arm()
        before = self.point.joints_rad
        self._move_set_point(dt_s)
        if self.point.joints_rad != before:
            self._drive_arm(before)
        self.history.append(self.joints_rad)
        self.contact_steps += bool(self.contact_steps)

    @property
    def velocity_rad_s(self) -> Vector:
        """How fast the joints travel. A program's motion keeps its own time, which the speed slider stretches."""
        in_program = self.program is not None and self._braking is None
        fraction = self.speed_fraction if in_program else 1.0
        return tuple(fraction * v for v in self.point.velocity_rad_s)

    def _read_arm(self) -> None:
        self.joints_rad = tuple(self.arm.controller_joints_rad.tolist())
        if not any(self.point.velocity_rad_s):
            self.point.move_to(self.joints_rad)

    def _move_set_point(self, dt_s: float) -> None:
        if self._braking is not None:
            if self._braking.advance(self.point, dt_s):
                self._braking = None
        elif self.program is not None and self.runtime is RuntimeState.PLAYING:
            try:
                if not self.program.step(dt_s * self.speed_fraction):
                    self.end_program()
            except NoSolutionError:
                self.end_program()

    def _drive_arm(self, before: Vector) -> None:
        joints = np.array(self.point.joints_rad)
        if np.any(joints < self.arm.lower_rad) or np.any(joints > self.arm.upper_rad):
            self.point.move_to(before)
            self.protective_stop()
            return
        self.arm.follow_set_point(joints + (self.arm.joints_rad - self.arm.controller_joints_rad))
        self.arm.update_backlash()
        self.joints_rad = tuple(self.arm.controller_joints_rad.tolist())

    # programs

    def start_program(self, program: RunningProgram) -> None:
        """Replace the running program. Refused while stopped for safety, not powered or in local control."""
        if not self.ready_for_programs:
            return
        self.end_program()
        self.program, self.runtime = program, RuntimeState.PLAYING

    @property
    def ready_for_programs(self) -> bool:
        """Whether a program sent over the network would run."""
        normal = self.safety_mode is SafetyMode.NORMAL
        return normal and self.robot_mode is RobotMode.RUNNING and self.remote

    def end_program(self) -> None:
        """Stop whatever runs, as the stop button does; a moving arm brakes."""
        self.point.move_to(self.point.joints_rad, self.velocity_rad_s)
        self.program, self._watchdog = None, None
        self.runtime = RuntimeState.STOPPED
        if any(self.point.velocity_rad_s):
            self._braking = BrakeMove.of_joints(self.point, 4.0)

    def pause_program(self) -> bool:
        """Pause; return whether there was something to pause."""
        if self.runtime is not RuntimeState.PLAYING:
            return False
        self.runtime = RuntimeState.PAUSED
        self.point.move_to(self.point.joints_rad)
        return True

    def resume_program(self) -> bool:
        """Play a paused program on; return whether there was one."""
        if self.program is None or not self.ready_for_programs:
            return False
        self.runtime = RuntimeState.PLAYING
        return True

    def set_watchdog(self, register: str, minimum_hz: float) -> None:
        """Stop the program when a register is not written often enough."""
        self.registers.written_at_s[register] = self.timestamp_s
        self._watchdog = (register, 1.0 / minimum_hz) if minimum_hz > 0.0 else None

    def _look_at_watchdog(self) -> None:
        if self._watchdog is None or self.runtime is not RuntimeState.PLAYING:
            return
        register, patience_s = self._watchdog
        if self.timestamp_s - self.registers.written_at_s.get(register, self.timestamp_s) > patience_s:
            self.watchdog_stops += 1
            self.end_program()

    # safety and power

    def protective_stop(self, unlock_after_s: float = 0.0) -> None:
        """Stop the arm; the program pauses."""
        if self.safety_mode is not SafetyMode.NORMAL:
            return
        self.safety_mode = SafetyMode.PROTECTIVE_STOP
        self._locked_until_s = self.timestamp_s + unlock_after_s
        self._stand_still()
        if self.runtime is RuntimeState.PLAYING:
            self.runtime = RuntimeState.PAUSED

    def unlock_protective_stop(self) -> bool:
        """Leave a protective stop; return False when it is too early or another stop is active."""
        if self.safety_mode is SafetyMode.PROTECTIVE_STOP and self.timestamp_s >= self._locked_until_s:
            self.safety_mode = SafetyMode.NORMAL
        return self.safety_mode is SafetyMode.NORMAL

    def emergency_stop(self) -> None:
        """Push the red button: brakes, power off, program stopped."""
        self.end_program()
        self._stand_still()
        self.safety_mode, self.robot_mode = SafetyMode.ROBOT_EMERGENCY_STOP, RobotMode.POWER_OFF

    def release_emergency_stop(self) -> None:
        """Turn the red button back; power stays off."""
        if self.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP:
            self.safety_mode = SafetyMode.NORMAL

    def switch_power(self, *, on: bool) -> None:
        """Switch the arm's power; after power on the brakes still hold."""
        if not on:
            self.end_program()
            self._stand_still()
            self.robot_mode = RobotMode.POWER_OFF
        elif self.robot_mode is RobotMode.POWER_OFF and self.safety_mode is SafetyMode.NORMAL:
            self.robot_mode = RobotMode.IDLE

    def release_brakes(self) -> None:
        """Make an arm that has power ready to move."""
        self.switch_power(on=True)
        if self.robot_mode is RobotMode.IDLE:
            self.robot_mode = RobotMode.RUNNING

    def _stand_still(self) -> None:
        self._braking = None
        self.point.move_to(self.point.joints_rad)

    # settings

    def set_tcp(self, pose: Vector) -> None:
        """Make another TCP the active one."""
        self.tcp, self.flange_tool = pose, frame_of(pose)
        self.tool_flange = invert_frame(self.flange_tool)

    def inverse_kinematics(self, goal: Frame, near_rad: Vector) -> Vector:
        """Return joints for a flange pose; raise NoSolutionError when there are none within the limits."""
        found = None if self.no_inverse_kinematics else self.kinematics.solve_closest(goal, near_rad)
        if found is None or not self.within_limits(found):
            raise NoSolutionError
        return found

    def within_limits(self, joints_rad: Vector) -> bool:
        """Whether joints are inside their ranges."""
        joints = np.array(joints_rad)
        return bool(np.all(joints >= self.arm.lower_rad) and np.all(joints <= self.arm.upper_rad))

    def apply_inputs(self, values: dict[str, object]) -> None:
        """Let the inputs that are switches take effect: outputs and the speed slider."""
        self.registers.write_inputs(values, self.timestamp_s)
        for name, shift in (("standard_digital", 0), ("configurable_digital", 8), ("tool_digital", 16)):
            if f"{name}_output_mask" in values:
                self._switch_outputs(name, shift)
        inputs = self.registers.inputs
        if inputs["speed_slider_mask"] and "speed_slider_mask" in values:
            self.speed_fraction = min(1.0, max(0.0, inputs["speed_slider_fraction"]))
        if "standard_analog_output_mask" in values:
            for channel in (0, 1):
                if inputs["standard_analog_output_mask"] >> channel & 1:
                    self.analog_outputs[channel] = inputs[f"standard_analog_output_{channel}"]

    def _switch_outputs(self, name: str, shift: int) -> None:
        inputs = self.registers.inputs
        mask = inputs[f"{name}_output_mask"] << shift
        levels = inputs[f"{name}_output"] << shift
        self.digital_outputs = self.digital_outputs & ~mask | levels & mask
