"""The ABB robot of a cell: arm, controller and web server put together, and what can happen to them.

Imitates
    An ABB arm on an IRC5 with RobotWare 6.
Source
    controller.py and server.py.
Modelled
    The faults named below and ``fake_devices.abb.server.LINK_FAULTS``.
Not modelled
    Encoders: this link does not reach them.
"""

import asyncio
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from cellcal.fake_devices.abb.controller import AbbController
from cellcal.fake_devices.abb.resources import ResourceTable
from cellcal.fake_devices.abb.server import LINK_FAULTS, ServicePort
from cellcal.fake_devices.device import FaultRefusedError, JsonObject
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.world import World

_CYCLE_REAL_S = 0.004
_TICK_REAL_S = 0.05


class FakeAbbRobot:
    """One controller on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._name = str(table["name"])
        arm = world.add_arm(self._name, str(table["model"]))
        self.controller = AbbController(arm, str(table.get("serial", "0")), world.clock.real_now_s)
        self.controller.heartbeat_s *= world.watchdog_factor
        self._faults = LinkFaults({kind: {} for kind in LINK_FAULTS}, world.clock.real_now_s)
        host, port = str(table.get("address", "127.0.0.1")), int(table.get("port", 80))
        self.server = ServicePort(host, port, ResourceTable(self.controller), self._faults)
        self._ticks: list[asyncio.Task[None]] = []
        c = self.controller
        self._events: dict[str, Callable[[dict[str, Any]], None]] = {
            "emergency_stop": lambda _: c.press_emergency_stop(),
            "manual_mode": lambda _: c.turn_mode_switch("MANR"),
            "program_stop": lambda _: self._stop_program(),
            "override": lambda p: c.set_speed(int(p.pop("percent", 100))),
            "tool_switched": self._switch_tool,
            "counters_lost": lambda p: c.lose_counters(_parse_axes(p.pop("axes", "all"))),
            "hand_moves": self._move_by_hand,
            "mend": lambda _: c.mend(),
        }

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.server.open()
        self._ticks = [
            keep_running(f"programs of {self.name}", self._follow_programs),
            keep_running(f"port of {self.name}", self._follow_faults),
        ]

    async def stop(self) -> None:
        for tick in self._ticks:
            tick.cancel()
            with suppress(asyncio.CancelledError):
                await tick
        self.server.close()

    async def _follow_programs(self) -> None:
        while True:
            self.controller.run_program()
            await asyncio.sleep(_CYCLE_REAL_S)

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
            "mode": c.mode,
            "motors": c.motors,
            "state": c.state,
            "axis_states": list(c.axis_states),
            "active": {
                "tool_number": None,
                "user_frame_number": 0,
                "flange_tool": c.tool_matrix().tolist(),
                "payload_kg": c.payload_kg(),
            },
            "dh": arm.true_dh.tolist(),
            "nominal_dh": arm.nominal_dh.tolist(),
            "base_flange": arm.base_flange().tolist(),
        }

    def _stop_program(self) -> None:
        self.controller.program_runs = False
        self.controller.arm.stop(8.0)

    def _move_by_hand(self, parameters: dict[str, Any]) -> None:
        """Drive the arm at the pendant to these joints."""
        joints = [float(angle) for angle in parameters.pop("joints")]
        if len(joints) != len(self.controller.arm.joints_rad) or not all(map(math.isfinite, joints)):
            raise ValueError("joints are as many finite numbers as there are axes [rad]")
        self.controller.arm.put_joints(joints)

    def _switch_tool(self, parameters: dict[str, Any]) -> None:
        c = self.controller
        names = c.tool_names()
        following = names[(names.index(c.tool_name) + 1) % len(names)]
        c.tool_name = str(parameters.pop("tool", following))


def _parse_axes(names: Any) -> list[int]:
    every = [str(axis) for axis in range(1, 7)]
    if names == "all":
        return list(range(6))
    found = [names] if isinstance(names, str) else list(names)
    if not found or any(name not in every for name in found):
        raise FaultRefusedError(f"{names!r} are no axes; they are {', '.join(every)}")
    return sorted(every.index(name) for name in found)


def create_abb_robot(world: World, table: Mapping[str, Any]) -> FakeAbbRobot:
    """Build the robot that a cell file names."""
    return FakeAbbRobot(world, table)
