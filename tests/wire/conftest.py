"""One process of fake devices for all wire tests of a worker; each test finds its devices healthy."""

from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.wire.driver_cases import GAUGES, PROBES, GaugeCase, ProbeCase, open_retrying, until_open
from tests.wire.fake_devices_process import FakesProcess, run_fakes, start_fakes
from tests.wire.robot_cases import ROBOTS, RobotCase, open_at_home

pytest.register_assert_rewrite(
    "tests.wire.contract_robot",
    "tests.wire.contract_gauge",
    "tests.wire.contract_mastering",
    "tests.wire.contract_tracker",
    "tests.wire.contract_probe",
)


@pytest.fixture(scope="session")
def shared_fakes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FakesProcess]:
    with start_fakes(tmp_path_factory.mktemp("cell")) as fakes:
        yield fakes


@pytest.fixture
def fake_process(shared_fakes: FakesProcess) -> Iterator[tuple[Path, FakeCellClient]]:
    """The shared devices, whose process runs during a test only."""
    with shared_fakes.stop_outside():
        yield shared_fakes.cell_file, shared_fakes.fake_client


@pytest.fixture
def cell(fake_process: tuple[Path, FakeCellClient]) -> CellConfig:
    return read_cell_file(fake_process[0])


@pytest.fixture
async def fake_client(fake_process: tuple[Path, FakeCellClient]) -> FakeCellClient:
    """The control of all simulated devices, whose faults are cleared."""
    await fake_process[1].send_command("clear")
    return fake_process[1]


@pytest.fixture
async def motoman(cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    """The Yaskawa robot, healthy and at home."""
    case = ROBOTS["yaskawa"]
    async with open_at_home(case, cell, fake_client) as robot:
        yield robot
        await case.heal(fake_client, robot)


@pytest.fixture(params=sorted(ROBOTS))
def robot_case(request: pytest.FixtureRequest) -> RobotCase:
    return ROBOTS[request.param]


@pytest.fixture
async def robot(robot_case: RobotCase, cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    """A connected robot at its home position, its cell healthy."""
    async with open_at_home(robot_case, cell, fake_client) as robot:
        yield robot


@pytest.fixture(params=sorted(GAUGES))
def gauge_case(request: pytest.FixtureRequest) -> GaugeCase:
    return GAUGES[request.param]


@pytest.fixture
async def gauge(gauge_case: GaugeCase, cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    """A connected gauge, its cell healthy."""
    await gauge_case.heal(fake_client)
    entry = next(one for one in (*cell.gauges, *cell.probes) if one.device.name == gauge_case.name)
    async with open_retrying(entry.device) as gauge:
        yield gauge


@pytest.fixture(params=sorted(PROBES))
def probe_case(request: pytest.FixtureRequest) -> ProbeCase:
    return PROBES[request.param]


@pytest.fixture
async def probe(probe_case: ProbeCase, cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    """A connected touch probe that touches nothing, its cell healthy."""
    await probe_case.heal(fake_client)
    entry = next(entry for entry in cell.probes if entry.device.name == probe_case.name)
    async with open_retrying(entry.device) as probe:
        await until_open(probe)
        yield probe


@pytest.fixture
async def fanuc(cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    """The Modbus robot, healthy and at home."""
    case = ROBOTS["modbus_robot"]
    async with open_at_home(case, cell, fake_client) as robot:
        yield robot


@pytest.fixture
def fresh_fakes(tmp_path: Path) -> Iterator[tuple[Path, FakeCellClient]]:
    """A cell of its own, for a test that spoils the robot for others."""
    with run_fakes(tmp_path) as cell:
        yield cell
