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
from collections.abc import Mapping
from typing import Any

from cellcal.fake_devices.device import JsonObject
from cellcal.fake_devices.fanuc_rmi.controller import FRAMES, RmiController
from cellcal.fake_devices.fanuc_rmi.server import LINK_FAULTS, RmiServer
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.kinematics import matrix_from_xyzwpr
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.networked_robot import NetworkedRobot
from cellcal.fake_devices.world import World


class FakeFanucRmiRobot(NetworkedRobot):
    """One controller on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        name = str(table["name"])
        arm = world.add_arm(name, str(table["model"]))
        self.controller = RmiController(arm)
        faults = LinkFaults({kind: {} for kind in LINK_FAULTS}, world.clock.real_now_s)
        port = int(table.get("port", 16001))
        host = str(table.get("address", "127.0.0.1"))
        self.server = RmiServer(host, (port, port + 1), self.controller, faults)
        super().__init__(name, arm, self.server, faults)
        c = self.controller
        self._events |= {
            "emergency_stop": lambda _: c.press_emergency_stop(),
            "release_emergency_stop": lambda _: c.release_emergency_stop(),
            "pendant_on": lambda _: c.enable_pendant(on=True),
            "pendant_off": lambda _: c.enable_pendant(on=False),
            "override": lambda p: c.set_override(int(p.pop("percent", 100))),
            "tool_switched": self._switch_tool,
            "alarm": lambda p: c.raise_alarm(str(p.pop("text", "SRVO-062 BZAL alarm (Group:1 Axis:3)"))),
            "clear_alarms": lambda _: c.clear_alarms(),
            "sequence_restarts": lambda p: self._restart_sequence(bool(p.pop("on", True))),
            "external_moved": self._move_external_axis,
            "hang_up": lambda _: self.server.drop_connection(),
        }

    def _begin_tasks(self) -> list[asyncio.Task[None]]:
        return [keep_running(f"motions of {self.name}", self.server.follow_motions)]

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        answer = await super().inject_fault(name, parameters)
        if name in ("emergency_stop", "alarm"):
            await self.server.push_packet({"Communication": "FRC_SystemFault", "SequenceID": 0})
        return answer

    def true_state(self) -> JsonObject:
        c = self.controller
        return {
            **self._true_arm(),
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
        }

    def _restart_sequence(self, on: bool) -> None:
        self.controller.restarts_sequence = on

    def _move_external_axis(self, parameters: dict[str, Any]) -> None:
        """Drive an axis beside the arm, as a person may: E1 to E3 of group 1, or one of a second group."""
        group, axis = int(parameters.pop("group", 1)), int(parameters.pop("axis", 1))
        value, c = float(parameters.pop("value")), self.controller
        if group != 1 and c.second_group is None:
            c.second_group = [0.0, 0.0]
        places = c.external if group == 1 or c.second_group is None else c.second_group
        if not 1 <= axis <= len(places):
            raise ValueError(f"the axes of group {group} are 1 to {len(places)}")
        places[axis - 1] = value

    def _switch_tool(self, parameters: dict[str, Any]) -> None:
        c = self.controller
        c.tool_number = int(parameters.pop("number", c.tool_number % FRAMES + 1))


def create_device(world: World, table: Mapping[str, Any]) -> FakeFanucRmiRobot:
    """Build the robot that a cell file names."""
    return FakeFanucRmiRobot(world, table)
