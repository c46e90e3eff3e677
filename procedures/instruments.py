"""What a cell has to find places again with, as values: known from the cell file, before anything is reached."""

from dataclasses import dataclass

from cellcal.drivers.interfaces import ProbeCapabilities, TrackerCapabilities
from cellcal.procedures.cell import Cell

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Instruments:
    """Tips and targets in the flange, and how well they are met; None where the cell has none."""

    probe_tip_m: Triple | None = None
    probe_sigma_m: float = 0.0
    probe_tip_sigma_m: float = 0.0  # of one coordinate of that tip in the flange
    target_m: Triple | None = None  # of a tracker
    tracker_sigma_m: float = 0.0
    tool_tip_m: Triple | None = None  # of the tool frame that is active on the controller


def instruments_of(cell: Cell, tool_tip_m: Triple | None = None) -> Instruments:
    """Return what the cell file says of probe and tracker, reached or on paper."""
    probe = None if cell.probe is None else cell.probe_setup
    tracker = None if cell.tracker is None else cell.tracker_setup
    return Instruments(
        probe_tip_m=None if probe is None else probe.tip_in_flange_m,
        probe_sigma_m=_sigma_m(None if cell.probe is None else cell.probe.capabilities),
        probe_tip_sigma_m=0.0 if probe is None else probe.sigma_tip_m,
        target_m=None if tracker is None else tracker.target_in_flange_m,
        tracker_sigma_m=_sigma_m(None if cell.tracker is None else cell.tracker.capabilities),
        tool_tip_m=tool_tip_m,
    )


def _sigma_m(capabilities: ProbeCapabilities | TrackerCapabilities | None) -> float:
    """Return the scatter of an instrument; 0 of one that is not there, or whose cell file does not state it."""
    return 0.0 if capabilities is None else capabilities.sigma_m
