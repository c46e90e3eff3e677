"""A fake cell with one instrument of each kind at its robot: wire, tracker, touch probe and dial gauge."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.procedures.test_places_over_the_wire import _ROBOT, PROBE, TRACKER
from tests.wire.fake_devices_process import run_fakes

_REST = """
[[probe]]
name = "dial"
driver = "dial_gauge"
address = "{{address}}"
port = 1503
serial = "00:30:DE:0A:0B:0C"
robot = "fanuc"
dial_input = 2
tip_in_flange_mm = [0.0, 0.0, 160.0]
range_mm = 12.5
sigma_mm = 0.01
deadline_s = 5.0

[[gauge]]
name = "wire"
driver = "draw_wire"
interface = "socketcand"
host = "{{address}}"
port = 29536
channel = "can0"
node_id = 7
serial = 4711
range_m = 3.0
sigma_m = 0.0002
deadline_s = 5.0
heartbeat_s = 0.4
robot = "fanuc"
anchor_in_base_mm = [900.0, -700.0, -450.0]
hook_in_flange_mm = [60.0, 50.0, 120.0]
"""
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
    instruments = (TRACKER + certificate_table + PROBE + (_REST if wired else "")).format()
    with run_fakes(folder, _ROBOT.format(instrument=instruments, seed=1)) as made:
        yield made
