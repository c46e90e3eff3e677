"""The touch probe and the dial gauge of a cell, wired to a coupler, and what can happen to them.

Imitates
    A probe on a digital input and a dial gauge on an analogue input of one rail, or of two.
Source
    See the modules of this package; deploy/controller_setup/touch_probe.md.
Modelled
    The faults of ``_PROBE_KINDS`` and ``_DIAL_KINDS``, and those of the coupler and its link. Tables that name
    one address and port share one coupler.
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
from cellcal.fake_devices.touch_probe.tip import ContactProbe, DialPlunger
from cellcal.fake_devices.world import World

_TICK_REAL_S, _REST_REAL_S, _PORT_REAL_S = 0.008, 0.04, 0.05
_PROBE_KINDS: dict[str, dict[str, Any]] = {
    "stuck_closed": {},
    "stuck_open": {},  # it never touches
    "delay": {"s": 0.05},  # more delay than the data sheet says
    "bounce": {"s": 0.02, "half_s": 0.0013},  # how long the contact springs after it closed
    "press": {},  # a finger presses the tip
    "contact_lost": {"after_s": 0.05},  # closes, then opens again although it still touches
}
_DIAL_KINDS: dict[str, dict[str, Any]] = {
    "wire_break": {},
    "overrange": {},
    "push_in": {"m": 0.004},  # a finger pushes the plunger in
    "wire_offset": {"m": 0.005},  # the dial was turned
}


class IoDevice:
    """The parts that probe and dial have in common: a place on a rail."""

    def __init__(self, world: World, table: Mapping[str, Any], kinds: Mapping[str, dict[str, Any]]) -> None:
        self._name, self._world = str(table["name"]), world
        self.coupler = _coupler_for(world, table)
        self._faults = LinkFaults(kinds, world.clock.real_now_s)
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
        return self._faults.fault_kinds | self.coupler.faults.fault_kinds

    async def inject_fault(self, name: str, parameters: Mapping[str, Any]) -> JsonObject:
        faults = self._faults if name in self._faults.fault_kinds else self.coupler.faults
        faults.switch_on(name, parameters)
        self._update_state()
        self.coupler.run_cycle()
        await self._listen_or_not()
        return {}

    def clear_faults(self) -> None:
        self._faults.clear_all()
        self.coupler.faults.clear_all()

    def _update_state(self) -> float:
        """Follow the world; return how long it may be left alone [s]."""
        return _PORT_REAL_S

    async def _follow_world(self) -> None:
        port_s = 0.0
        while True:
            pause_s = self._update_state()
            if self._world.clock.real_now_s() >= port_s:
                await self._listen_or_not()
                port_s = self._world.clock.real_now_s() + _PORT_REAL_S
            await asyncio.sleep(pause_s)

    async def _listen_or_not(self) -> None:
        server, flap = self.coupler.server, self.coupler.faults.active_parameters("flap")
        gone = flap is not None and self._world.clock.real_now_s() % (2 * flap["period_s"]) > flap["period_s"]
        if gone or self.coupler.faults.active_parameters("refuse") is not None:
            server.close()
        else:
            with suppress(OSError):  # the address is not free yet; the next look tries again
                await server.open()


class ProbeDevice(IoDevice):
    """A touch-trigger probe on a digital input."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        super().__init__(world, table, _PROBE_KINDS)
        self.probe = ContactProbe(world, table)
        self.coupler.digital[int(table.get("contact_input", 1)) - 1] = self._signal_state
        if "echo_output" in table:
            self.coupler.loops[int(table["echo_output"])] = int(table["echo_input"])

    def _signal_state(self) -> bool:
        if self._faults.active_parameters("stuck_closed") is not None:
            return True
        if self._faults.active_parameters("stuck_open") is not None:
            return False
        self._update_contact()
        now_s, switch = self._world.clock.real_now_s(), self.probe.switch
        late, springs = self._faults.active_parameters("delay"), self._faults.active_parameters("bounce")
        late_s = 0.0 if late is None else float(late["s"])
        bounce = None if springs is None else (float(springs["s"]), float(springs["half_s"]))
        closed = switch.is_closed(now_s, late_s, bounce)
        lost = self._faults.active_parameters("contact_lost")
        if closed and lost is not None:
            return not switch.is_closed(now_s, late_s + float(lost["after_s"]), (0.0, 1.0))
        return closed

    def _update_contact(self) -> None:
        self.probe.pressed = self._faults.active_parameters("press") is not None
        self.probe.update_contact()

    def _update_state(self) -> float:
        self._update_contact()
        arm = self.probe.tip.arm
        return _TICK_REAL_S if arm is not None and arm.is_moving else _REST_REAL_S

    def true_state(self) -> JsonObject:
        link_state = {"port": self.coupler.server.port, "output_writes": self.coupler.output_writes}
        return {**self.probe.true_state(), **link_state, "signal": self._signal_state()}


class DialDevice(IoDevice):
    """A dial gauge with a 4-20 mA output on an analogue input."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        super().__init__(world, table, _DIAL_KINDS)
        self.plunger = DialPlunger(world, table)
        self.coupler.analogue[int(table.get("dial_input", 1)) - 1] = self._current_share
        if "echo_output" in table:
            self.coupler.loops[int(table["echo_output"])] = int(table["echo_input"])

    def _current_share(self) -> float:
        if self._faults.active_parameters("wire_break") is not None:
            return -0.25  # of 16 mA below 4 mA: nothing flows
        if self._faults.active_parameters("overrange") is not None:
            return 1.1
        pushed = self._faults.active_parameters("push_in")
        self.plunger.by_hand_m = 0.0 if pushed is None else float(pushed["m"])
        return (self.plunger.read_m() + self._turned_m()) / self.plunger.range_m

    def _turned_m(self) -> float:
        turned = self._faults.active_parameters("wire_offset")
        return 0.0 if turned is None else float(turned["m"])

    def true_state(self) -> JsonObject:
        plunger_state = self.plunger.true_state()
        return {
            **plunger_state,
            "reading_m": plunger_state["reading_m"] + self._turned_m(),
            "port": self.coupler.server.port,
        }


def _coupler_for(world: World, table: Mapping[str, Any]) -> FakeCoupler:
    """Return the coupler that stands at the table's address: one for all who name it."""
    host, port = str(table.get("address", "127.0.0.1")), int(table.get("port", 502))
    found = world.shared.get((host, port)) if port else None
    if not isinstance(found, FakeCoupler):
        found = FakeCoupler(host, port, str(table["serial"]), world.clock.real_now_s)
        world.shared[host, port] = found
    return found


def create_probe(world: World, table: Mapping[str, Any]) -> ProbeDevice:
    """Build the touch probe that a cell file names."""
    return ProbeDevice(world, table)


def create_dial(world: World, table: Mapping[str, Any]) -> DialDevice:
    """Build the dial gauge that a cell file names."""
    return DialDevice(world, table)
