"""A site on loopback with mutual TLS: its files, its router as a process, cells that publish, for tests."""

import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import zenoh

from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.record.journal import NewEvent
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.signing import station_key
from cellcal.service.site.enrolment import CellApplicant, NewSite, enroll_cells
from cellcal.service.site.keys import StationKeys
from cellcal.service.site.link_files import CELL_FILE, MONITOR_FILE, close_session, read_link_folder
from cellcal.service.site.publisher import run_publisher
from tests.machine_speed import stretched_s

SITE = "hall-3"
PATIENCE_S = stretched_s(90.0)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_until(true: Callable[[], Any], patience_s: float = PATIENCE_S) -> Any:
    """Wait for something to become true; nothing here is a claim about time."""
    ends_s = time.monotonic() + patience_s
    while not (found := true()):
        assert time.monotonic() < ends_s, "it never came true"
        time.sleep(0.02)
    return found


class LoopbackSite:
    """One site's folder with its cells."""

    def __init__(self, folder: Path, *cells: str) -> None:
        self.folder, self.port = folder / "site", free_port()
        self.cells: dict[str, CellConfig] = {}
        self._root = folder
        self.add_cells(*cells, new=NewSite(SITE, f"127.0.0.1:{self.port}"))

    @property
    def monitor_folder(self) -> Path:
        return self.folder / "monitor"

    def add_cells(self, *cells: str, new: NewSite | None = None) -> None:
        made = []
        for name in cells:
            path = write_cell_file(self._root / name, "127.0.0.1", seed=1, time_factor=1.0)
            with path.open("a", encoding="utf-8") as file:
                file.write(f"\n[site]\nfolder = {json.dumps(str(self.folder / 'cells' / name))}\n")
            self.cells[name] = read_cell_file(path)
            made.append(CellApplicant(name, station_key(self.cells[name].cell.data_dir).public_key))
        enroll_cells(self.folder, made, new)

    def station_keys(self, cell: str) -> StationKeys:
        return StationKeys(SITE, cell)

    def zenoh_of(self, cell: str) -> zenoh.Config:
        """Return the link of a cell as it was enrolled, as a thief would have it."""
        return read_link_folder(self.folder / "cells" / cell, CELL_FILE).zenoh_config()

    def zenoh_of_monitor(self) -> zenoh.Config:
        return read_link_folder(self.monitor_folder, MONITOR_FILE).zenoh_config()

    def append_to_journal(self, cell: str, run_id: str, count: int, first: int = 0) -> None:
        """Append facts to a cell's journal, as a run does."""
        with open_journal(self.cells[cell]) as journal:
            for k in range(first, first + count):
                journal.append_all(run_id, [NewEvent("finding", {"step": f"capture {k}", "value": k * 0.1})])

    def start_router(self) -> AbstractContextManager[subprocess.Popen[str]]:
        return router_of(self.folder)

    @contextmanager
    def publish_cell(self, cell: str) -> Iterator[Callable[[str, dict[str, Any]], None]]:
        """Run the publisher of a cell; yield a function that sends what its cell process would."""
        reading, writing = os.pipe()
        leave = threading.Event()
        failed: list[BaseException] = []

        def run_until_closed() -> None:
            try:
                with os.fdopen(reading, "rb") as stream:
                    run_publisher(self.cells[cell], stream, leave)
            except BaseException as error:
                failed.append(error)

        def publish(kind: str, content: dict[str, Any]) -> None:
            os.write(writing, json.dumps({"told": kind, "content": content}).encode() + b"\n")

        thread = threading.Thread(target=run_until_closed)
        thread.start()
        try:
            yield publish
        finally:
            os.close(writing)
            thread.join(PATIENCE_S)
            assert not thread.is_alive(), "a publisher whose desk is gone must end"
            assert not failed, failed


@contextmanager
def router_of(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run `cellcal site router` until the block ends."""
    process = subprocess.Popen(
        [sys.executable, "-m", "cellcal", "site", "router", "--folder", str(folder)],
        stderr=subprocess.PIPE, text=True, env=os.environ | {"COLUMNS": "300"},
    )  # fmt: skip
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        assert "listens" in line, line + process.stderr.read()
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE_S)


@contextmanager
def open_bus(config: zenoh.Config) -> Iterator[zenoh.Session]:
    session = zenoh.open(config)
    try:
        yield session
    finally:
        close_session(session)


class SiteListener:
    """Everything that the monitor's right lets one hear of a site."""

    def __init__(self, session: zenoh.Session, keys: str = f"cellcal/v1/{SITE}/**") -> None:
        self.received_keys: list[str] = []
        self._subscriber = session.declare_subscriber(keys, self._on_sample)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self.received_keys.append(f"{sample.key_expr} {sample.payload.to_bytes()!r}")

    def has_received(self, word: str) -> bool:
        return any(word in line for line in self.received_keys)


def session_of(cell: str, **changes: Any) -> dict[str, Any]:
    """Return a cell process's session as `service/cell_process/cell_controller.py` writes it, with nothing under way."""
    return {
        "rev": 1,
        "cell": cell,
        "robots": [],
        "robot": "fanuc",
        "level": "commanded",
        "connection": {"connected": True, "message": "", "remedy": ""},
        "run": None,
        "prompt": None,
        "waits_for_hold": False,
        "losses": [],
        "journal_end": "",
        "troubles": [],
    } | changes


def live_of(
    *, at_s: float = 0.0, state: str = "ready", joints: tuple[float, ...] = (0.1,) * 6
) -> dict[str, Any]:
    """Return a cell process's live message of a robot and a wire."""
    robot = {
        "role": "robot",
        "name": "fanuc",
        "state": state,
        "message": "" if state == "ready" else "E-stop.",
    }
    wire = {"role": "gauge", "name": "wire", "state": "ready", "message": ""}
    rest = {"remedy": "", "live": True, "asked": False, "age_s": 0.01, "value_age_s": 0.01}
    return {
        "rev": 1,
        "at_s": at_s,
        "devices": [
            robot | rest | {"value": {"joints_rad": list(joints), "moving": False}},
            wire | rest | {"value": {"length_m": 1.25, "sigma_m": 0.0002}},
        ],
    }
