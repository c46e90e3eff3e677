"""The touch probe of a cell, wired to a coupler, and what can happen to it.

Imitates
    A touch-trigger probe on a digital input of a rail.
Source
    See the modules of this package; deploy/controller_setup/touch_probe.md.
Modelled
    The faults of ``_PROBE_KINDS``, and those of the coupler and its link.
Not modelled
    See the modules of this package.
"""

from collections.abc import Mapping
from typing import Any

from cellcal.fake_devices.device import JsonObject
from cellcal.fake_devices.touch_probe.io_device import IoDevice
from cellcal.fake_devices.touch_probe.tip import ContactProbe
from cellcal.fake_devices.world import World

_TICK_REAL_S, _REST_REAL_S = 0.008, 0.04
_PROBE_KINDS: dict[str, dict[str, Any]] = {
    "stuck_closed": {},
    "stuck_open": {},  # it never touches
    "delay": {"s": 0.05},  # more delay than the data sheet says
    "bounce": {"s": 0.02, "half_s": 0.0013},  # how long the contact springs after it closed
    "press": {},  # a finger presses the tip
    "contact_lost": {"after_s": 0.05},  # closes, then opens again although it still touches
}


class ProbeDevice(IoDevice):
    """A touch-trigger probe on a digital input."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        super().__init__(world, table, _PROBE_KINDS)
        self.probe = ContactProbe(world, table)
        self.coupler.digital[int(table.get("contact_input", 1)) - 1] = self._signal_state

    def _signal_state(self) -> bool:
        if self.faults.active_parameters("stuck_closed") is not None:
            return True
        if self.faults.active_parameters("stuck_open") is not None:
            return False
        self._update_contact()
        now_s, switch = self.world.clock.real_now_s(), self.probe.switch
        late, springs = self.faults.active_parameters("delay"), self.faults.active_parameters("bounce")
        late_s = 0.0 if late is None else float(late["s"])
        bounce = None if springs is None else (float(springs["s"]), float(springs["half_s"]))
        closed = switch.is_closed(now_s, late_s, bounce)
        lost = self.faults.active_parameters("contact_lost")
        if closed and lost is not None:
            return not switch.is_closed(now_s, late_s + float(lost["after_s"]), (0.0, 1.0))
        return closed

    def _update_contact(self) -> None:
        self.probe.pressed = self.faults.active_parameters("press") is not None
        self.probe.update_contact()

    def update_state(self) -> float:
        self._update_contact()
        arm = self.probe.tip.arm
        return _TICK_REAL_S if arm is not None and arm.is_moving else _REST_REAL_S

    def true_state(self) -> JsonObject:
        link_state = {"port": self.coupler.server.port, "output_writes": self.coupler.output_writes}
        return {**self.probe.true_state(), **link_state, "signal": self._signal_state()}


def create_device(world: World, table: Mapping[str, Any]) -> ProbeDevice:
    """Build the touch probe that a cell file names."""
    return ProbeDevice(world, table)
