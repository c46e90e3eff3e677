"""A TCP relay that cuts its connections once, after a number of octets from the client."""

import asyncio
from contextlib import suppress

from cellcal.fake_devices.listening_port import ListeningPort


class CuttingProxy(ListeningPort):
    """An async context; ``port`` is where it listens."""

    def __init__(self, host: str, port: int, cut_after: int) -> None:
        super().__init__("127.0.0.1", 0, self._relay)
        self._target, self._remaining = (host, port), cut_after
        self.was_cut = False

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        back, forth = await asyncio.open_connection(*self._target)
        try:
            await asyncio.gather(
                self._pump(reader, forth, counted=True), self._pump(back, writer, counted=False)
            )
        finally:
            forth.transport.abort()

    async def _pump(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter, *, counted: bool) -> None:
        with suppress(OSError):
            while octets := await source.read(4096):
                if counted and not self.was_cut:
                    if len(octets) > self._remaining:
                        self.was_cut = True
                        sink.write(octets[: self._remaining])
                        await sink.drain()
                        self.cut_connections()
                        sink.transport.abort()
                        return
                    self._remaining -= len(octets)
                sink.write(octets)
                await sink.drain()
        sink.close()
