"""A TCP relay that cuts its connections once, after a number of octets from the client."""

import asyncio
from contextlib import suppress


class CuttingProxy:
    """An async context; ``port`` is where it listens."""

    def __init__(self, host: str, port: int, cut_after: int) -> None:
        self._target, self._left = (host, port), cut_after
        self.was_cut = False
        self.port = 0
        self._writers: list[asyncio.StreamWriter] = []
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> "CuttingProxy":
        self._server = await asyncio.start_server(self._relay, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_exc: object) -> None:
        self._server.close()
        self._abort()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        with suppress(OSError):
            back, forth = await asyncio.open_connection(*self._target)
            self._writers += [writer, forth]
            await asyncio.gather(
                self._pump(reader, forth, counted=True), self._pump(back, writer, counted=False)
            )

    async def _pump(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter, *, counted: bool) -> None:
        with suppress(OSError):
            while octets := await source.read(4096):
                if counted and not self.was_cut:
                    if len(octets) > self._left:
                        self.was_cut = True
                        sink.write(octets[: self._left])
                        await sink.drain()
                        self._abort()
                        return
                    self._left -= len(octets)
                sink.write(octets)
                await sink.drain()
        sink.close()

    def _abort(self) -> None:
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()
