"""The simulated OPC UA server against node-opcua, a client of others: state, joints, name plate, a stop."""

import json
import math
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.machine_speed import stretched_s
from tests.wire.client_program import print_of_client
from tests.wire.opc_ua_server import SERIAL, believed, fake_server

CLIENTS = Path(__file__).parents[1] / "node_clients"
NODE = shutil.which("node", path=str(Path(sys.executable).parent)) or shutil.which("node")
DEADLINE_S = stretched_s(120.0)

pytestmark = [
    pytest.mark.timeout(3 * DEADLINE_S),
    pytest.mark.skipif(
        NODE is None or not (CLIENTS / "node_modules" / "node-opcua-client").is_dir(),
        reason="`make test` installs node-opcua (deploy/install_node_clients.sh)",
    ),
]


async def read_with_node_opcua(address: str, home: Path) -> dict[str, Any]:
    """Return what the client prints; its certificates go to a folder of the test."""
    assert NODE is not None
    out = await print_of_client(
        NODE, "read_robot.mjs", f"opc.tcp://{address}:4840", cwd=CLIENTS, env={**os.environ, "HOME": str(home)},
        deadline_s=DEADLINE_S,
    )  # fmt: skip
    (answer,) = [
        line for line in out.splitlines() if line.startswith(b"{")
    ]  # beside lines of the library's log
    found: dict[str, Any] = json.loads(answer)
    return found


async def test_node_opcua_reads_what_the_world_holds(tmp_path: Path) -> None:
    async with fake_server() as fake:
        for unit, to_si in (("deg", math.radians(1.0)), ("rad", 1.0)):
            await fake.inject_fault("restart", {"units": [unit] * 6})
            found = await read_with_node_opcua(fake.address, tmp_path)
            axes = sorted(found["axes"], key=lambda axis: str(axis["name"]))
            assert [axis["value"] * to_si for axis in axes] == pytest.approx(believed(fake), abs=1e-9)
            assert {axis["unit"] for axis in axes} == {unit}
            assert {axis["profile"] for axis in axes} == {1}
            assert found["serial"] == SERIAL
            stops = (found["emergencyStop"], found["protectiveStop"])
            assert stops == (unit == "rad", False)
            await fake.inject_fault("emergency_stop", {})
