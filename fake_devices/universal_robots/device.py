"""The Universal Robots arm of a cell: arm and controller put together, and what can happen to them.

Imitates
    A UR robot: e-Series with software 5.11, or CB3 with 3.15 for a UR3, UR5 or UR10, unless the cell file says
    otherwise in [fake.robots.NAME]: ``software``, ``dashboard_model``, ``type_code`` (``identity.py``).
Source
    README of this package.
Modelled
    The faults of ``fake_devices.universal_robots.faults.FAULTS``.
Not modelled
    See the modules of this package.
"""

from collections.abc import Mapping
from typing import Any

from cellcal.fake_devices.device import FaultRefusedError, JsonObject
from cellcal.fake_devices.universal_robots.faults import FAULTS, UrFaults
from cellcal.fake_devices.universal_robots.identity import UrIdentity
from cellcal.fake_devices.universal_robots.robot_api import DEFAULT_PORT
from cellcal.fake_devices.universal_robots.server import UniversalRobotServer
from cellcal.fake_devices.world import World


class FakeUniversalRobot:
    """One robot on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._name = str(table["name"])
        settings: Mapping[str, Any] = table.get("settings", {})
        self._arm = world.add_arm(self._name, str(settings.get("arm") or table.get("model", "ur10e")))
        identity = UrIdentity.of_tables(table, settings)
        address = str(table.get("address", "127.0.0.1"))
        self.server = UniversalRobotServer(
            self._arm,
            address,
            identity,
            world.clock.now_s,
            robot_api_port=int(table.get("robot_api_port", DEFAULT_PORT)),
        )
        self._faults = UrFaults(self.server)

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.server.start()

    async def stop(self) -> None:
        await self.server.close()

    def fault_names(self) -> frozenset[str]:
        return frozenset(FAULTS)

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        try:
            return await self._faults.inject_fault(name, parameters)
        except (TypeError, ValueError) as problem:
            raise FaultRefusedError(str(problem)) from problem

    def clear_faults(self) -> None:
        self._faults.clear_faults()

    def true_state(self) -> JsonObject:
        arm, c = self._arm, self.server.controller
        return {
            "joints_rad": arm.joints_rad.tolist(),
            "controller_joints_rad": arm.controller_joints_rad.tolist(),
            "moving": any(c.velocity_rad_s),
            "dh": arm.true_dh.tolist(),
            "known_dh": arm.known_dh.tolist(),
            "nominal_dh": arm.nominal_dh.tolist(),
            "base_flange": arm.base_flange().tolist(),
            "tcp": list(c.tcp),
            "active": {
                "tool_number": None,
                "user_frame_number": 0,
                "flange_tool": [list(row) for row in c.flange_tool],
                "payload_kg": c.payload_kg,
            },
            "robot_mode": c.robot_mode.name,
            "safety_mode": c.safety_mode.name,
            "runtime": c.runtime.name,
            "program": c.program.name if c.program is not None else None,
            "watchdog_stops": c.watchdog_stops,
            "remote": c.remote,
            "speed_fraction": c.speed_fraction,
            "digital_outputs": c.digital_outputs,
            "connections": {str(n): len(port.connections) for n, port in self.server.ports.items()},
        }


def create_device(world: World, table: Mapping[str, Any]) -> FakeUniversalRobot:
    """Build the robot that a cell file names."""
    return FakeUniversalRobot(world, table)
