"""Every open screen: one slot each for the newest live message, and one for the newest session.

A screen that is slow misses what is old, never what is newest, and is dropped when it takes nothing for a second.
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Protocol

import orjson
from fastapi import WebSocketDisconnect

SLOW_S = 1.0
TICK_S = 1.0  # a screen hears something at least this often, so that silence means a lost link


class Socket(Protocol):
    """What a screen is reached by."""

    async def send_text(self, data: str) -> None: ...
    async def close(self, code: int = 1000, reason: str | None = None) -> None: ...


@dataclass(eq=False)
class Screen:
    """One open page."""

    socket: Socket
    who: str
    seat: str = ""
    left: bool = False
    newest: dict[str, str] = field(default_factory=dict)
    ready: asyncio.Event = field(default_factory=asyncio.Event)

    def show(self, kind: str, text: str) -> None:
        """Put a message into its slot; what was there and not yet sent is dropped."""
        self.newest[kind] = text
        self.ready.set()

    async def feed(self) -> None:
        """Send what is newest until the screen has to leave; TimeoutError when it takes nothing."""
        while not self.left:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(TICK_S):
                    await self.ready.wait()
            self.ready.clear()
            waiting, self.newest = self.newest or {"tick": framed("tick", None)}, {}
            for text in waiting.values():
                async with asyncio.timeout(SLOW_S):
                    await self.socket.send_text(text)


def framed(kind: str, content: object) -> str:
    """Return a message as it goes over the wire."""
    return orjson.dumps({"kind": kind, "content": content}).decode()


class Screens:
    """All of them."""

    def __init__(self) -> None:
        self._open: set[Screen] = set()

    def __len__(self) -> int:
        """Return how many are open."""
        return len(self._open)

    def show(self, kind: str, content: object) -> None:
        """Show something to all."""
        text = framed(kind, content)
        for screen in self._open:
            screen.show(kind, text)

    @property
    def open(self) -> tuple[Screen, ...]:
        """All that are open."""
        return tuple(self._open)

    def close(self, seat: str) -> None:
        """Let the screens of one session go: it has ended, and another may begin in the same browser."""
        for screen in self._open:
            if seat and screen.seat == seat:
                screen.left = True
                screen.ready.set()

    async def attend(self, screen: Screen, receive: Callable[[], Awaitable[None]]) -> None:
        """Feed a screen until it leaves or is too slow; ``receive`` ends when the screen closes."""
        self._open.add(screen)
        tasks = {asyncio.ensure_future(screen.feed()), asyncio.ensure_future(receive())}
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._open.discard(screen)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await let_go(screen.socket)


async def let_go(socket: Socket) -> None:
    """Close a socket; one that takes nothing takes no goodbye either, and is not waited for."""
    with contextlib.suppress(RuntimeError, ConnectionError, WebSocketDisconnect, TimeoutError):
        async with asyncio.timeout(SLOW_S):
            await socket.close()  # one that left by itself says so
