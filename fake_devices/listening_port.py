"""One TCP port of a fake: it opens, serves its clients, and cuts their connections where it closes."""

import asyncio
import ssl
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import TypeAlias

ServeClient: TypeAlias = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class ListeningPort:
    """Calls ``serve`` for each client; a connection that ends is closed, whatever the reason."""

    def __init__(
        self, host: str, port: int, serve: ServeClient, *, tls: ssl.SSLContext | None = None
    ) -> None:
        self._host, self._port, self._serve, self._tls = host, port, serve, tls
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()

    async def open(self) -> None:
        """Listen, where nothing listens yet."""
        if self._server is None:
            self._server = await asyncio.start_server(
                self._serve_client, self._host, self._port, ssl=self._tls
            )

    def close(self) -> None:
        """Stop listening and cut every connection."""
        if self._server is not None:
            self._server.close()
            self._server = None
        self.cut_connections()

    def cut_connections(self) -> None:
        """Cut every connection; new clients are accepted."""
        for writer in tuple(self._writers):
            writer.transport.abort()

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        try:
            with suppress(OSError, asyncio.IncompleteReadError):
                await self._serve(reader, writer)
        finally:
            self._writers.discard(writer)
            writer.close()


class AwaitedPort(ABC):
    """A port whose users wait until its last connection has ended; port 0 finds a free one and keeps it."""

    def __init__(self, host: str, port: int) -> None:
        self.host, self.port = host, port
        self._server: asyncio.Server | None = None
        self._serving: set[asyncio.Task[None]] = set()

    @property
    def is_listening(self) -> bool:
        """Whether new clients are accepted."""
        return self._server is not None

    async def open(self) -> None:
        """Listen, where nothing listens yet."""
        if self._server is None:
            self._server = await asyncio.start_server(
                self._serve_noted, self.host, self.port, reuse_address=True
            )
            self.port = self._server.sockets[0].getsockname()[1]

    def close(self) -> None:
        """Stop listening and drop every connection."""
        if self._server is not None:
            self._server.close()
            self._server = None
        self.drop_connections()

    async def wait_closed(self) -> None:
        """Close, and wait until every connection has ended."""
        self.close()
        if self._serving:
            await asyncio.wait(self._serving)

    @abstractmethod
    def drop_connections(self) -> None:
        """Reset every connection; new clients are accepted while the port is open."""

    @abstractmethod
    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client until its connection ends."""

    async def _serve_noted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        if task is not None:
            self._serving.add(task)
            task.add_done_callback(self._serving.discard)
        await self._serve_client(reader, writer)
