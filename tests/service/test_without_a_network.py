"""The cell, its service and a browser on a computer that has a loopback and nothing else."""

import subprocess
import sys

import pytest

from tests.service.browser_pages import ROOT

LOOPBACK_UP = """
import fcntl, os, socket, struct, sys
with socket.socket() as any_socket:
    fcntl.ioctl(any_socket, 0x8914, struct.pack("16sH14x", b"lo", 1))  # SIOCSIFFLAGS, IFF_UP
    any_socket.settimeout(5.0)
    try:
        any_socket.connect(("192.0.2.1", 80))
    except OSError:
        os.execv(sys.executable, [sys.executable, "-m", "pytest", *sys.argv[1:]])
sys.exit("there is a way out")
"""
STORY = "tests/service/test_pages.py::test_a_run_from_its_start_to_its_place_in_the_history"
ALONE = ("unshare", "--user", "--map-root-user", "--net")


def test_service_cell_and_browser_work_where_no_network_is() -> None:
    if subprocess.run([*ALONE, "true"], capture_output=True, check=False).returncode != 0:
        pytest.skip("this computer permits no network namespace (unshare)")
    ran = subprocess.run(
        [*ALONE, sys.executable, "-c", LOOPBACK_UP, STORY, "-q", "-p", "no:cacheprovider"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout[-3000:] + ran.stderr[-3000:]
