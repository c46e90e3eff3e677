"""Connections of the web server: a flood, half-open ones and a lack of descriptors never keep a stop away."""

import asyncio
import errno
import logging
import os
import resource
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI, WebSocket
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosedError

from cellcal.service.cli.app import run_command_line
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.exit_codes import ExitCode
from cellcal.service.web.connections import (
    ALL_OF_ADDRESS,
    HEADERS_S,
    LEAVE_S,
    WAITING_OF_ADDRESS,
    ServerConnections,
)
from tests.service.browser_pages import serve_app

ANSWER = {"content-type": "application/json"}


class ManualClock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class FakeTransport:
    """A transport that only knows whether it was aborted, or is being closed while its receiver takes nothing."""

    def __init__(self) -> None:
        self.aborted = self.closed = False

    def abort(self) -> None:
        self.aborted = True

    def is_closing(self) -> bool:
        return self.aborted or self.closed

    def get_extra_info(self, name: str, default: object = None) -> object:
        assert name == "socket"
        return default if self.aborted else self

    def fileno(self) -> int:
        return 7


def test_of_too_many_from_one_address_the_oldest_idle_one_gives_way() -> None:
    connections = ServerConnections(most=10_000, clock=ManualClock())
    lines = [FakeTransport() for _ in range(WAITING_OF_ADDRESS + 5)]
    for line in lines:
        connections.add_connection("10.0.0.1", line)
    assert [line.aborted for line in lines] == [True] * 5 + [False] * WAITING_OF_ADDRESS
    other = FakeTransport()
    connections.add_connection("10.0.0.2", other)
    assert not other.aborted
    assert len(connections) == WAITING_OF_ADDRESS + 1


def test_what_is_busy_or_a_screen_outlives_what_is_idle() -> None:
    connections, clock = ServerConnections(most=40, clock=ManualClock()), 0
    del clock
    busy_lines = [FakeTransport() for _ in range(20)]
    for number, line in enumerate(busy_lines):
        connections.set_state(
            connections.add_connection("10.0.0.1", line), "busy" if number % 2 else "screen"
        )
    flood = [FakeTransport() for _ in range(200)]
    for line in flood:
        connections.add_connection("10.0.0.1", line)
    assert not any(line.aborted for line in busy_lines)
    assert len(connections) == 40
    assert not flood[-1].aborted


def test_one_address_cannot_hold_all_screens() -> None:
    connections = ServerConnections(most=10_000, clock=ManualClock())
    lines = [FakeTransport() for _ in range(ALL_OF_ADDRESS + 3)]
    for line in lines:
        connections.set_state(connections.add_connection("10.0.0.1", line), "screen")
    assert sum(line.aborted for line in lines) == 3


def test_a_request_that_never_ends_its_headers_is_closed() -> None:
    clock = ManualClock()
    connections = ServerConnections(most=100, clock=clock)
    slow, screen = FakeTransport(), FakeTransport()
    connections.add_connection("10.0.0.1", slow)
    connections.set_state(connections.add_connection("10.0.0.1", screen), "screen")
    clock.now_s += HEADERS_S - 0.1
    connections.close_stale()
    assert not slow.aborted
    clock.now_s += 0.2
    connections.close_stale()
    connections.release_spares()
    assert (slow.aborted, screen.aborted) == (True, False)


def test_a_connection_whose_receiver_takes_no_last_bytes_is_counted_and_cut() -> None:
    clock = ManualClock()
    connections = ServerConnections(most=100, clock=clock)
    deaf = FakeTransport()
    connections.set_state(connections.add_connection("10.0.0.1", deaf), "screen")
    deaf.closed = True
    connections.close_stale()
    assert (len(connections), deaf.aborted) == (1, False)
    clock.now_s += LEAVE_S + 0.1
    connections.close_stale()
    connections.release_spares()
    assert (len(connections), deaf.aborted) == (0, True)


def test_errors_of_accept_are_logged_once_a_second(caplog: pytest.LogCaptureFixture) -> None:
    clock = ManualClock()
    connections = ServerConnections(most=100, clock=clock)
    with caplog.at_level(logging.WARNING):
        for _ in range(500):
            connections.on_accept_error(OSError(errno.EMFILE, "Too many open files"))
        assert len(caplog.records) == 1
        clock.now_s += 1.1
        connections.on_accept_error(OSError(errno.EMFILE, "Too many open files"))
    assert [record.getMessage() for record in caplog.records][1:] == [
        "a connection could not be accepted: Too many open files (499 more like it)"
    ]


@contextmanager
def every_descriptor_taken() -> Iterator[None]:
    """Take all that this process may still open, as a leak would; the limit is made small for that."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    top = max(int(entry.name) for entry in Path("/proc/self/fd").iterdir()) + 40
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(top, hard), hard))
    taken = []
    try:
        while True:
            taken.append(os.open(os.devnull, os.O_RDONLY))
    except OSError as error:
        if error.errno != errno.EMFILE:
            raise
        yield
    finally:
        for descriptor in taken:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


ASKER = """
import socket, sys
with socket.create_connection(("127.0.0.1", int(sys.argv[1]))) as to:
    to.sendall(b"POST /stop HTTP/1.1\\r\\nhost: localhost\\r\\ncontent-length: 0\\r\\nconnection: close\\r\\n\\r\\n")
    answer = b""
    while part := to.recv(4096):
        answer += part
print(answer.split(b"\\r\\n")[0].decode(), answer.endswith(b'"stopped"'))
"""


async def test_a_stop_is_served_with_every_descriptor_taken(tmp_path: Path) -> None:
    app, stops = FastAPI(), []

    @app.post("/stop")
    async def stop_robot() -> str:
        stops.append((tmp_path / "register").open("w").close())  # what a stop opens besides
        return "stopped"

    async with serve_app(app) as address:
        port = address.rpartition(":")[2]
        asking = await asyncio.create_subprocess_exec(
            sys.executable, "-c", "import sys; sys.stdin.readline()\n" + ASKER, port,
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        with every_descriptor_taken():
            answer, _ = await asking.communicate(b"now\n")
        assert answer.decode().split() == ["HTTP/1.1", "200", "OK", "True"]
    assert len(stops) == 1


async def test_a_stop_is_served_beside_more_idle_connections_than_allowed() -> None:
    app = FastAPI()

    @app.post("/stop")
    async def stop_robot() -> str:
        return "stopped"

    async with serve_app(app) as address:
        at = ("127.0.0.1", int(address.rpartition(":")[2]))
        with ExitStack() as open_lines:
            for number in range(3 * WAITING_OF_ADDRESS):
                line = open_lines.enter_context(socket.create_connection(at))
                if number % 2:
                    line.sendall(b"GET / HTTP/1.1\r\nhost: 127.0.0.1\r\nx-slow: ")  # never ended
            async with httpx.AsyncClient() as client:
                answer = await client.post(f"{address}/stop")
        assert answer.json() == "stopped"


async def test_a_screen_that_says_more_than_it_may_is_let_go() -> None:
    app = FastAPI()

    @app.websocket("/screen")
    async def count_received(socket: WebSocket) -> None:
        await socket.accept()
        while True:
            await socket.send_text(str(len(await socket.receive_text())))

    async with (
        serve_app(app) as address,
        connect(f"ws{address.removeprefix('http')}/screen", proxy=None) as screen,
    ):
        await screen.send("x" * 4000)
        assert await screen.recv() == "4000"
        await screen.send("x" * 5000)  # as memory that hundreds of screens could take
        with pytest.raises(ConnectionClosedError, match="1009"):
            await screen.recv()


@pytest.mark.parametrize("command", ["serve", "demo"])
@pytest.mark.parametrize("port", ["taken", "99999999999", "-1"])
def test_a_port_that_cannot_be_used_ends_the_command(
    command: str, port: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port_text = str(taken.getsockname()[1]) if port == "taken" else port
        cell = write_cell_file(tmp_path / "served", "127.0.0.1", seed=1, time_factor=1.0)
        words = {"serve": [str(cell)], "demo": ["--no-browser", "--keep", str(tmp_path)]}
        assert run_command_line([command, *words[command], "--port", port_text]) == ExitCode.USAGE
    assert f"port {port_text} of 127.0.0.1 cannot be used" in capsys.readouterr().err
