"""A link that falls silent: a proxy between a browser and the service that swallows what is sent, for a while.

As on a lost wireless link there is no notice: connections stay open, bytes do not arrive. What was sent meanwhile
is either never delivered (``late`` False: those connections stay dead), or all at once when the link is back, as TCP
does that tried again and again.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from cellcal.fake_devices.listening_port import ListeningPort


@dataclass
class SilentLink:
    """One proxy. `break_link` makes it silent, `mend_link` restores it."""

    target: int
    late: bool = False
    port: int = 0
    swallowed: int = 0  # bytes, towards the service
    _open: asyncio.Event = field(default_factory=asyncio.Event)

    def __post_init__(self) -> None:
        self._open.set()

    def break_link(self, *, late: bool) -> None:
        """Break the link; ``late``: what is sent meanwhile arrives when it is back."""
        self.late = late
        self.swallowed = 0
        self._open.clear()

    def mend_link(self) -> None:
        """Mend the link."""
        self._open.set()

    async def serve_connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Carry one connection."""
        lost = not self._open.is_set() and not self.late
        await self._open.wait()
        if lost:
            await self._discard_input(reader)
        else:
            await self._carry_both_ways(reader, writer)

    async def _discard_input(self, reader: asyncio.StreamReader) -> None:
        while data := await reader.read(65536):
            self.swallowed += len(data)

    async def _carry_both_ways(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        back, out = await asyncio.open_connection("127.0.0.1", self.target)
        try:
            await asyncio.gather(
                self._forward_bytes(reader, out, outwards=True), self._forward_bytes(back, writer)
            )
        finally:
            out.close()

    async def _forward_bytes(
        self, source: asyncio.StreamReader, sink: asyncio.StreamWriter, *, outwards: bool = False
    ) -> None:
        dead = False
        while data := await source.read(65536):
            if not self._open.is_set():
                self.swallowed += len(data) if outwards else 0
                dead = dead or not self.late
                await self._open.wait()
            if not dead:
                sink.write(data)
                await sink.drain()
        if not dead:
            sink.close()


@asynccontextmanager
async def open_silent_link(target: int) -> AsyncIterator[SilentLink]:
    """Open a proxy to a port of this computer."""
    link = SilentLink(target)
    async with ListeningPort("127.0.0.1", 0, link.serve_connection) as port:
        link.port = port.port
        yield link
