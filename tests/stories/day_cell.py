"""The cell of a working day, all fakes: two robots with a wire each, a tracker, a fixture and an end-effector.

The second robot carries a touch probe, and a nest stands before it: a corner of three planes.
"""

import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from cellcal.calibration.arm.kinematics import load_model
from cellcal.service.demo.fake_cell import free_address, running_fakes
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.machine_speed import stretched_s
from tests.procedures.probed_corner import corner_below
from tests.wire.probe_cell import corner_tables

POINTS_M = ((-0.35, -0.45, 0.0), (0.35, -0.45, 0.0), (-0.35, 0.45, 0.0), (0.35, 0.45, 0.25))
TARGETS_M = ((0.0, 0.0, 0.0), (0.16, 0.0, -0.05), (0.0, 0.16, -0.05))
TIP_MM = (10.0, -20.0, 160.0)
OVER_THE_CORNER_RAD = (0.1, 0.17, -0.44, 0.26, -1.05, 0.35)  # where the probe looks straight into the nest
CORNER = corner_below(
    load_model("fanuc_m6ib"), [value * 1e-3 for value in TIP_MM], OVER_THE_CORNER_RAD, height_m=0.04
)
PACE = 1500.0  # so many times as fast as real time
ROBOTS = {"fanuc": "F-104711", "second": "F-104712"}
WIRES = {"fanuc": 4711, "second": 4712}  # two instruments: nothing that one has wrong is wrong with the other

_ROBOT = """
[[robot]]
name = "{name}"
driver = "modbus_robot"
profile = "fanuc_hmi"
address = "{address}"
port = 1502
model = "fanuc_m6ib"
motion = "commanded"
serial = "{serial}"
deadline_s = 10.0
speed_limit_rad_s = 0.5
settle_s = 0.01

[[robot.space.plane]]
name = "floor"
point_in_base_mm = [0, 0, -900]
normal_in_base = [0, 0, 1]

[[gauge]]
name = "wire of {name}"
driver = "draw_wire"
interface = "socketcand"
host = "{address}"
port = 29536
channel = "can0"
node_id = 7
serial = {wire}
range_m = 3.0
sigma_m = 0.0001
deadline_s = 10.0
heartbeat_s = 1.0
robot = "{name}"
anchor_in_base_mm = [900.0, -700.0, -450.0]
hook_in_flange_mm = [60.0, 50.0, 120.0]
"""
_REST = """
[[tracker]]
name = "tracker"
driver = "laser_tracker"
address = "{address}"
port = 7700
serial = 390793
station = 2
deadline_s = 10.0
robot = "fanuc"
target_in_flange_mm = [80.0, 40.0, 100.0]

[[probe]]
name = "probe"
driver = "touch_probe"
address = "{other}"
port = 1503
serial = "00:30:DE:0A:0B:0C"
robot = "second"
contact_input = 1
echo_output = 1
echo_input = 2
tip_in_flange_mm = {tip}
tip_sigma_mm = 0.1
tip_radius_mm = 1.5
pretravel_mm = 0.02
sigma_mm = 0.003
overtravel_mm = 6.0
delay_ms = 6.0
delay_tolerance_ms = 3.0
deadline_s = 5.0
silence_ms = {silence}
debounce_ms = 40.0
bounce_ms = 40.0  # of real time, while the world runs faster: an arm that comes to rest at the surface swings
poll_ms = 6.0

[watch]
period_s = 0.5

[fake]
seed = {seed}
time_factor = {pace}
control_port = 0
watchdog_factor = 10.0

[fake.fixture]
points_mm = {points}
seen_from = {{ fanuc = [850.0, 0.0, -200.0, 0.0, 0.0, 0.0], second = [850.0, 0.0, -200.0, 0.0, 0.0, 0.0] }}

[fake.end_effector]
targets_mm = {targets}
flange_tool = [0.0, 0.0, 200.0, 0.0, 0.0, 0.0]
"""


@asynccontextmanager
async def day_cell(
    folder: Path, *, seed: int = 3, points_m: tuple[tuple[float, ...], ...] = POINTS_M
) -> AsyncIterator[tuple[Path, FakeCellClient]]:
    """Run the cell's fakes; its file is in ``folder``."""
    with free_address() as one, free_address() as other:
        robots = [
            _ROBOT.format(name=name, serial=serial, wire=WIRES[name], address=address)
            for (name, serial), address in zip(ROBOTS.items(), (one, other), strict=True)
        ]
        rest = _REST.format(
            address=one,
            other=other,
            seed=seed,
            pace=PACE,
            tip=list(TIP_MM),
            silence=min(stretched_s(500.0), 2000.0),
            points=_in_mm(points_m),
            targets=_in_mm(TARGETS_M),
        )
        rest += corner_tables("second", CORNER)
        path = folder / "cell.toml"
        head = f'[cell]\nname = "working day"\ndata_dir = {json.dumps(str(folder / "data"))}\n'
        path.write_text(head + "".join(robots) + rest, encoding="utf-8")
    async with running_fakes(path) as fake_client:
        yield path, fake_client


def _in_mm(points_m: tuple[tuple[float, ...], ...]) -> str:
    return json.dumps([[1e3 * value for value in point] for point in points_m])
