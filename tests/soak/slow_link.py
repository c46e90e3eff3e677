"""A slow wireless link: a proxy that carries so many bits a second, and each of them so much later.

It shapes everything that passes, WebSockets too, which a browser's own throttling leaves alone. All connections share
one rate each way, in turns of one packet; a new connection waits for the handshake's way there and back. Not
modelled: loss, and TCP's slow start (20 kB are under way on 4 Mbit/s over 40 ms; TCP begins with 15).
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from cellcal.fake_devices.listening_port import ListeningPort

_PACKET = 1460  # bytes


@dataclass
class _LinkDirection:
    """One direction, which all connections share."""

    rate_byte_s: float
    byte_count: int = 0
    _turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    _free_s: float = 0.0

    async def wait_for_transfer(self, size: int) -> float:
        """Wait until so many bytes have left; return when the last one did (the loop's time) [s]."""
        clock = asyncio.get_running_loop()
        async with self._turn:
            self._free_s = max(self._free_s, clock.time()) + size / self.rate_byte_s
            await asyncio.sleep(self._free_s - clock.time())
            self.byte_count += size
            return self._free_s


@dataclass
class SlowLink:
    """A proxy to a port of this computer. ``delay_s`` is of one way."""

    target: int
    rate_bit_s: float
    delay_s: float

    def __post_init__(self) -> None:
        self._out, self._back = (_LinkDirection(self.rate_bit_s / 8.0) for _ in range(2))

    @property
    def carried_bytes(self) -> int:
        """Bytes that went either way."""
        return self._out.byte_count + self._back.byte_count

    async def serve_connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Carry one connection."""
        await asyncio.sleep(2.0 * self.delay_s)
        answers, upstream_writer = await asyncio.open_connection("127.0.0.1", self.target)
        try:
            await asyncio.gather(
                self._carry_bytes(reader, upstream_writer, self._out),
                self._carry_bytes(answers, writer, self._back),
            )
        finally:
            upstream_writer.close()

    async def _carry_bytes(
        self, source: asyncio.StreamReader, sink: asyncio.StreamWriter, way: _LinkDirection
    ) -> None:
        under_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        arriving = asyncio.create_task(self._deliver_bytes(under_way, sink))
        try:
            data = b" "
            while data:
                data = await source.read(_PACKET)
                await under_way.put((await way.wait_for_transfer(len(data)) + self.delay_s, data))
            await arriving
        finally:
            arriving.cancel()

    async def _deliver_bytes(
        self, under_way: asyncio.Queue[tuple[float, bytes]], sink: asyncio.StreamWriter
    ) -> None:
        clock = asyncio.get_running_loop()
        with contextlib.suppress(OSError):
            while True:
                at_s, data = await under_way.get()
                await asyncio.sleep(at_s - clock.time())
                if not data:
                    break
                sink.write(data)
                await sink.drain()
            sink.close()


@asynccontextmanager
async def slow_link_to(target: int, *, rate_bit_s: float, delay_s: float) -> AsyncIterator[SlowLink]:
    """Open such a link."""
    link = SlowLink(target, rate_bit_s, delay_s)
    async with ListeningPort("127.0.0.1", 0, link.serve_connection) as port:
        link.port = port.port
        yield link
