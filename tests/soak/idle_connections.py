"""A stop beside idle connections: more of them than the service has descriptors, half of them half-open requests."""

import asyncio
import resource
import socket
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import httpx

from tests.service.cell_process_session import a_cell
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.service_process import free_port, serve_cell

DESCRIPTORS = 1024
WITHIN_S = 1.0
STOPS = 20


def campaign(count: int) -> CampaignFigures:
    """Open so many connections that send nothing, or never end their headers; then ask the robot to stop."""
    with tempfile.TemporaryDirectory() as folder:
        return asyncio.run(_measure_stop(Path(folder), count))


async def _measure_stop(folder: Path, count: int) -> CampaignFigures:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    async with a_cell(folder) as (path, _):
        port = free_port()
        resource.setrlimit(resource.RLIMIT_NOFILE, (DESCRIPTORS, hard))  # the service inherits it
        async with serve_cell(path, port) as (_, client):
            resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, count + 500), hard))
            while (await client.get("/api/session")).json()["session"] is None:
                await asyncio.sleep(0.1)  # the cell's process is being started: there is no run to stop yet
            with ExitStack() as lines:
                for number in range(count):
                    line = lines.enter_context(socket.create_connection(("127.0.0.1", port)))
                    if number % 2:
                        line.sendall(b"GET / HTTP/1.1\r\nhost: localhost\r\nx-slow: ")
                times = [await _stop_s(client) for _ in range(STOPS)]
    words = f"{count} idle connections, {DESCRIPTORS} descriptors: a stop answers within {max(times) * 1e3:.0f} ms"
    return CampaignFigures(f"{words} (first {times[0] * 1e3:.0f} ms; {STOPS} stops)", max(times) <= WITHIN_S)


async def _stop_s(client: httpx.AsyncClient) -> float:
    began_s = time.perf_counter()
    answer = await client.post("/api/commands", json={"id": "stop", "rev": 1, "order": {"op": "stop"}})
    took_s = time.perf_counter() - began_s
    assert answer.status_code == 200, answer.text
    return took_s
