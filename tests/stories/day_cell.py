"""The cell of a working day: two robots with a wire each, a tracker, a fixture and an end-effector; all fakes."""

import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from service.demo.door import Door
from service.demo.fake_cell import free_address, running_fakes

POINTS_M = ((-0.35, -0.45, 0.0), (0.35, -0.45, 0.0), (-0.35, 0.45, 0.0), (0.35, 0.45, 0.25))
TARGETS_M = ((0.0, 0.0, 0.0), (0.16, 0.0, -0.05), (0.0, 0.16, -0.05))
ROBOTS = {"fanuc": "F-104711", "second": "F-104712"}

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
serial = 4711
range_m = 3.0
sigma_m = 0.0001
deadline_s = 10.0
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

[watch]
period_s = 0.5

[fake]
seed = {seed}
time_factor = 1500.0
control_port = 0

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
) -> AsyncIterator[tuple[Path, Door]]:
    """Run the cell's fakes; its file is in ``folder``."""
    with free_address() as one, free_address() as other:
        robots = [
            _ROBOT.format(name=name, serial=serial, address=address)
            for (name, serial), address in zip(ROBOTS.items(), (one, other), strict=True)
        ]
        rest = _REST.format(address=one, seed=seed, points=_in_mm(points_m), targets=_in_mm(TARGETS_M))
        path = folder / "cell.toml"
        head = f'[cell]\nname = "working day"\ndata_dir = {json.dumps(str(folder / "data"))}\n'
        path.write_text(head + "".join(robots) + rest, encoding="utf-8")
    async with running_fakes(path) as door:
        yield path, door


def _in_mm(points_m: tuple[tuple[float, ...], ...]) -> str:
    return json.dumps([[1e3 * value for value in point] for point in points_m])
