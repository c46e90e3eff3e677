"""Every open screen: one slot each for the newest live message, and one for the newest session.

A screen that is slow misses what is old, never what is newest, and is dropped when it takes nothing for a second.
"""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Protocol

import orjson
from fastapi import WebSocketDisconnect

SLOW_S = 1.0


class Socket(Protocol):
    """What a screen is reached by."""

    async def send_text(self, data: str) -> None: ...
    async def close(self, code: int = 1000, reason: str | None = None) -> None: ...


@dataclass(eq=False)
class Screen:
    """One open page."""

    socket: Socket
    who: str
    newest: dict[str, str] = field(default_factory=dict)
    ready: asyncio.Event = field(default_factory=asyncio.Event)
    heard_at_s: float = 0.0

    def show(self, kind: str, text: str) -> None:
        """Put a message into its slot; what was there and not yet sent is dropped."""
        self.newest[kind] = text
        self.ready.set()

    async def feed(self) -> None:
        """Send what is newest, again and again; TimeoutError when the screen takes nothing."""
        while True:
            await self.ready.wait()
            self.ready.clear()
            waiting, self.newest = self.newest, {}
            for text in waiting.values():
                async with asyncio.timeout(SLOW_S):
                    await self.socket.send_text(text)


def framed(kind: str, content: object) -> str:
    """Return a message as it goes over the wire."""
    return orjson.dumps({"kind": kind, "content": content}).decode()


class Screens:
    """All of them."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._open: set[Screen] = set()

    def __len__(self) -> int:
        """Return how many are open."""
        return len(self._open)

    def show(self, kind: str, content: object) -> None:
        """Show something to all."""
        text = framed(kind, content)
        for screen in self._open:
            screen.show(kind, text)

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
            with contextlib.suppress(RuntimeError, ConnectionError, WebSocketDisconnect):  # it left by itself
                await screen.socket.close()
