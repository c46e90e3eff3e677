"""A whole cell on loopback: its cell file, and the process that plays its devices."""

import asyncio
import json
import random
import socket
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.service.demo.demo_fixtures import FIXTURES_TOML, USUAL
from cellcal.service.demo.fake_cell_client import FakeCellClient

# ur-rtde cannot be told other ports, so every fake robot needs a loopback address of its own.
_PORTS = (29999, 30001, 30002, 30003, 30004, 1502, 29536)
_START_S = 120.0

QUICKLY = 600.0  # times as fast as real: for what a demo is not about

_CELL_FILE = """\
# Written by `cellcal demo`: a fake cell on loopback. Edit and run it with `cellcal fakes` and `cellcal run`.
[cell]
name = "demo"
data_dir = {data_dir}

[[robot]]
name = "fanuc"
driver = "modbus_robot"
profile = "fanuc_hmi"
address = "{address}"
port = 1502
model = "fanuc_m6ib"
motion = "commanded"
serial = "F-104711"
deadline_s = 6.0                         # this and the limits below: also for a machine that has other work
speed_limit_rad_s = 0.5
settle_s = {settle_s}

[[robot.space.plane]]                    # what stands in the cell: without any, speeds halve
name = "floor"
point_in_base_mm = [0, 0, -900]
normal_in_base = [0, 0, 1]
{usual}
[[robot]]
name = "ur"
driver = "universal_robots"
address = "{address}"
model = "ur10e"
motion = "commanded"
serial = "20225500042"
deadline_s = 6.0
speed_limit_rad_s = 0.5
watchdog_hz = 1.0

[[robot.space.plane]]                    # what stands in the cell: without any, speeds halve
name = "floor"
point_in_base_mm = [0, 0, -900]
normal_in_base = [0, 0, 1]

[[gauge]]
name = "wire"
driver = "draw_wire"
interface = "socketcand"
host = "{address}"
port = 29536
channel = "can0"
node_id = 7
serial = 4711
range_m = 3.0
sigma_m = 0.0002
deadline_s = 3.0
heartbeat_s = 0.4
robot = "fanuc"
anchor_in_base_mm = [900.0, -700.0, -450.0]
hook_in_flange_mm = [60.0, 50.0, 120.0]
anchor_sigma_mm = 10.0
hook_sigma_mm = 2.0
mouth_at_mm = [750.0, 0.0, 550.0]

[watch]
period_s = 0.2
drift_check_days = 14

[fake]
seed = {seed}
time_factor = {time_factor}
watchdog_factor = 3.0
control_port = 0
{furniture}"""


@contextmanager
def free_address() -> Iterator[str]:
    """Find a loopback address on which none of the devices' ports is taken."""
    for _ in range(200):
        address = f"127.{random.randint(1, 254)}.{random.randint(0, 254)}.{random.randint(2, 254)}"
        if all(_is_free(address, port) for port in _PORTS):
            yield address
            return
    raise CellError(
        "no loopback address is free for the fake cell.",
        remedy="Linux gives 127.0.0.0/8 to everybody; on macOS: `sudo ifconfig lo0 alias 127.0.0.2`.",
        code="fake",
    )


def _is_free(address: str, port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((address, port))
        except OSError:
            return False
    return True


def write_cell_file(
    folder: Path, address: str, *, seed: int, time_factor: float, furnished: bool = False
) -> Path:
    """Write the demo's cell file into ``folder``; devices listen on ``address``.

    ``furnished``: with what procedures measure beside the robot, and the settings that they need for it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "cell.toml"
    data_dir = json.dumps(str(folder / "data"))
    settle_s = max(0.01, 1.0 / time_factor)  # one second of the world's time
    text = _CELL_FILE.format(
        address=address,
        seed=seed,
        time_factor=time_factor,
        data_dir=data_dir,
        settle_s=settle_s,
        usual=USUAL if furnished else "",
        furniture=FIXTURES_TOML if furnished else "",
    )
    path.write_text(text, encoding="utf-8")
    return path


@asynccontextmanager
async def running_fakes(cell_file: Path) -> AsyncIterator[FakeCellClient]:
    """Run the devices that the file names in their own process, until the block ends."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "cellcal.fake_devices", str(cell_file), "--watch-stdin",
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
        start_new_session=True,  # Ctrl+C goes to the cell's client: its devices stay until it has left
    )  # fmt: skip
    try:
        ready = await _ready_line(process)
        host, port = ready["control"]
        yield FakeCellClient(str(host), int(port))
    finally:
        await _end_process(process)


async def _ready_line(process: asyncio.subprocess.Process) -> dict[str, Any]:
    assert process.stdout is not None
    with suppress(TimeoutError, ValueError):
        async with asyncio.timeout(_START_S):
            line = await process.stdout.readline()
            ready: dict[str, Any] = parse_json(line)
            return ready
    raise CellError(
        "the fake devices did not start; the line above says why.",
        remedy="If an address is in use, end the other `cellcal fakes` or name a free one (127.a.b.c); else correct "
        "the [fake] table.",
        code="fake",
    )


async def _end_process(process: asyncio.subprocess.Process) -> None:
    if process.returncode is None:
        with suppress(ProcessLookupError):
            process.terminate()
        try:
            async with asyncio.timeout(5.0):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()
    if process.stdin is not None:
        process.stdin.close()
