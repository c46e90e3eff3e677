"""Touch probes."""

from dataclasses import dataclass
from typing import Protocol

from cellcal.drivers.interfaces.device import Device


@dataclass(frozen=True, slots=True)
class ProbeCapabilities:
    """The capabilities of a touch probe. The delay leads from the touch to the closed contact in the image."""

    tip_radius_m: float
    pretravel_m: float  # how far the tip gives way before its contact closes
    sigma_m: float  # scatter of that, over all directions
    overtravel_m: float  # how far the tip may give way without harm
    delay_s: float
    delay_tolerance_s: float  # the delay lies within plus and minus this
    reaction_s: float  # longest time from a touch to the end of ``wait_for_touch``


@dataclass(frozen=True, slots=True)
class ContactReading:
    """Whether the contact is closed. ``raw`` is the word that held it."""

    closed: bool
    taken_at_s: float  # host monotonic clock
    raw: int


@dataclass(frozen=True, slots=True)
class ContactEdge:
    """A touch: it happened between ``earliest_s`` and ``latest_s`` [host monotonic], the probe's delay taken off."""

    earliest_s: float
    latest_s: float
    bounces: int  # how often the contact was seen open again before it stayed closed
    steady: bool  # false: it did not stay closed within the time a bounce may take
    raw: tuple[int, ...]  # the words that were seen, from the last open one on


class TouchProbe(Device, Protocol):
    """A probe whose contact closes when its tip touches. Each sentence is a test in tests/wire/contract_probe.py.

    A reading is fresh: taken after the call began. An image of the inputs that stands still gives no reading.
    ``wait_for_touch`` returns the first touch after the call, in bounds that hold it. A contact that is
    closed already is
    refused. A second wait during one raises BusyError at once. A cancelled wait leaves the probe usable.
    """

    @property
    def capabilities(self) -> ProbeCapabilities: ...
    async def read_contact(self) -> ContactReading: ...
    async def wait_for_touch(self) -> ContactEdge:
        """Wait for a touch, as long as it takes; the caller's limit is how far the arm travels."""
        ...
