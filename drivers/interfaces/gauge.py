"""Instruments that measure one length: draw-wires and dial gauges."""

from dataclasses import dataclass
from typing import Protocol

from cellcal.drivers.interfaces.device import Device


@dataclass(frozen=True, slots=True)
class GaugeCapabilities:
    """The capabilities of a length gauge."""

    range_m: float
    resolution_m: float
    sigma_m: float
    answers_alone: bool = (
        True  # false: a reading takes a person or another program, so none is requested in vain
    )
    typed: bool = False  # by a person, when a run asks for it


@dataclass(frozen=True, slots=True)
class LengthReading:
    """One length. ``raw`` is the wire form, so that the journal can be evaluated again after a bug."""

    value_m: float
    sigma_m: float
    taken_at_s: float  # host monotonic clock
    raw: int


class DistanceGauge(Device, Protocol):
    """Draw-wire, dial gauge: one length at a time. A reading is fresh: taken after the call began.

    A dial gauge's length is how far its plunger is pushed in; a plunger that is free is no reading.
    """

    @property
    def capabilities(self) -> GaugeCapabilities: ...
    async def read_distance(self) -> LengthReading: ...
