"""A fake cell with one instrument of each kind at its robot: wire, tracker, touch probe and dial gauge."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.cell_tables import dial_gauge_table, draw_wire_table
from tests.procedures.test_places_over_the_wire import PROBE, TRACKER, cell_without_wire
from tests.wire.fake_devices_process import run_fakes

_REST = dial_gauge_table() + draw_wire_table(deadline_s=5.0, heartbeat_s=0.4)
LAPSED = """
[{table}.certificate]
number = "T-12"
laboratory = "Lab"
issued = 2001-02-03
due = {due}
expanded_uncertainty_mm = 0.02
"""


@contextmanager
def full_cell(
    folder: Path, *, tracker_due: str = "", wired: bool = True
) -> Iterator[tuple[Path, FakeCellClient]]:
    """Play such a cell. ``wired``: with the wire and the dial gauge beside tracker and probe."""
    certificate_table = LAPSED.format(table="tracker", due=tracker_due) if tracker_due else ""
    instruments = TRACKER + certificate_table + PROBE + (_REST if wired else "")
    with run_fakes(folder, cell_without_wire(instruments)) as made:
        yield made
