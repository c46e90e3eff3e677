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
from tests.cell_tables import (
    cell_head,
    dial_gauge_table,
    draw_wire_table,
    fake_table,
    fill_in,
    touch_probe_table,
)
from tests.machine_speed import stretched_s
from tests.wire.robot_cases import ROBOTS

TIME_FACTOR = 30.0
_START_S = stretched_s(30.0)
_numbers = itertools.count()

FAKE_TABLE = fake_table(time_factor=TIME_FACTOR)

CELL = "".join(
    (
        cell_head("wire tests"),
        *(case.table for case in ROBOTS.values()),
        draw_wire_table(deadline_s=1.0, heartbeat_s=0.4),  # a test machine may be too busy for 0.2
        draw_wire_table(
            name="wire_tcp",
            interface="modbus",
            port=1504,
            serial=815,
            channel=None,
            node_id=None,
            step_um=38.452,
            deadline_s=1.0,
            robot="ur",
        ),
        touch_probe_table(
            echo_output=1,
            echo_input=2,
            tip_in_flange_mm=[0.0, 0.0, 160.0],
            overtravel_mm=3.0,
            deadline_s=2.0,
            silence_ms=500.0,
        ),
        dial_gauge_table(echo_output=2, echo_input=3, deadline_s=2.0),
        FAKE_TABLE,
    )
)

_LIMIT = re.compile(r"^(deadline_s|measure_deadline_s|silence_ms) = ([0-9.]+)", re.MULTILINE)
_MOST = {"silence_ms": 2000.0}  # what the drivers take


def _stretch_limit(limit: re.Match[str]) -> str:
    return f"{limit[1]} = {min(stretched_s(float(limit[2])), _MOST.get(limit[1], 60.0)):.1f}"


def own_address() -> str:
    """Return a loopback address that no other test process uses, so that fixed ports do not meet."""
    pid = os.getpid()
    return f"127.{100 + next(_numbers) % 100}.{pid >> 8 & 0xFF}.{pid & 0xFF}"


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
    text = fill_in(text, address=own_address(), second_address=own_address(), folder=str(folder))
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
