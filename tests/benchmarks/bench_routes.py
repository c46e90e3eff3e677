"""How long each route takes to answer: ``python -m tests.benchmarks.bench_routes [times]``.

The pages of a demo are served by a process of its own, as a technician's tablet sees them; every route that only
reads is asked for a few times, then every procedure is foretold. First answer, median and worst in milliseconds.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from statistics import median
from typing import Any

import httpx

from cellcal.procedures.catalogue_index import CATALOGUE_INDEX
from cellcal.service.demo.fake_cell import free_address

_START_S = 120.0
_PAUSE_S = 0.011  # of a tablet; the service takes a hundred requests a second


@contextmanager
def served_demo() -> Iterator[httpx.Client]:
    """Serve the pages of a demo; give what asks them."""
    with free_address() as address:
        port = 18471
    del address
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "cellcal", "demo", "--no-browser", "--port", str(port)],
            stdout=log, stderr=log, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0) as client:
                _wait_until_served(client, process)
                yield client
        finally:
            process.terminate()
            process.wait(timeout=60.0)


def _wait_until_served(client: httpx.Client, process: "subprocess.Popen[bytes]") -> None:
    until = time.monotonic() + _START_S
    while time.monotonic() < until and process.poll() is None:
        try:
            if client.get("/api/session").status_code == 200:
                return
        except httpx.TransportError:
            time.sleep(0.05)
    raise SystemExit("the demo's pages are not served")


def read_routes(client: httpx.Client) -> list[str]:
    """Return the paths of all routes that only read, with something that exists for each name in them."""
    description = client.get("/openapi.json").json()
    names = _names(client)
    paths = [path for path, ways in description["paths"].items() if "get" in ways]
    return sorted(path.format_map(names) for path in paths)


def _names(client: httpx.Client) -> Mapping[str, str]:
    class Names(dict[str, str]):
        def __missing__(self, key: str) -> str:
            return "none"

    session, runs = client.get("/api/session").json(), client.get("/api/runs").json()
    names = Names(robot=str(session.get("robot", "fanuc")))
    if runs:
        names["run_id"] = runs[0]["run_id"]
        names["robot_serial"] = runs[0]["robot_serial"]
    return names


def time_answers(ask: Callable[[], httpx.Response], times: int) -> tuple[int, list[float]]:
    """Return the last status and how long each answer took [ms]."""
    taken: list[float] = []
    status = 0
    for _ in range(times):
        began = time.perf_counter()
        status = ask().status_code
        taken.append(1e3 * (time.perf_counter() - began))
        time.sleep(_PAUSE_S)
    return status, taken


def main() -> None:
    """Print a line a route and, last, one JSON line."""
    times = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    found: dict[str, Any] = {}
    with served_demo() as client:
        asked: dict[str, Callable[[], httpx.Response]] = {
            f"GET {path}": (lambda path=path: client.get(path)) for path in ("/", *read_routes(client))
        }
        for entry in CATALOGUE_INDEX:
            body = {"procedure": entry.name, "settings": {}}
            asked[f"POST /api/dry-runs {entry.name}"] = lambda body=body: client.post(
                "/api/dry-runs", json=body
            )
        sys.stdout.write(f"{'status':>6} {'first':>8} {'median':>8} {'worst':>8}  [ms]\n")
        for name, ask in asked.items():
            status, taken = time_answers(ask, times)
            later = taken[1:] or taken
            found[name] = {
                "status": status,
                "first_ms": taken[0],
                "median_ms": median(later),
                "worst_ms": max(later),
            }
            figures = f"{taken[0]:8.1f} {median(later):8.1f} {max(later):8.1f}"
            sys.stdout.write(f"{status:6d} {figures}  {name}\n")
            sys.stdout.flush()
    sys.stdout.write(json.dumps({"routes": found, "load": os.getloadavg()[0]}) + "\n")


if __name__ == "__main__":
    main()
