"""A device on the inputs of a rail: what a touch probe and a dial gauge have in common.

Imitates
    A sensor wired to a coupler that answers Modbus TCP.
Source
    See the modules of this package; deploy/controller_setup/touch_probe.md.
Modelled
    Faults of the sensor beside those of its coupler. Tables that name one address and port share one coupler.
Not modelled
    See the modules of this package.
"""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from cellcal.fake_devices.device import JsonObject
from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.touch_probe.coupler import FakeCoupler
from cellcal.fake_devices.world import World

_PORT_REAL_S = 0.05


class IoDevice:
    """The parts that probe and dial have in common: a place on a rail."""

    def __init__(self, world: World, table: Mapping[str, Any], kinds: Mapping[str, dict[str, Any]]) -> None:
        self._name, self.world = str(table["name"]), world
        self.coupler = _coupler_for(world, table)
        if "echo_output" in table:
            self.coupler.loops[int(table["echo_output"])] = int(table["echo_input"])
        self.faults = LinkFaults(kinds, world.clock.real_now_s)
        self._follower: asyncio.Task[None] | None = None

    @property
    def name(self) -> str:
        """Name in the cell file."""
        return self._name

    async def start(self) -> None:
        await self.coupler.server.open()
        self._follower = keep_running(f"time of {self.name}", self._follow_world)

    async def stop(self) -> None:
        if self._follower is not None:
            self._follower.cancel()
            with suppress(asyncio.CancelledError):
                await self._follower
        await self.coupler.server.wait_closed()

    def fault_names(self) -> frozenset[str]:
        return self.faults.fault_kinds | self.coupler.faults.fault_kinds

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        faults = self.faults if name in self.faults.fault_kinds else self.coupler.faults
        faults.switch_on(name, parameters)
        self.update_state()
        self.coupler.run_cycle()
        await self._listen_or_not()
        return {}

    def clear_faults(self) -> None:
        self.faults.clear_all()
        self.coupler.faults.clear_all()

    def update_state(self) -> float:
        """Follow the world; return how long it may be left alone [s]."""
        return _PORT_REAL_S

    async def _follow_world(self) -> None:
        port_s = 0.0
        while True:
            pause_s = self.update_state()
            if self.world.clock.real_now_s() >= port_s:
                await self._listen_or_not()
                port_s = self.world.clock.real_now_s() + _PORT_REAL_S
            await asyncio.sleep(pause_s)

    async def _listen_or_not(self) -> None:
        server, flap = self.coupler.server, self.coupler.faults.active_parameters("flap")
        gone = flap is not None and self.world.clock.real_now_s() % (2 * flap["period_s"]) > flap["period_s"]
        if gone or self.coupler.faults.active_parameters("refuse") is not None:
            server.close()
        else:
            with suppress(OSError):  # the address is not free yet; the next look tries again
                await server.open()


def _coupler_for(world: World, table: Mapping[str, Any]) -> FakeCoupler:
    """Return the coupler that stands at the table's address: one for all who name it."""
    host, port = str(table.get("address", "127.0.0.1")), int(table.get("port", 502))
    found = world.shared.get((host, port)) if port else None
    if not isinstance(found, FakeCoupler):
        found = FakeCoupler(host, port, str(table["serial"]), world.clock.real_now_s)
        world.shared[host, port] = found
    return found
