"""The cell of a working day, all fakes: two robots with a wire each, a tracker, a fixture and an end-effector.

The second robot carries a touch probe, and a nest stands before it: a corner of three planes.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from cellcal.calibration.arm.kinematics import load_model
from cellcal.service.demo.fake_cell import free_address, running_fakes
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.cell_tables import (
    cell_head,
    draw_wire_table,
    fake_table,
    fanuc_table,
    touch_probe_table,
    tracker_table,
    write_table,
)
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


@asynccontextmanager
async def day_cell(
    folder: Path, *, seed: int = 3, points_m: tuple[tuple[float, ...], ...] = POINTS_M
) -> AsyncIterator[tuple[Path, FakeCellClient]]:
    """Run the cell's fakes; its file is in ``folder``."""
    with free_address() as one, free_address() as other:
        robots = [
            fanuc_table(name=name, serial=serial, address=address, deadline_s=10.0)
            + draw_wire_table(
                name=f"wire of {name}",
                serial=WIRES[name],
                host=address,
                robot=name,
                sigma_m=0.0001,
                deadline_s=10.0,
                heartbeat_s=1.0,
            )
            for (name, serial), address in zip(ROBOTS.items(), (one, other), strict=True)
        ]
        head = cell_head("working day", str(folder / "data"))
        rest = _instrument_tables(one, other) + _world_tables(seed, points_m)
        path = folder / "cell.toml"
        path.write_text(head + "".join(robots) + rest, encoding="utf-8")
    async with running_fakes(path) as fake_client:
        yield path, fake_client


def _instrument_tables(one: str, other: str) -> str:
    probe = touch_probe_table(
        address=other,
        robot="second",
        echo_output=1,
        echo_input=2,
        tip_in_flange_mm=list(TIP_MM),
        tip_sigma_mm=0.1,
        pretravel_mm=0.02,
        overtravel_mm=6.0,
        silence_ms=min(stretched_s(500.0), 2000.0),
        debounce_ms=40.0,
        bounce_ms=40.0,  # of real time, while the world runs faster: an arm that comes to rest at the surface swings
        poll_ms=6.0,
    )
    return tracker_table(address=one) + probe + write_table("watch", period_s=0.5)


def _world_tables(seed: int, points_m: tuple[tuple[float, ...], ...]) -> str:
    fixture = write_table(
        "fake.fixture",
        points_mm=_in_mm(points_m),
        seen_from={name: [850.0, 0.0, -200.0, 0.0, 0.0, 0.0] for name in ROBOTS},
    )
    end_effector = write_table(
        "fake.end_effector", targets_mm=_in_mm(TARGETS_M), flange_tool=[0.0, 0.0, 200.0, 0.0, 0.0, 0.0]
    )
    world = fake_table(seed=seed, time_factor=PACE, watchdog_factor=10.0)
    return world + fixture + end_effector + corner_tables("second", CORNER)


def _in_mm(points_m: tuple[tuple[float, ...], ...]) -> list[list[float]]:
    return [[1e3 * value for value in point] for point in points_m]
