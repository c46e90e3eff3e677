"""How soon `cellcal serve` answers: time and processor time from its start to the first HTTP 200."""

import http.client
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from cellcal.service.demo.fake_cell import write_cell_file
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.service_process import free_port

WITHIN_S = 2.0
_PATIENCE_S = 120.0


def starts(count: int) -> CampaignFigures:
    """Start the service so often, one after the other; the first start may have to read cold files."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_cell_file(Path(folder), "127.0.0.1", seed=1, time_factor=1.0)
        start_times = [_start_service(path) for _ in range(count)]
    walls, used = zip(*start_times, strict=True)
    line = (
        f"starts: first answer after {statistics.median(walls):.2f} s (median of {count}, {min(walls):.2f} to "
        f"{max(walls):.2f} s; at most {WITHIN_S:g} s), {statistics.median(used):.2f} s of processor time; "
        f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    )
    return CampaignFigures(line, statistics.median(walls) <= WITHIN_S)


def _start_service(path: Path) -> tuple[float, float]:
    port, began_s = free_port(), time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "cellcal", "serve", str(path), "--port", str(port)], stderr=subprocess.DEVNULL
    )
    try:
        while not _is_answering(port):
            assert process.poll() is None, "the service ended"
            assert time.monotonic() - began_s < _PATIENCE_S
            time.sleep(0.01)
        took_s = time.monotonic() - began_s
        fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        return took_s, (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


def _is_answering(port: int) -> bool:
    with suppress(OSError):
        line = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
        try:
            line.request("GET", "/")
            return line.getresponse().status == 200
        finally:
            line.close()
    return False
