"""What RTDE tells about the controller, variable by variable.

Imitates
    The output variables of the controller.
Source
    The maker's RTDE guide.
Modelled
    Positions, speeds, TCP, states, registers, inputs and outputs.
Not modelled
    Currents, forces, temperatures, voltages and the accelerometer: constants of an arm at rest. Set point and
    actual joints are the same number: no tracking error, no encoder noise.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from cellcal.fake_devices.universal_robots.controller import UrController
from cellcal.fake_devices.universal_robots.frames import Vector, multiply_frames, origin_of, pose_of
from cellcal.fake_devices.universal_robots.rtde_fields import (
    INPUT_TYPES,
    OUTPUT_TYPES,
    is_available,
    zero_value,
)
from cellcal.fake_devices.universal_robots.states import joint_mode, safety_bits, status_bits

_STILL = (0.0,) * 6
_CONSTANTS: dict[str, object] = {
    "actual_main_voltage": 48.0,
    "actual_robot_voltage": 48.0,
    "actual_robot_current": 0.6,
    "actual_joint_voltage": (48.0,) * 6,
    "joint_temperatures": (31.0, 31.5, 32.0, 33.0, 33.5, 34.0),
    "actual_current": (0.0, -1.9, -1.1, -0.1, 0.0, 0.0),
    "target_current": (0.0, -1.9, -1.1, -0.1, 0.0, 0.0),
    "actual_current_window": (1.5,) * 6,
    "actual_tool_accelerometer": (0.0, 0.0, -9.82),
    "speed_scaling": 1.0,
    "actual_execution_time": 0.3,
    "target_execution_time": 0.2,
    "tool_temperature": 30.0,
    "time_scale_source": 0,
}


class OutputVariables:
    """Getters of all output variables."""

    def __init__(self, controller: UrController) -> None:
        self._c = controller
        self._pose_for: tuple[Vector, Vector] | None = None
        self._pose: Vector = _STILL
        self._getters = self._state_getters() | self._tool_getters() | self._io_getters()

    def getter_for(self, name: str) -> Callable[[], Any] | None:
        """Return the function that reads a variable; None when this controller does not have it."""
        if name not in OUTPUT_TYPES or not is_available(name, self._c.identity.version):
            return None
        if name in self._getters:
            return self._getters[name]
        registers = self._c.registers
        if name in INPUT_TYPES:
            return lambda: registers.inputs[name]
        if name in registers.outputs:
            return lambda: registers.outputs[name]
        value = _CONSTANTS.get(name, zero_value(OUTPUT_TYPES[name]))
        return lambda: value

    def tcp_pose(self) -> Vector:
        """Return the active TCP seen from the base."""
        c = self._c
        if self._pose_for != (c.joints_rad, c.tcp):
            self._pose_for = (c.joints_rad, c.tcp)
            self._pose = pose_of(multiply_frames(c.kinematics.base_flange(c.joints_rad), c.flange_tool))
        return self._pose

    def tcp_speed(self) -> Vector:
        """Return the velocity of the active TCP in base axes."""
        c = self._c
        if not any(c.velocity_rad_s):
            return _STILL
        tip = origin_of(multiply_frames(c.kinematics.base_flange(c.joints_rad), c.flange_tool))
        jacobian = c.kinematics.tip_jacobian(c.joints_rad, tip)
        return tuple((jacobian @ np.array(c.velocity_rad_s)).tolist())

    def _state_getters(self) -> dict[str, Callable[[], Any]]:
        c = self._c
        return {
            "timestamp": lambda: c.timestamp_s,
            "control_step": lambda: c.steps,
            "target_q": lambda: c.point.joints_rad,
            "target_qd": lambda: c.velocity_rad_s,
            "actual_q": lambda: c.joints_rad,
            "actual_qd": lambda: c.velocity_rad_s,
            "robot_mode": lambda: int(c.robot_mode),
            "joint_mode": lambda: (joint_mode(c.robot_mode),) * 6,
            "safety_mode": lambda: int(c.safety_mode),
            "safety_status": lambda: int(c.safety_mode),
            "runtime_state": lambda: int(c.runtime),
            "robot_status_bits": lambda: status_bits(c.robot_mode, c.runtime),
            "safety_status_bits": lambda: safety_bits(c.safety_mode),
            "target_speed_fraction": lambda: c.speed_fraction,
        }

    def _tool_getters(self) -> dict[str, Callable[[], Any]]:
        c = self._c
        return {
            "actual_TCP_pose": self.tcp_pose,
            "target_TCP_pose": self.tcp_pose,
            "actual_TCP_speed": self.tcp_speed,
            "target_TCP_speed": self.tcp_speed,
            "tcp_offset": lambda: c.tcp,
            "elbow_position": lambda: c.kinematics.elbow_position(c.joints_rad),
            "payload": lambda: c.payload_kg,
            "payload_cog": lambda: c.cog_m,
            "payload_inertia": lambda: c.inertia,
            "target_gravity": lambda: c.gravity,
        }

    def _io_getters(self) -> dict[str, Callable[[], Any]]:
        c = self._c
        return {
            "actual_digital_output_bits": lambda: c.digital_outputs,
            "actual_configurable_digital_output_bits": lambda: c.digital_outputs >> 8 & 0xFF,
            "standard_analog_output0": lambda: c.analog_outputs[0],
            "standard_analog_output1": lambda: c.analog_outputs[1],
        }
