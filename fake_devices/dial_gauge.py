"""The dial gauge of a cell, wired to a coupler, and what can happen to it.

Imitates
    A dial gauge with a 4-20 mA output on an analogue input of a rail.
Source
    See the modules of the touch probe, whose rail it may share; deploy/controller_setup/touch_probe.md.
Modelled
    The faults of ``_DIAL_KINDS``, and those of the coupler and its link.
Not modelled
    See the modules of the touch probe.
"""

from collections.abc import Mapping
from typing import Any

from cellcal.fake_devices.device import JsonObject
from cellcal.fake_devices.touch_probe.io_device import IoDevice
from cellcal.fake_devices.touch_probe.tip import DialPlunger
from cellcal.fake_devices.world import World

_DIAL_KINDS: dict[str, dict[str, Any]] = {
    "wire_break": {},
    "overrange": {},
    "push_in": {"m": 0.004},  # a finger pushes the plunger in
    "wire_offset": {"m": 0.005},  # the dial was turned
}


class DialDevice(IoDevice):
    """A dial gauge with a 4-20 mA output on an analogue input."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        super().__init__(world, table, _DIAL_KINDS)
        self.plunger = DialPlunger(world, table)
        self.coupler.analogue[int(table.get("dial_input", 1)) - 1] = self._current_share

    def _current_share(self) -> float:
        if self.faults.active_parameters("wire_break") is not None:
            return -0.25  # of 16 mA below 4 mA: nothing flows
        if self.faults.active_parameters("overrange") is not None:
            return 1.1
        pushed = self.faults.active_parameters("push_in")
        self.plunger.by_hand_m = 0.0 if pushed is None else float(pushed["m"])
        return (self.plunger.read_m() + self._turned_m()) / self.plunger.range_m

    def _turned_m(self) -> float:
        turned = self.faults.active_parameters("wire_offset")
        return 0.0 if turned is None else float(turned["m"])

    def true_state(self) -> JsonObject:
        plunger_state = self.plunger.true_state()
        return {
            **plunger_state,
            "reading_m": plunger_state["reading_m"] + self._turned_m(),
            "port": self.coupler.server.port,
        }


def create_device(world: World, table: Mapping[str, Any]) -> DialDevice:
    """Build the dial gauge that a cell file names."""
    return DialDevice(world, table)
