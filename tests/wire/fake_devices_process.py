"""Fake devices in a process of their own, and one small cell file for all wire tests."""

import itertools
import json
import os
import re
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cellcal.service.demo.demo_arm import describe_arms, write_described
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.machine_speed import stretched_s

TIME_FACTOR = 30.0
_START_S = stretched_s(30.0)
_numbers = itertools.count()

FLOOR = """\
[[robot.space.plane]]                    # what stands in the cell: without any, speeds halve
name = "floor"
point_in_base_mm = [0, 0, -900]
normal_in_base = [0, 0, 1]
"""

KUKA_ROBOT = """\
[[robot]]
name = "kuka"
driver = "kuka_variables"
address = "{address}"
model = "kuka_kr10r1420"
motion = "commanded"
serial = "864231"
fastest_axis_deg_s = 410.0
deadline_s = 2.0
speed_limit_rad_s = 0.5
step_s = 0.5
settle_s = 0.02

[robot.rsi]
listen = "{second_address}"
port = 49152
window_s = 0.4  # a test machine may be too busy for 0.2
silent_s = 1.5
late_s = 0.5

{floor}
"""
ABB_ROBOT = """\
[[robot]]
name = "abb"
driver = "abb_web_services"
address = "{address}"
port = 8080
model = "abb_irb1600_6_12"
motion = "commanded"
serial = "1600-500123"
deadline_s = 3.0
speed_limit_rad_s = 0.5
step_s = 0.5
settle_s = 0.02

{floor}
"""
EGM_STREAM = """\
[robot.egm]
listen = "{second_address}"
window_s = 0.4  # a test machine may be too busy for 0.2
silent_s = 1.5
late_s = 0.5
"""
FAKE_TABLE = """\
[fake]
seed = 1
time_factor = {time_factor}
control_port = 0
"""

CELL = (
    """\
[cell]
name = "wire tests"
data_dir = "{folder}"

[[robot]]
name = "fanuc"
driver = "modbus_robot"
profile = "fanuc_hmi"
address = "{address}"
port = 1502
model = "fanuc_m6ib"
motion = "commanded"
serial = "F-104711"
deadline_s = 2.0
speed_limit_rad_s = 0.5
settle_s = 0.04

{floor}
[[robot]]
name = "ur"
driver = "universal_robots"
address = "{address}"
model = "ur10e"
motion = "commanded"
serial = "20225500042"
deadline_s = 2.0
speed_limit_rad_s = 0.5
watchdog_hz = 1.0  # a test machine may be too busy for 5

{floor}
[[robot]]
name = "ur_x"
driver = "universal_robots"
address = "{second_address}"              # the maker's ports are fixed
robot_api_port = 8089
model = "ur10e"
motion = "commanded"
serial = "20235500043"
deadline_s = 2.0
speed_limit_rad_s = 0.5
watchdog_hz = 1.0  # as above

{floor}
[[robot]]
name = "rmi"
driver = "fanuc_rmi"
address = "{address}"
model = "fanuc_m6ib"
motion = "commanded"
serial = "F-230816"
deadline_s = 2.0
speed_limit_rad_s = 0.5
step_s = 0.5
settle_s = 0.02

{floor}
"""
    + KUKA_ROBOT
    + ABB_ROBOT
    + """\
[[robot]]
name = "abb_7"
driver = "abb_web_services"
address = "{address}"
port = 8443
model = "abb_irb1600_6_12"
motion = "commanded"
serial = "460-300278"
deadline_s = 3.0
speed_limit_rad_s = 0.5
step_s = 0.5
settle_s = 0.02

"""
    + EGM_STREAM
    + """
{floor}
[[robot]]
name = "motoman"
driver = "yaskawa"
address = "{address}"
model = "yaskawa_gp25"
controller_type = "1-06VX25-A0*"
motion = "commanded"
serial = "Y-230815"
pulses_per_degree = [1341.4, 1341.4, -1341.4, 1000.0, 1000.0, -622.2]
fastest_axis_deg_s = 885.0
deadline_s = 2.0
speed_limit_rad_s = 0.5
step_s = 0.5
settle_s = 0.02

{floor}
[[robot]]
name = "any_maker"
driver = "opc_ua"
address = "{address}"
port = 4840
model = "fanuc_m6ib"
motion = "observe"
serial = "ER-230817"
deadline_s = 2.0
still_s = 0.1

{floor}
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
deadline_s = 1.0
heartbeat_s = 0.4  # as above
robot = "fanuc"
anchor_in_base_mm = [900.0, -700.0, -450.0]
hook_in_flange_mm = [60.0, 50.0, 120.0]

[[gauge]]
name = "wire_tcp"
driver = "draw_wire"
interface = "modbus"
host = "{address}"
port = 1504
serial = 815
range_m = 3.0
sigma_m = 0.0002
step_um = 38.452
deadline_s = 1.0
robot = "ur"
anchor_in_base_mm = [900.0, -700.0, -450.0]
hook_in_flange_mm = [60.0, 50.0, 120.0]

[[probe]]
name = "probe"
driver = "touch_probe"
address = "{address}"
port = 1503
serial = "00:30:DE:0A:0B:0C"
robot = "fanuc"
contact_input = 1
echo_output = 1
echo_input = 2
tip_in_flange_mm = [0.0, 0.0, 160.0]
tip_radius_mm = 1.5
sigma_mm = 0.003
overtravel_mm = 3.0
delay_ms = 6.0
delay_tolerance_ms = 3.0
deadline_s = 2.0
silence_ms = 500.0

[[probe]]
name = "dial"
driver = "dial_gauge"
address = "{address}"
port = 1503
serial = "00:30:DE:0A:0B:0C"
robot = "fanuc"
dial_input = 2
echo_output = 2
echo_input = 3
tip_in_flange_mm = [0.0, 0.0, 160.0]
range_mm = 12.5
sigma_mm = 0.01
deadline_s = 2.0

"""
    + FAKE_TABLE
    + """
[fake.robots.abb_7]
generation = 2

[fake.robots.ur_x]
software = "10.12.1.0"
"""
)


_LIMIT = re.compile(r"^(deadline_s|measure_deadline_s|silence_ms) = ([0-9.]+)", re.MULTILINE)
_MOST = {"silence_ms": 2000.0}  # what the drivers take


def _stretch_limit(limit: re.Match[str]) -> str:
    return f"{limit[1]} = {min(stretched_s(float(limit[2])), _MOST.get(limit[1], 60.0)):.1f}"


def own_address() -> str:
    """Return a loopback address that no other test process uses, so that fixed ports do not meet."""
    pid = os.getpid()
    return f"127.{100 + next(_numbers) % 100}.{pid >> 8 & 0xFF}.{pid & 0xFF}"


def _fill_in(text: str, folder: Path) -> str:
    return text.format(
        address=own_address(),
        second_address=own_address(),
        folder=folder,
        time_factor=TIME_FACTOR,
        floor=FLOOR,
    )


@dataclass(frozen=True)
class FakesProcess:
    """The cell file, the control of its devices, and the process that plays them."""

    cell_file: Path
    fake_client: FakeCellClient
    process: subprocess.Popen[bytes]

    @contextmanager
    def stop_outside(self) -> Iterator[None]:
        """Let the process run inside the block only: its cyclic telegrams cost a sixth of a core while unused."""
        self.process.send_signal(signal.SIGCONT)
        try:
            yield
        finally:
            self.process.send_signal(signal.SIGSTOP)


@contextmanager
def run_fakes(folder: Path, text: str = CELL) -> Iterator[tuple[Path, FakeCellClient]]:
    """Play the devices of a cell file until the block ends."""
    with start_fakes(folder, text) as fakes:
        yield fakes.cell_file, fakes.fake_client


@contextmanager
def start_fakes(folder: Path, text: str = CELL) -> Iterator[FakesProcess]:
    """Start the process that plays the devices of a cell file; it ends with the block."""
    path = folder / "cell.toml"
    text = _fill_in(text, folder)
    if "watchdog_factor" not in text:
        text = text.replace("[fake]\n", "[fake]\nwatchdog_factor = 3.0\n")
    path.write_text(_LIMIT.sub(_stretch_limit, text), encoding="utf-8")
    arms = write_described(folder, describe_arms(path))
    process = subprocess.Popen(
        [sys.executable, "-m", "cellcal.fake_devices", str(path), "--watch-stdin", "--arms", str(arms)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        readable, _, _ = select.select([process.stdout], [], [], _START_S)
        assert readable, "the fake devices did not start"
        host, port = json.loads(process.stdout.readline())["control"]
        yield FakesProcess(path, FakeCellClient(host, port), process)
    finally:
        process.send_signal(signal.SIGCONT)
        process.stdin.close()
        process.wait(timeout=_START_S)
        process.stdout.close()
