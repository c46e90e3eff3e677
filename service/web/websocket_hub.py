"""Every open screen: one slot each for the newest live message, and one for the newest session.

A screen that is slow misses what is old, never what is newest, and is dropped when it takes too long for one message.
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Protocol

import orjson
from fastapi import WebSocketDisconnect

from cellcal.calibration.message_table import with_messages

SLOW_S = 6.0  # for one message; a page that opens over a slow network waits as long for its first answer
CLOSE_DEADLINE_S = 1.0
TICK_S = 1.0  # a screen gets a message at least this often, so that silence means a lost link


class ScreenSocket(Protocol):
    """The socket of a screen."""

    async def send_text(self, data: str) -> None: ...
    async def close(self, code: int = 1000, reason: str | None = None) -> None: ...


@dataclass(eq=False)
class OpenScreen:
    """One open page."""

    socket: ScreenSocket
    who: str
    session_id: str = ""
    is_closed: bool = False
    newest: dict[str, str] = field(default_factory=dict)
    ready: asyncio.Event = field(default_factory=asyncio.Event)

    def show_message(self, kind: str, text: str) -> None:
        """Put a message into its slot; what was there and not yet sent is dropped."""
        self.newest[kind] = text
        self.ready.set()

    async def send_newest(self) -> None:
        """Send what is newest until the screen has to leave; TimeoutError when it takes nothing."""
        while not self.is_closed:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(TICK_S):
                    await self.ready.wait()
            self.ready.clear()
            waiting, self.newest = self.newest or {"tick": encode_message("tick", None)}, {}
            for text in waiting.values():
                async with asyncio.timeout(SLOW_S):
                    await self.socket.send_text(text)


def encode_message(kind: str, content: object) -> str:
    """Return a message as it goes over the wire."""
    return orjson.dumps(with_messages({"kind": kind, "content": content})).decode()


class OpenScreens:
    """All open screens."""

    def __init__(self) -> None:
        self._open: set[OpenScreen] = set()

    def __len__(self) -> int:
        """Return how many are open."""
        return len(self._open)

    def broadcast(self, kind: str, content: object) -> None:
        """Show something to all."""
        text = encode_message(kind, content)
        for screen in self._open:
            screen.show_message(kind, text)

    @property
    def open_screens(self) -> tuple[OpenScreen, ...]:
        """All that are open."""
        return tuple(self._open)

    def has_page_of(self, session_id: str) -> bool:
        """Whether a page of a session is open."""
        return any(screen.session_id == session_id for screen in self._open)

    def close_session(self, session_id: str) -> None:
        """Let the screens of one session go: it has ended, and another may begin in the same browser."""
        for screen in self._open:
            if session_id and screen.session_id == session_id:
                screen.is_closed = True
                screen.ready.set()

    async def serve_screen(self, screen: OpenScreen, receive: Callable[[], Awaitable[None]]) -> None:
        """Feed a screen until it leaves or is too slow; ``receive`` ends when the screen closes."""
        self._open.add(screen)
        tasks = {asyncio.ensure_future(screen.send_newest()), asyncio.ensure_future(receive())}
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._open.discard(screen)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await let_go(screen.socket)


async def let_go(socket: ScreenSocket) -> None:
    """Close a socket; one that takes nothing takes no goodbye either, and is not waited for."""
    with contextlib.suppress(RuntimeError, ConnectionError, WebSocketDisconnect, TimeoutError):
        async with asyncio.timeout(CLOSE_DEADLINE_S):
            await socket.close()  # one that left by itself says so
