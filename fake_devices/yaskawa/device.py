"""The Yaskawa robot of a cell: arm, controller and ports put together, and what can happen to them.

Imitates
    A Motoman arm on a YRC1000 whose High Speed Ethernet Server is switched on.
Source
    drivers' README of the brand for the facts; packets.py for the wire.
Modelled
    The faults named in ``_EVENTS`` and ``fake_devices.yaskawa.server.LINK_FAULTS``.
Not modelled
    See the modules of this package.
"""

import asyncio
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from cellcal.fake_devices.device import FaultRefusedError, JsonObject
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.kinematics import matrix_from_xyzwpr
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.world import World
from cellcal.fake_devices.yaskawa.commands import CommandTable
from cellcal.fake_devices.yaskawa.controller import AXES, PLAY, REMOTE, TEACH, YaskawaController
from cellcal.fake_devices.yaskawa.server import LINK_FAULTS, HsesServer

_TICK_REAL_S = 0.05


class FakeYaskawaRobot:
    """One controller on one loopback address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._name = str(table["name"])
        arm = world.add_arm(self._name, str(table["model"]))
        title = str(table.get("controller_type", "unknown"))
        self.controller = YaskawaController(
            arm, table["pulses_per_degree"], world.make_rng(self._name, "encoders"), title
        )
        self._faults = LinkFaults({kind: {} for kind in LINK_FAULTS}, world.clock.real_now_s)
        ports = (int(table.get("port", 10040)), int(table.get("file_port", 10041)))
        host = str(table.get("address", "127.0.0.1"))
        self.server = HsesServer(host, ports, CommandTable(self.controller), self._faults)
        self._tick: asyncio.Task[None] | None = None
        c = self.controller
        self._events: dict[str, Callable[[dict[str, Any]], None]] = {
            "emergency_stop": lambda _: c.press_emergency_stop(),
            "release_emergency_stop": lambda _: c.release_emergency_stop(),
            "teach_mode": lambda _: c.turn_mode_switch(TEACH),
            "play_mode": lambda _: c.turn_mode_switch(PLAY),
            "remote_mode": lambda _: c.turn_mode_switch(REMOTE),
            "pendant_hold": lambda _: c.hold_by_hand("pendant", on=True),
            "release_hold": lambda _: c.hold_by_hand("pendant", on=False),
            "override": lambda p: c.set_override(int(p.pop("percent", 100))),
            "tool_switched": self._switch_tool,
            "alarm": lambda p: c.raise_alarm(
                int(p.pop("code", 4320)), str(p.pop("text", "OVERLOAD(CONTINUE)"))
            ),
            "reset_alarm": lambda _: self._reset_by_hand(),
            "battery_loss": lambda p: c.lose_positions(_parse_axes(p.pop("axes", "all"))),
            "confirm_positions": lambda _: c.confirm_positions(),
            "hand_moves": self._move_by_hand,
            "jog_by_hand": self._jog_by_hand,
        }

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.server.open()
        self._tick = keep_running(f"time of {self.name}", self._follow_faults)

    async def stop(self) -> None:
        if self._tick is not None:
            self._tick.cancel()
            with suppress(asyncio.CancelledError):
                await self._tick
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
            "controller_joints_rad": arm.controller_joints_rad.tolist(),
            "pulses": list(c.pulses()),
            "shift_pulses": c.shift_pulses.tolist(),
            "moving": arm.is_moving,
            "mode": c.mode,
            "servo_power": c.has_servo_power,
            "holds": dict(c.holds),
            "alarms": [{"code": code, "text": text} for code, _, _, text in c.alarms],
            "active": {
                "tool_number": c.tool_number,
                "user_frame_number": c.user_frame,
                "flange_tool": matrix_from_xyzwpr(c.tools[c.tool_number]).tolist(),
                "payload_kg": c.masses_kg[c.tool_number],
            },
            "dh": arm.true_dh.tolist(),
            "nominal_dh": arm.nominal_dh.tolist(),
            "base_flange": arm.base_flange().tolist(),
        }

    def _move_by_hand(self, parameters: dict[str, Any]) -> None:
        """Drive the arm at the pendant to these joints."""
        joints = [float(angle) for angle in parameters.pop("joints")]
        if len(joints) != len(self.controller.arm.joints_rad) or not all(map(math.isfinite, joints)):
            raise ValueError("joints are as many finite numbers as there are axes [rad]")
        self.controller.arm.put_joints(joints)

    def _switch_tool(self, parameters: dict[str, Any]) -> None:
        c = self.controller
        c.tool_number = int(parameters.pop("number", (c.tool_number + 1) % len(c.tools)))

    def _reset_by_hand(self) -> None:
        self.controller.reset_alarms()
        self.controller.has_servo_power = not (self.controller.alarms or self.controller.emergency_stop)

    def _jog_by_hand(self, parameters: dict[str, Any]) -> None:
        arm = self.controller.arm
        target = arm.joints_rad
        target[_parse_axes(parameters.pop("axis", "S"))[0]] += float(parameters.pop("rad", 0.01))
        arm.start_move(target, 0.5, 2.0)


def _parse_axes(names: Any) -> list[int]:
    if names == "all":
        return list(range(len(AXES)))
    found = [names] if isinstance(names, str) else list(names)
    if not found or any(name not in AXES for name in found):
        raise FaultRefusedError(f"{names!r} are no axes; they are {', '.join(AXES)}")
    return sorted(AXES.index(name) for name in found)


def create_yaskawa_robot(world: World, table: Mapping[str, Any]) -> FakeYaskawaRobot:
    """Build the robot that a cell file names."""
    return FakeYaskawaRobot(world, table)
