"""Screens over real sockets: one that takes nothing keeps one message, delays no other, and is dropped."""

import asyncio
import base64
import json
import re
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect

from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.web import websocket_hub as rules
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from cellcal.service.web.websocket_hub import OpenScreen, OpenScreens
from tests.machine_speed import stretched_s
from tests.service.browser_pages import PATIENCE_S, serve_app, wait_for_value

LIVE = 1_000_000  # bytes of a message, so that an unread link is full after a few
_NUMBER = re.compile(rb'"n":(\d+)')


class CountedScreens(OpenScreens):
    """The screens, and how many the service is done with."""

    done = 0

    async def serve_screen(self, screen: OpenScreen, receive: Callable[[], Awaitable[None]]) -> None:
        await super().serve_screen(screen, receive)
        self.done += 1

    async def publish_number(self, number: int) -> None:
        self.broadcast("live", {"n": number, "pad": "x" * LIVE})
        await asyncio.sleep(0.01)
        assert all(set(screen.newest) <= {"live", "person", "control"} for screen in self.open_screens)


@dataclass
class ScreenServer:
    screens: CountedScreens
    port: int

    @contextmanager
    def deaf_screen(self) -> Iterator[socket.socket]:
        """Open a screen by hand, and read nothing of what it is sent."""
        key = base64.b64encode(b"0123456789abcdef").decode()
        with socket.socket() as screen:
            screen.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            screen.settimeout(PATIENCE_S)
            screen.connect(("127.0.0.1", self.port))
            screen.sendall(
                f"GET /api/screen HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\nUpgrade: websocket\r\n"
                f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
            )
            yield screen

    def connect_screen(self) -> connect:
        return connect(f"ws://127.0.0.1:{self.port}/api/screen", max_size=None)

    async def wait_for_screens(self, count: int) -> None:
        await wait_for_value(lambda: asyncio.sleep(0, len(self.screens)), lambda open_now: open_now == count)


@asynccontextmanager
async def a_hall(folder: Path) -> AsyncIterator[ScreenServer]:
    """Serve the pages' service without its cell process: the test says what screens show."""
    path = write_cell_file(folder, "127.0.0.1", seed=1, time_factor=1.0)
    app = create_app(ServiceSettings(path, open_access=True))
    screens = CountedScreens()
    app.state.context = replace(app.state.context, screens=screens)
    async with serve_app(app, lifespan="off") as url:
        yield ScreenServer(screens, int(url.rpartition(":")[2]))


async def read_numbers(screen: ClientConnection, received: list[int]) -> None:
    async for text in screen:
        message: dict[str, Any] = json.loads(text)
        if message["kind"] == "live":
            received.append(message["content"]["n"])


async def test_a_screen_that_never_reads_is_dropped_and_the_others_go_on_hearing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rules, "SLOW_S", stretched_s(1.0))
    received: list[int] = []
    async with a_hall(tmp_path) as hall, hall.connect_screen() as screen:
        hearing = asyncio.create_task(read_numbers(screen, received))
        with hall.deaf_screen():
            await hall.wait_for_screens(2)
            published = 0
            async with asyncio.timeout(PATIENCE_S):
                while len(hall.screens) == 2:
                    await hall.screens.publish_number(published := published + 1)
            await wait_for_value(lambda: asyncio.sleep(0, hall.screens.done), lambda done: done == 1)
            while_it_was_deaf = len(received)
            await hall.screens.publish_number(published := published + 1)
            await wait_for_value(lambda: asyncio.sleep(0, received), lambda value: published in value)
            assert while_it_was_deaf > 0
            assert len(hall.screens) == 1
        hearing.cancel()


async def test_a_screen_that_reads_late_is_shown_the_newest_and_not_what_it_missed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rules, "SLOW_S", PATIENCE_S)  # it has all the time it wants
    last = 40
    async with a_hall(tmp_path) as hall:
        with hall.deaf_screen() as screen:
            await hall.wait_for_screens(1)
            for number in range(1, last + 1):
                await hall.screens.publish_number(number)
            (open_screen,) = hall.screens.open_screens
            assert _NUMBER.findall(open_screen.newest["live"].encode()) == [str(last).encode()]
            received = await asyncio.to_thread(_read_until, screen, last)
        assert received == sorted(received)
        assert len(received) < last, "an unread link took all of them: this test shows nothing"


def _read_until(screen: socket.socket, last: int) -> list[int]:
    read = b""
    while f'"n":{last},'.encode() not in read:
        got = screen.recv(1 << 20)
        assert got, "the screen was dropped"
        read += got
    return [int(number) for number in _NUMBER.findall(read)]
