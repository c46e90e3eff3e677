"""The simulated Yaskawa controller against moto-hses-client, of others in Rust, and our driver against their mock."""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from cellcal.drivers.errors import WrongDeviceError
from cellcal.drivers.yaskawa.absolute_data import read_absolute_data
from cellcal.drivers.yaskawa.hses_frames import ROBOT_DIVISION
from cellcal.drivers.yaskawa.hses_link import HsesLink
from cellcal.drivers.yaskawa.state import read_alarms, read_pulses, read_status
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.machine_speed import stretched_s
from tests.wire.client_program import print_of_client
from tests.wire.fake_devices_process import own_address

BUILT = Path(__file__).parents[1] / "rust_clients" / "target" / "debug"
CLIENT, SERVER = BUILT / "read-yaskawa", BUILT / "mock-yaskawa"
DEADLINE_S = stretched_s(30.0)

pytestmark = pytest.mark.skipif(
    not (CLIENT.is_file() and SERVER.is_file()),
    reason="`make test` builds them where cargo is (deploy/install_rust_clients.sh)",
)


async def read_with_moto_hses(address: str) -> dict[str, Any]:
    """Return what the client prints."""
    found: dict[str, Any] = json.loads(await print_of_client(CLIENT, address, deadline_s=DEADLINE_S))
    return found


async def test_moto_hses_reads_what_the_controller_holds(
    motoman: Any, cell: CellConfig, fake_client: FakeCellClient
) -> None:
    address = cell.robot_named("motoman").address
    found = await read_with_moto_hses(address)
    assert tuple(found["pulses"][:6]) == await motoman.encoder_counts()
    assert (found["servo"], found["has_alarm"], found["code"]) == (True, False, 0)
    assert "TOOL.CND" in found["files"]
    shown = [int(each.value) for each in await motoman.position_data() if each.name == "ABSO.DAT"]
    assert list(read_absolute_data(found["homes"])) == shown
    await fake_client.inject_fault("alarm", device="motoman", code=4320)
    found = await read_with_moto_hses(address)
    assert (found["has_alarm"], found["code"]) == (True, 4320)
    assert found["name"].startswith("OVERLOAD")


async def test_our_driver_reads_a_server_of_others(cell: CellConfig) -> None:
    """As far as moto-hses-mock goes: status, alarm, pulses. It does not know 0x89, which names the robot, and 0x8B."""
    config = cell.robot_named("motoman").model_copy(update={"address": own_address()})
    server = await asyncio.create_subprocess_exec(SERVER, config.address, stdout=asyncio.subprocess.PIPE)
    assert server.stdout is not None
    try:
        assert await server.stdout.readline() == b"ready\n"
        with pytest.raises(WrongDeviceError, match="names its robot ''"):
            async with config.open():
                pass
        link = HsesLink("mock", config.address, config.port, ROBOT_DIVISION, deadline_s=config.deadline_s)
        await link.open()
        try:
            status, alarms, pulses = await read_status(link), await read_alarms(link), await read_pulses(link)
        finally:
            link.close()
    finally:
        server.kill()
        await server.wait()
    assert status.mode_name == "PLAY"
    assert alarms[0].code == 1001
    assert len(pulses.pulses) == 6
