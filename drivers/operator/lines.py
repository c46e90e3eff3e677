"""Lines from a file descriptor without blocking the event loop: waiting for a person can be cancelled."""

import asyncio
import os

_CHUNK = 4096


class LineSource:
    """Hands out one line at a time; what was typed ahead is kept."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._buffer = b""
        self._ended = False

    async def next_line(self) -> str | None:
        """Return the next line without its end, or None when the input is closed."""
        while b"\n" not in self._buffer and not self._ended:
            await self._wait_readable()
            chunk = os.read(self._descriptor, _CHUNK)
            self._buffer += chunk
            self._ended = not chunk
        line, found, rest = self._buffer.partition(b"\n")
        self._buffer = rest
        return line.decode(errors="replace").rstrip("\r") if found or line else None

    async def _wait_readable(self) -> None:
        loop = asyncio.get_running_loop()
        readable = asyncio.Event()
        try:
            loop.add_reader(self._descriptor, readable.set)
        except PermissionError:
            return  # an ordinary file, which is always readable
        try:
            await readable.wait()
        finally:
            loop.remove_reader(self._descriptor)
