"""The simulated Yaskawa controller against moto-hses-client, a Rust client of others: status, pulses, alarm, files."""

import json
from pathlib import Path
from typing import Any

import pytest

from cellcal.drivers.yaskawa.absolute_data import read_absolute_data
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.machine_speed import stretched_s
from tests.wire.client_program import print_of_client

CLIENT = Path(__file__).parents[1] / "rust_clients" / "target" / "debug" / "read-yaskawa"
DEADLINE_S = stretched_s(30.0)

pytestmark = pytest.mark.skipif(
    not CLIENT.is_file(), reason="`make test` builds it where cargo is (deploy/install_rust_clients.sh)"
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
