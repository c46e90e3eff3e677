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

from cellcal.fake_devices.device import JsonObject, run_fault_action
from cellcal.fake_devices.draw_wire.modbus_device import FakeModbusDrawWire
from cellcal.fake_devices.draw_wire.node import KINDS, DrawWireNode
from cellcal.fake_devices.draw_wire.socketcand import SocketCanDaemon
from cellcal.fake_devices.draw_wire.wire_faults import wire_faults
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.kinematics import Array
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.wire_gauge import WireGauge
from cellcal.fake_devices.world import World

_DAEMON_KINDS: dict[str, dict[str, Any]] = {"daemon_stop": {}, "daemon_hang": {}}
_LONGEST_NAP_S = 0.1


class FakeDrawWire:
    """One gauge on one bus."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._world = world
        self._name = str(table["name"])
        self.gauge = WireGauge(world, table)
        self._faults = LinkFaults({**KINDS, **_DAEMON_KINDS}, world.clock.real_now_s)
        self.daemon = SocketCanDaemon(
            str(table.get("host", "127.0.0.1")),
            int(table.get("port", 29536)),
            str(table.get("channel", "can0")),
            world.clock.real_now_s,
        )
        self.node = DrawWireNode(
            self.gauge,
            int(table.get("node_id", 7)),
            int(table.get("serial", 1)),
            self._faults,
            self.daemon.send_frame,
        )
        self.daemon.on_frame = self._receive_frame
        self._emergencies: set[int] = set()  # raised as a fault
        self._wake = asyncio.Event()
        self._timer: asyncio.Task[None] | None = None
        self._fault_actions: dict[str, Callable[[dict[str, Any]], None]] = {
            **wire_faults(self.gauge),
            "node_off": lambda _parameters: self.node.switch_off(),
            "node_on": lambda _parameters: self.node.switch_on(world.clock.real_now_s()),
            "emcy": self._raise_emergency,
            "emcy_clear": lambda _parameters: self.node.clear_emergency(),
            "error_frame": lambda _parameters: self.daemon.send_error_frame(),
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

    def _receive_frame(self, can_id: int, data: bytes) -> None:
        self.node.receive_frame(can_id, data, self._world.clock.real_now_s())
        self._wake.set()

    async def _keep_time(self) -> None:
        while True:
            now_s = self._world.clock.real_now_s()
            due_s = self.node.poll(now_s)
            await self._live_or_die()
            self._wake.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(min(max(due_s - now_s, 0.0), _LONGEST_NAP_S)):
                    await self._wake.wait()

    async def _live_or_die(self) -> None:
        self.daemon.hung = self._faults.active_parameters("daemon_hang") is not None
        if self._faults.active_parameters("daemon_stop") is not None:
            self.daemon.close()
        else:
            with suppress(OSError):  # the address is not free yet; the next look tries again
                await self.daemon.open()

    # faults

    def fault_names(self) -> frozenset[str]:
        return self._faults.fault_kinds | frozenset(self._fault_actions)

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        if name in self._fault_actions:
            run_fault_action(self._fault_actions[name], name, parameters)
        else:
            self._faults.switch_on(name, parameters)
            await self._live_or_die()
        return {}

    def clear_faults(self) -> None:
        self._faults.clear_all()
        while self._emergencies:
            self.node.clear_emergency(self._emergencies.pop())
        self._wake.set()

    def _raise_emergency(self, parameters: dict[str, Any]) -> None:
        code = int(parameters.pop("code", 0x5200))
        self._emergencies.add(code)
        self.node.raise_emergency(code, int(parameters.pop("length", 8)))

    def _foreign_master(self, _parameters: dict[str, Any]) -> None:
        """Another client on the bus reads our node: its request and the node's answer are seen by all."""
        request = bytes([0x40, 0x04, 0x60, 0, 0, 0, 0, 0])
        self.daemon.send_frame(0x600 + self.node.node_id, request)
        self._receive_frame(0x600 + self.node.node_id, request)

    # truth

    def true_state(self) -> JsonObject:
        gauge = self.gauge
        return {
            "robot": gauge.robot,
            "anchor_in_base_m": gauge.anchor_in_base_m.tolist(),
            "hook_in_flange_m": gauge.hook_in_flange_m.tolist(),
            "hook_in_base_m": gauge.hook_in_base_m().tolist(),
            "length_m": gauge.true_length_m(),
            "reading_m": gauge.exact_reading_m(),
            "fixture_in_base": _matrix_rows(gauge.fixture_in_base()),
            "tool_in_flange": _matrix_rows(gauge.tool_in_flange()),
            "zero_m": gauge.zero_m,
            "scale_error": gauge.scale_error,
            "exit_radius_m": gauge.exit_radius_m,
            "snapped": gauge.snapped,
            "slipped_m": gauge.slipped_m,
            "state": self.node.state,
            "powered": self.node.powered,
            "error_register": self.node.error_register,
            "connections": self.daemon.client_count,
            "port": self.daemon.port,
        }


def _matrix_rows(pose: Array | None) -> list[list[float]] | None:
    return None if pose is None else [[float(value) for value in row] for row in pose]


def create_device(world: World, table: Mapping[str, Any]) -> FakeDrawWire | FakeModbusDrawWire:
    """Build the gauge that a cell file names, on the bus that it names."""
    if table.get("interface") == "modbus":
        return FakeModbusDrawWire(world, table)
    return FakeDrawWire(world, table)
