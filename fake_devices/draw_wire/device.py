"""The draw-wire of a cell: wire, node and daemon put together, and what can happen to them.

Imitates
    A draw-wire encoder on a CAN bus that a socketcand daemon brings to the network.
Source
    See the modules of this package and ``fake_devices.wire_gauge``.
Modelled
    The happenings of ``DrawWire.fault_names``.
Not modelled
    Other nodes on the bus, except a foreign master's frames (``foreign_master``).
"""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from cellcal.fake_devices.device import FaultRefusedError, JsonObject
from cellcal.fake_devices.draw_wire.modbus_device import ModbusDrawWire
from cellcal.fake_devices.draw_wire.node import KINDS, DrawWireNode
from cellcal.fake_devices.draw_wire.socketcand import SocketCanDaemon
from cellcal.fake_devices.draw_wire.wire_happenings import wire_happenings
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.kinematics import Array
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.wire_gauge import WireGauge
from cellcal.fake_devices.world import World

_DAEMON_KINDS: dict[str, dict[str, Any]] = {"daemon_stop": {}, "daemon_hang": {}}
_LONGEST_NAP_S = 0.1


class DrawWire:
    """One gauge on one bus."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._world = world
        self._name = str(table["name"])
        self.gauge = WireGauge(world, table)
        self._faults = LinkFaults({**KINDS, **_DAEMON_KINDS}, world.clock.real)
        self.daemon = SocketCanDaemon(
            str(table.get("host", "127.0.0.1")),
            int(table.get("port", 29536)),
            str(table.get("channel", "can0")),
            world.clock.real,
        )
        self.node = DrawWireNode(
            self.gauge,
            int(table.get("node_id", 7)),
            int(table.get("serial", 1)),
            self._faults,
            self.daemon.send,
        )
        self.daemon.on_frame = self._frame
        self._wake = asyncio.Event()
        self._timer: asyncio.Task[None] | None = None
        self._happen: dict[str, Callable[[dict[str, Any]], None]] = {
            **wire_happenings(self.gauge),
            "node_off": lambda _given: self.node.switch_off(),
            "node_on": lambda _given: self.node.switch_on(world.clock.real()),
            "emcy": self._emcy,
            "emcy_clear": lambda _given: self.node.clear_emergency(),
            "error_frame": lambda _given: self.daemon.send_error_frame(),
            "foreign_master": self._foreign_master,
        }

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.daemon.open()
        self._timer = keep_running(f"time of {self.name}", self._keep_time)

    async def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            with suppress(asyncio.CancelledError):
                await self._timer
        await self.daemon.wait_closed()

    def _frame(self, can_id: int, data: bytes) -> None:
        self.node.receive(can_id, data, self._world.clock.real())
        self._wake.set()

    async def _keep_time(self) -> None:
        while True:
            now_s = self._world.clock.real()
            due_s = self.node.poll(now_s)
            await self._live_or_die()
            self._wake.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(min(max(due_s - now_s, 0.0), _LONGEST_NAP_S)):
                    await self._wake.wait()

    async def _live_or_die(self) -> None:
        self.daemon.hung = self._faults.look("daemon_hang") is not None
        if self._faults.look("daemon_stop") is not None:
            self.daemon.close()
        else:
            with suppress(OSError):  # the address is not free yet; the next look tries again
                await self.daemon.open()

    # faults

    def fault_names(self) -> frozenset[str]:
        return self._faults.kinds | frozenset(self._happen)

    async def fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        if name in self._happen:
            given = dict(parameters)
            self._happen[name](given)
            if given:
                raise FaultRefusedError(f"{name} does not know {', '.join(sorted(given))}")
        else:
            self._faults.set(name, parameters)
            await self._live_or_die()
        return {}

    def clear(self) -> None:
        self._faults.clear()
        self._wake.set()

    def _emcy(self, given: dict[str, Any]) -> None:
        self.node.raise_emergency(int(given.pop("code", 0x5200)), int(given.pop("length", 8)))

    def _foreign_master(self, _given: dict[str, Any]) -> None:
        """Another client on the bus reads our node: its request and the node's answer are seen by all."""
        request = bytes([0x40, 0x04, 0x60, 0, 0, 0, 0, 0])
        self.daemon.send(0x600 + self.node.node_id, request)
        self._frame(0x600 + self.node.node_id, request)

    # truth

    def truth(self) -> JsonObject:
        gauge = self.gauge
        return {
            "robot": gauge.robot,
            "anchor_in_base_m": gauge.anchor_in_base_m.tolist(),
            "hook_in_flange_m": gauge.hook_in_flange_m.tolist(),
            "hook_in_base_m": gauge.hook_in_base_m().tolist(),
            "length_m": gauge.true_length_m(),
            "reading_m": gauge.exact_reading_m(),
            "fixture_in_base": _rows(gauge.fixture_in_base()),
            "tool_in_flange": _rows(gauge.tool_in_flange()),
            "zero_m": gauge.zero_m,
            "scale_error": gauge.scale_error,
            "exit_radius_m": gauge.exit_radius_m,
            "snapped": gauge.snapped,
            "slipped_m": gauge.slipped_m,
            "state": self.node.state,
            "powered": self.node.powered,
            "error_register": self.node.error_register,
            "connections": self.daemon.connections,
            "port": self.daemon.port,
        }


def _rows(pose: Array | None) -> list[list[float]] | None:
    return None if pose is None else [[float(value) for value in row] for row in pose]


def create(world: World, table: Mapping[str, Any]) -> DrawWire | ModbusDrawWire:
    """Build the gauge that a cell file names, on the bus that it names."""
    if table.get("interface") == "modbus":
        return ModbusDrawWire(world, table)
    return DrawWire(world, table)
