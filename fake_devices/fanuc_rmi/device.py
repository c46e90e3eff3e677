"""The FANUC robot of a cell behind the Remote Motion Interface: arm, controller and ports, and what can happen.

Imitates
    A FANUC arm on an R-30iB Plus with option R912.
Source
    controller.py and packets.py.
Modelled
    The faults named below and ``fake_devices.fanuc_rmi.server.LINK_FAULTS``.
Not modelled
    Encoders: this link does not reach them.
"""

import asyncio
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from cellcal.fake_devices.device import FaultRefusedError, JsonObject
from cellcal.fake_devices.fanuc_rmi.controller import FRAMES, RmiController
from cellcal.fake_devices.fanuc_rmi.server import LINK_FAULTS, RmiServer
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.kinematics import matrix_from_xyzwpr
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.world import World

_TICK_REAL_S = 0.05


class FakeFanucRmiRobot:
    """One controller on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._name = str(table["name"])
        self.controller = RmiController(world.add_arm(self._name, str(table["model"])))
        self._faults = LinkFaults({kind: {} for kind in LINK_FAULTS}, world.clock.real_now_s)
        port = int(table.get("port", 16001))
        host = str(table.get("address", "127.0.0.1"))
        self.server = RmiServer(host, (port, port + 1), self.controller, self._faults)
        self._ticks: list[asyncio.Task[None]] = []
        c = self.controller
        self._events: dict[str, Callable[[dict[str, Any]], None]] = {
            "emergency_stop": lambda _: c.press_emergency_stop(),
            "release_emergency_stop": lambda _: c.release_emergency_stop(),
            "pendant_on": lambda _: c.enable_pendant(on=True),
            "pendant_off": lambda _: c.enable_pendant(on=False),
            "override": lambda p: c.set_override(int(p.pop("percent", 100))),
            "tool_switched": self._switch_tool,
            "alarm": lambda p: c.raise_alarm(str(p.pop("text", "SRVO-062 BZAL alarm (Group:1 Axis:3)"))),
            "clear_alarms": lambda _: c.clear_alarms(),
            "sequence_restarts": lambda p: self._restart_sequence(bool(p.pop("on", True))),
            "hand_moves": self._move_by_hand,
            "hang_up": lambda _: self.server.hang_up(),
        }

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.server.open()
        self._ticks = [
            keep_running(f"motions of {self.name}", self.server.follow_motions),
            keep_running(f"ports of {self.name}", self._follow_faults),
        ]

    async def stop(self) -> None:
        for tick in self._ticks:
            tick.cancel()
            with suppress(asyncio.CancelledError):
                await tick
        self.server.close()

    async def _follow_faults(self) -> None:
        while True:
            await self._listen_or_not()
            await asyncio.sleep(_TICK_REAL_S)

    async def _listen_or_not(self) -> None:
        if self._faults.active_parameters("refuse") is not None:
            self.server.close()
        else:
            with suppress(OSError):  # the address is not free yet; the next tick tries again
                await self.server.open()

    def fault_names(self) -> frozenset[str]:
        return self._faults.fault_kinds | frozenset(self._events)

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        if name in self._events:
            remaining = dict(parameters)
            try:
                self._events[name](remaining)
            except (TypeError, ValueError) as problem:
                raise FaultRefusedError(str(problem)) from problem
            if remaining:
                raise FaultRefusedError(f"{name} does not know {', '.join(sorted(remaining))}")
            if name in ("emergency_stop", "alarm"):
                await self.server.push_packet({"Communication": "FRC_SystemFault", "SequenceID": 0})
        else:
            self._faults.switch_on(name, parameters)
        await self._listen_or_not()
        return {}

    def clear_faults(self) -> None:
        self._faults.clear_all()

    def true_state(self) -> JsonObject:
        c, arm = self.controller, self.controller.arm
        return {
            "joints_rad": arm.joints_rad.tolist(),
            "controller_joints_rad": arm.joints_rad.tolist(),
            "moving": arm.is_moving,
            "servo_power": c.has_servo_power,
            "pendant_enabled": c.pendant_enabled,
            "motion_runs": c.motion_runs,
            "most_queued": c.most_queued,
            "override_percent": c.override_percent,
            "alarms": list(c.alarm_texts),
            "active": {
                "tool_number": c.tool_number,
                "user_frame_number": c.frame_number,
                "flange_tool": matrix_from_xyzwpr(c.tools[c.tool_number - 1]).tolist(),
                "payload_kg": None,
            },
            "dh": arm.true_dh.tolist(),
            "nominal_dh": arm.nominal_dh.tolist(),
            "base_flange": arm.base_flange().tolist(),
        }

    def _restart_sequence(self, on: bool) -> None:
        self.controller.restarts_sequence = on

    def _move_by_hand(self, parameters: dict[str, Any]) -> None:
        """Drive the arm at the pendant to these joints."""
        joints = [float(angle) for angle in parameters.pop("joints")]
        if len(joints) != len(self.controller.arm.joints_rad) or not all(map(math.isfinite, joints)):
            raise ValueError("joints are as many finite numbers as there are axes [rad]")
        self.controller.arm.put_joints(joints)

    def _switch_tool(self, parameters: dict[str, Any]) -> None:
        c = self.controller
        c.tool_number = int(parameters.pop("number", c.tool_number % FRAMES + 1))


def create_fanuc_rmi_robot(world: World, table: Mapping[str, Any]) -> FakeFanucRmiRobot:
    """Build the robot that a cell file names."""
    return FakeFanucRmiRobot(world, table)
