"""One TCP port of a fake: it opens, serves its clients, and cuts their connections where it closes."""

import asyncio
import ssl
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Self, TypeAlias

ServeClient: TypeAlias = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


class ListeningPort:
    """Calls ``serve`` for each client; an async context. Port 0 finds a free one and keeps it.

    A connection that ends is closed, whatever the reason: one of a client that came while the port closed, and whose
    ``serve`` never began, as well.
    """

    def __init__(
        self,
        host: str,
        port: int,
        serve: ServeClient,
        *,
        tls: ssl.SSLContext | None = None,
        line_limit_bytes: int = 1 << 16,
    ) -> None:
        self.host, self.port = host, port
        self._serve, self._tls, self._line_limit_bytes = serve, tls, line_limit_bytes
        self._server: asyncio.Server | None = None
        self._connections: dict[asyncio.Task[None], asyncio.StreamWriter] = {}

    async def __aenter__(self) -> Self:
        await self.open()
        return self

    async def __aexit__(self, *_exc: object) -> None:
        await self.wait_closed()

    @property
    def is_listening(self) -> bool:
        """Whether new clients are accepted."""
        return self._server is not None

    @property
    def client_count(self) -> int:
        """The number of connected clients."""
        return len(self._connections)

    async def open(self) -> None:
        """Listen, where nothing listens yet; raise OSError when the address is taken."""
        if self.is_listening:
            return
        # Its sockets are known here before anything is waited for: a task that is cancelled leaves none behind.
        server = await asyncio.start_server(
            self._accept_client,
            self.host,
            self.port,
            limit=self._line_limit_bytes,
            ssl=self._tls,
            reuse_address=True,
            start_serving=False,
        )
        await self._serve_on(server)

    async def _serve_on(self, server: asyncio.Server) -> None:
        if self.is_listening:  # another task was quicker
            server.close()
            return
        self._server = server
        self.port = server.sockets[0].getsockname()[1]
        try:
            await server.start_serving()
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Stop listening and cut every connection."""
        if self._server is not None:
            self._server.close()
            self._server = None
        self.cut_connections()

    async def wait_closed(self) -> None:
        """Close, end what is being served, and wait until every connection has ended."""
        self.close()
        for task in self._connections:
            task.cancel()
        if self._connections:
            await asyncio.wait(self._connections)

    def cut_connections(self) -> None:
        """Reset every connection; new clients are accepted while the port is open."""
        for writer in tuple(self._connections.values()):
            writer.transport.abort()

    def cut_oldest_connection(self) -> None:
        """Reset the connection that was opened first; there must be one."""
        next(iter(self._connections.values())).transport.abort()

    def _accept_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Begin to serve a client; no coroutine: its writer is known before its task has run."""
        if self._server is None:
            writer.transport.abort()
            return
        task = asyncio.create_task(self._serve_until_closed(reader, writer))
        self._connections[task] = writer
        task.add_done_callback(self._end_connection)

    async def _serve_until_closed(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with suppress(OSError, asyncio.IncompleteReadError):
                await self._serve(reader, writer)
        finally:
            writer.close()
        with suppress(OSError):
            await writer.wait_closed()

    def _end_connection(self, task: asyncio.Task[None]) -> None:
        self._connections.pop(task).close()
        if not task.cancelled() and (error := task.exception()) is not None:
            task.get_loop().call_exception_handler({"message": "serving a client failed", "exception": error})
