"""A whole cell on loopback: its cell file, and the process that plays its devices."""

import asyncio
import json
import random
import socket
import sys
import tempfile
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.service.demo.demo_arm import DemoArm, describe_arms, write_described
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
name = {name}
driver = "modbus_robot"
profile = "fanuc_hmi"
address = "{address}"
port = 1502
model = {model}
motion = "commanded"
serial = "F-104711"
deadline_s = 6.0                         # this and the limits below: also for a machine that has other work
speed_limit_rad_s = 0.5
settle_s = {settle_s}
{space}
[[robot.space.plane]]                    # what stands in the cell: without any, speeds halve
name = "floor"
point_in_base_mm = [0, 0, {floor_mm}]
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
range_m = {range_m}
sigma_m = 0.0002
deadline_s = 3.0
heartbeat_s = 0.4
robot = {name}
anchor_in_base_mm = {anchor_mm}
hook_in_flange_mm = [60.0, 50.0, 120.0]
anchor_sigma_mm = 10.0
hook_sigma_mm = 2.0
mouth_at_mm = {mouth_mm}

[watch]
period_s = 0.2
drift_check_days = 14

[fake]
seed = {seed}
time_factor = {time_factor}
watchdog_factor = 3.0
control_port = 0
{furniture}"""
_OWN_ARM = {
    "space": "",
    "name": '"fanuc"',
    "model": '"fanuc_m6ib"',
    "floor_mm": "-900",
    "range_m": "3.0",
    "anchor_mm": "[900.0, -700.0, -450.0]",
    "mouth_mm": "[750.0, 0.0, 550.0]",
}
OTHER_ARM = "robot"  # what the cell file calls an arm of the user's choice


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
        remedy="On Linux every program may use 127.0.0.0/8; on macOS: `sudo ifconfig lo0 alias 127.0.0.2`.",
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
    folder: Path,
    address: str,
    *,
    seed: int,
    time_factor: float,
    furnished: bool = False,
    arm: DemoArm | None = None,
) -> Path:
    """Write the demo's cell file into ``folder``; devices listen on ``address``.

    ``arm`` takes the place of the demo's own FANUC.

    ``furnished``: with what procedures measure beside the robot, and the settings that they need for it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "cell.toml"
    data_dir = json.dumps(str(folder / "data"))
    settle_s = max(0.01, 1.0 / time_factor)  # one second of the world's time
    text = _CELL_FILE.format(
        **(_OWN_ARM if arm is None else _words_of(arm)),
        address=address,
        seed=seed,
        time_factor=time_factor,
        data_dir=data_dir,
        settle_s=settle_s,
        usual=USUAL if furnished else "",
        furniture=FIXTURES_TOML if furnished else "" if arm is None else _park_of(arm),
    )
    path.write_text(text, encoding="utf-8")
    return path


def _words_of(arm: DemoArm) -> dict[str, str]:
    return {
        "space": f"\n[robot.space]\nlink_radius_mm = {arm.link_radius_m * 1e3:.0f}\n",
        "name": json.dumps(OTHER_ARM),
        "model": json.dumps(arm.model.name),
        "floor_mm": f"{arm.floor_m * 1e3:g}",
        "range_m": f"{arm.wire_range_m:g}",
        "anchor_mm": str([round(value * 1e3, 1) for value in arm.anchor_in_base_m]),
        "mouth_mm": str([round(value * 1e3, 1) for value in arm.mouth_in_base_m]),
    }


def _park_of(arm: DemoArm) -> str:
    park = [round(float(value), 3) for value in np.degrees(arm.park_rad)]
    return f"\n[fake.park_deg]\n{OTHER_ARM} = {park}\n"


@asynccontextmanager
async def running_fakes(cell_file: Path) -> AsyncIterator[FakeCellClient]:
    """Run the devices that the file names in their own process, until the block ends.

    Raises
    ------
    CellError
        They do not start, or the file names a robot that they do not play.
    """
    with tempfile.TemporaryDirectory(prefix="cellcal-fakes-") as scratch:
        arms = write_described(Path(scratch), describe_arms(cell_file))
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "cellcal.fake_devices", str(cell_file), "--watch-stdin", "--arms", str(arms),
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
