"""Ports 30001 and 30002: the state of the robot ten times a second, with its factory calibration.

Imitates
    The primary and secondary interface of software 5.8 to 5.22.
Source
    The maker's client interface page; layout and lengths of a packet captured from URSim 5.8.
Modelled
    The version message on connecting; robot state packages with all thirteen sub-packages of a captured one,
    of which robot mode, joints, Cartesian, kinematics, configuration, masterboard, tool and force are filled.
Not modelled
    Calibration, safety and tool communication sub-packages: right length, zeros. Popups and log messages.
"""

import struct

from cellcal.fake_devices.universal_robots.controller import UrController
from cellcal.fake_devices.universal_robots.ports import TcpPort
from cellcal.fake_devices.universal_robots.readings import OutputVariables
from cellcal.fake_devices.universal_robots.script_port import ProgramLoader, ScriptConnection
from cellcal.fake_devices.universal_robots.states import RuntimeState, SafetyMode, joint_mode

_ROBOT_STATE, _ROBOT_MESSAGE = 16, 20
_ZERO_SUB_PACKAGES = {9: 53, 8: 9, 10: 43, 11: 26, 12: 8}
_EMERGENCY = (SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.SYSTEM_EMERGENCY_STOP)


def _make_package(kind: int, body: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(body), kind) + body


class RobotState:
    """Builds packages for all primary and secondary clients."""

    def __init__(self, controller: UrController, readings: OutputVariables) -> None:
        self._c, self._readings = controller, readings
        self._fixed = b"".join(
            _make_package(kind, bytes(size - 5)) for kind, size in _ZERO_SUB_PACKAGES.items()
        )
        self._described = self._kinematics_package() + self._configuration_package()

    def state_package(self) -> bytes:
        """Return the robot state of this moment."""
        parts = (
            self._mode_package(),
            self._joints_package(),
            self._cartesian_package(),
            self._described,
            self._masterboard_package(),
            _make_package(2, struct.pack(">bbddfBffB", 0, 0, 0.0, 0.0, 0.0, 0, 0.0, 30.0, 255)),
            _make_package(7, struct.pack(">7d", *[0.0] * 7)),
            self._fixed,
        )
        return _make_package(_ROBOT_STATE, b"".join(parts))

    def version_message(self) -> bytes:
        """Return what the controller says to a new client first."""
        version, name = self._c.identity.version, b"URControl"
        body = struct.pack(">QbbB", self._time_us(), -2, 3, len(name)) + name
        body += struct.pack(">BBii", version[0], version[1], version[2], version[3])
        return _make_package(_ROBOT_MESSAGE, body + self._c.identity.released.encode())

    def _time_us(self) -> int:
        return int(self._c.timestamp_s * 1e6)

    def _mode_package(self) -> bytes:
        c = self._c
        powered = c.robot_mode >= 4
        flags = (
            True,
            True,
            powered,
            c.safety_mode in _EMERGENCY,
            c.safety_mode is SafetyMode.PROTECTIVE_STOP,
            c.runtime is RuntimeState.PLAYING,
            c.runtime is RuntimeState.PAUSED,
        )
        body = struct.pack(">Q7?bB", self._time_us(), *flags, int(c.robot_mode), 0)
        return _make_package(0, body + struct.pack(">dddB", c.speed_fraction, 1.0, 1.0, 0))

    def _joints_package(self) -> bytes:
        c, mode = self._c, joint_mode(self._c.robot_mode)
        body = b"".join(
            struct.pack(
                ">dddffffB",
                c.joints_rad[i],
                c.point.joints_rad[i],
                c.velocity_rad_s[i],
                0.0,
                48.0,
                31.0,
                0.0,
                mode,
            )
            for i in range(6)
        )
        return _make_package(1, body)

    def _cartesian_package(self) -> bytes:
        return _make_package(4, struct.pack(">12d", *self._readings.tcp_pose(), *self._c.tcp))

    def _kinematics_package(self) -> bytes:
        k = self._c.kinematics.calibration
        numbers = struct.pack(">24d", *k.theta_rad, *k.a_m, *k.d_m, *k.alpha_rad)
        return _make_package(5, struct.pack(">6I", *k.checksum) + numbers + struct.pack(">I", k.status))

    def _configuration_package(self) -> bytes:
        c, identity = self._c, self._c.identity
        arm, dh = c.arm, c.kinematics.nominal
        limits = [value for pair in zip(arm.lower_rad, arm.upper_rad, strict=True) for value in pair]
        speeds = [value for speed in arm.max_speed_rad_s for value in (float(speed), 40.0)]
        columns = [float(value) for k in (2, 1, 3, 0) for value in dh[:, k]]  # a, d, alpha, theta
        body = struct.pack(">53d", *limits, *speeds, 1.05, 1.4, 0.25, 1.2, 0.5, *columns)
        generation = 2 if identity.model.endswith("e") else 1
        return _make_package(6, body + struct.pack(">4i", 0, 0, identity.robot_type, generation))

    def _masterboard_package(self) -> bytes:
        c = self._c
        body = struct.pack(">ii", 0, c.digital_outputs)
        body += struct.pack(">bbdd", 0, 0, 0.0, 0.0)
        body += struct.pack(">bbdd", 0, 0, *c.analog_outputs)
        body += struct.pack(">ffffBBb", 35.0, 48.0, 0.6, 0.1, int(c.safety_mode), 0, 0)
        return _make_package(3, body.ljust(70, b"\0"))


class PrimaryConnection(ScriptConnection):
    """A primary or secondary client: listens, and may upload programs."""

    def __init__(self, port: TcpPort, loader: ProgramLoader, state: RobotState) -> None:
        super().__init__(port, loader)
        self._state = state

    def send_greeting(self) -> None:
        self.send(self._state.version_message())
        self.send(self._state.state_package())
