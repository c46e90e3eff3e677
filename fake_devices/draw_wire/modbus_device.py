"""The Modbus draw-wire of a cell: wire, encoder and server put together, and what can happen to them.

Imitates
    A draw-wire encoder on Ethernet.
Source
    See ``fake_devices.draw_wire.modbus_encoder`` and ``fake_devices.wire_gauge``.
Modelled
    The happenings of the wire, the faults of the encoder and those of the link.
Not modelled
    See the modules named above.
"""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from cellcal.fake_devices.device import JsonObject, run_fault_action
from cellcal.fake_devices.draw_wire.modbus_encoder import KINDS, ModbusEncoder
from cellcal.fake_devices.draw_wire.wire_faults import wire_faults
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.modbus_robot.server import ModbusServer, link_faults
from cellcal.fake_devices.modbus_tables import answer_request
from cellcal.fake_devices.wire_gauge import WireGauge
from cellcal.fake_devices.world import World

_LOOK_S = 0.05


class FakeModbusDrawWire:
    """One gauge behind one address."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._world, self._name = world, str(table["name"])
        self.gauge = WireGauge(world, table)
        self._faults = link_faults(world.clock.real_now_s, KINDS)
        step_m = float(table.get("step_um", 38.452)) * 1e-6
        self.encoder = ModbusEncoder(self.gauge, int(table["serial"]), step_m, self._faults.active_parameters)
        self.server = ModbusServer(
            str(table.get("host", "127.0.0.1")),
            int(table.get("port", 502)),
            lambda request: answer_request(self.encoder, request),
            self._faults,
        )
        self._follower: asyncio.Task[None] | None = None
        self._fault_actions = {**wire_faults(self.gauge), "preset": self._set_preset}

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.server.open()
        self._follower = keep_running(f"time of {self.name}", self._follow_time)

    async def stop(self) -> None:
        if self._follower is not None:
            self._follower.cancel()
            with suppress(asyncio.CancelledError):
                await self._follower
        await self.server.wait_closed()

    async def _follow_time(self) -> None:
        while True:
            await self._listen_or_not()
            await asyncio.sleep(_LOOK_S)

    async def _listen_or_not(self) -> None:
        flap = self._faults.active_parameters("flap")
        gone = flap is not None and self._world.clock.real_now_s() % (2 * flap["period_s"]) > flap["period_s"]
        if gone or self._faults.active_parameters("refuse") is not None:
            self.server.close()
        else:
            with suppress(OSError):  # the address is not free yet; the next look tries again
                await self.server.open()

    def fault_names(self) -> frozenset[str]:
        return self._faults.fault_kinds | frozenset(self._fault_actions)

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        if name in self._fault_actions:
            run_fault_action(self._fault_actions[name], name, parameters)
        else:
            self._faults.switch_on(name, parameters)
            await self._listen_or_not()
        return {}

    def clear_faults(self) -> None:
        self._faults.clear_all()

    def _set_preset(self, parameters: dict[str, Any]) -> None:
        """Set a preset: the shown position moves by the offset."""
        self.encoder.offset_steps += round(float(parameters.pop("m", 0.01)) / self.encoder.step_m)

    def true_state(self) -> JsonObject:
        gauge = self.gauge
        return {
            "robot": gauge.robot,
            "anchor_in_base_m": gauge.anchor_in_base_m.tolist(),
            "hook_in_flange_m": gauge.hook_in_flange_m.tolist(),
            "length_m": gauge.true_length_m(),
            "reading_m": gauge.exact_reading_m() + self.encoder.offset_steps * self.encoder.step_m,
            "snapped": gauge.snapped,
            "port": self.server.port,
        }
