"""The web server: uvicorn, with connections accepted one at a time and kept within limits."""

import asyncio
import contextlib
import socket
from collections.abc import Sequence
from functools import partial
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from cellcal.calibration.errors import CellError
from cellcal.drivers.supervision import SUPERVISOR, start_task
from cellcal.service.web.connections import ServerConnection, ServerConnections, most_connections

_BACKLOG = 2048
_LONGEST_WORD = 4096  # bytes of what a screen may say, which is only whether its button is held
_LOOK_S = 1.0
_PAUSE_S = 0.05  # after an accept that failed where nothing could be given up
# Bytes that wait in the system for a slow receiver: of megabytes, a page shows the oldest first.
_UNSENT = 16 * 1024
_HANDSHAKE_S = 5.0
_HANDSHAKES = 64  # under way at once; the oldest gives way


class _CountedProtocol(H11Protocol):
    """HTTP/1.1 whose connection is known to the register."""

    connections_of_server: ServerConnections
    entry: ServerConnection

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)  # type: ignore[arg-type]
        address = self.client[0] if self.client else ""
        self.entry = self.connections_of_server.add_connection(address, self.transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self.connections_of_server.remove_connection(self.entry)
        super().connection_lost(exc)

    def handle_events(self) -> None:
        super().handle_events()
        busy = self.cycle is not None and not self.cycle.response_complete
        if busy and self.entry.state in ("new", "waiting"):
            self.connections_of_server.set_state(self.entry, "busy")

    def on_response_complete(self) -> None:
        self.connections_of_server.set_state(self.entry, "waiting")
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: Any) -> None:
        self.connections_of_server.set_state(self.entry, "screen")
        self.transport.set_write_buffer_limits(
            high=0
        )  # a message waits in its slot, where a newer one replaces it
        super().handle_websocket_upgrade(event)


class _ListeningHandle:
    """The handle that uvicorn closes at its end, in the place of asyncio's servers."""

    def __init__(self, sockets: Sequence[socket.socket], tasks: Sequence[asyncio.Task[None]]) -> None:
        self.sockets, self._tasks = sockets, tasks

    def close(self) -> None:
        """Accept nothing more."""
        for task in self._tasks:
            task.cancel()
        for listening in self.sockets:
            listening.close()

    async def wait_closed(self) -> None:
        """Wait for the tasks."""
        await asyncio.gather(*self._tasks, return_exceptions=True)


class WebServer(uvicorn.Server):
    """A server that a flood of connections, or a lack of descriptors, does not keep from hearing a stop."""

    def __init__(self, config: uvicorn.Config, most: int | None = None) -> None:
        config.ws_max_size = _LONGEST_WORD
        super().__init__(config)
        self.connections = ServerConnections(most_connections() if most is None else most)
        self._arriving: dict[asyncio.Task[None], None] = {}  # the oldest first

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the application, then listen."""
        listening = list(sockets or [bind_address(self.config.host, self.config.port)])
        await self.lifespan.startup()
        if self.lifespan.should_exit:
            self.should_exit = True
            return
        for each in listening:
            each.setblocking(False)
            each.listen(_BACKLOG)
        self.connections.open_spares()
        tasks = [
            start_task("web server: accepting", partial(self._accept_connections, each)) for each in listening
        ]
        tasks.append(start_task("web server: idle connections", self._close_stale_forever))
        self.servers = [_ListeningHandle(listening, tasks)]  # type: ignore[list-item]
        self.started = True

    async def _accept_connections(self, listening: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                arrived, _ = await loop.sock_accept(listening)
            except OSError as error:
                again = self.connections.on_accept_error(error)
                await asyncio.sleep(0.0 if again else _PAUSE_S)
                continue
            arriving = asyncio.create_task(self._serve_one(arrived))
            self._arriving[arriving] = None
            arriving.add_done_callback(self._on_accepted)
            if len(self._arriving) > _HANDSHAKES:
                next(iter(self._arriving)).cancel()
            await asyncio.sleep(0.0)  # what is closed to make room is let go before the next one is accepted

    async def _serve_one(self, arrived: socket.socket) -> None:
        tls = self.config.ssl
        limit_s = None if tls is None else _HANDSHAKE_S
        try:
            # Head and body are written one after the other: else the body waits 40 ms for the client to confirm the
            # head. The loop sets this itself only for sockets that were made with the protocol's number.
            arrived.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if hasattr(socket, "TCP_NOTSENT_LOWAT"):  # not every system has it
                arrived.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _UNSENT)
            await asyncio.get_running_loop().connect_accepted_socket(
                self._make_protocol, arrived, ssl=tls, ssl_handshake_timeout=limit_s
            )
        except (OSError, TimeoutError):
            arrived.close()  # gone again, or no TLS

    def _on_accepted(self, task: asyncio.Task[None]) -> None:
        self._arriving.pop(task, None)
        error = None if task.cancelled() else task.exception()
        if error is not None:
            SUPERVISOR.note_failure("web server: a connection", error, running=True)

    def _make_protocol(self) -> asyncio.Protocol:
        made = _CountedProtocol(
            config=self.config, server_state=self.server_state, app_state=self.lifespan.state
        )
        made.connections_of_server = self.connections
        return made

    async def _close_stale_forever(self) -> None:
        while True:
            await asyncio.sleep(_LOOK_S)
            self.connections.close_stale()


def bind_address(host: str, port: int) -> socket.socket:
    """Return a socket that is bound to an address, and does not listen yet.

    Raises
    ------
    CellError
        Another program uses it, or it is none of this computer.
    """
    bound = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((host, port))
    except (OSError, OverflowError, UnicodeError) as error:
        bound.close()
        why = error.strerror or error if isinstance(error, OSError) else error
        raise CellError(
            f"port {port} of {host} cannot be used: {str(why).rstrip('.')}.",
            remedy="Name another --port from 1024 to 65535 at an address of this computer, or end what uses it.",
            code="usage",
        ) from error
    return bound


def run_server(server: WebServer, listening: socket.socket) -> None:
    """Serve until interrupted.

    Raises
    ------
    CellError
        The service could not start.
    """
    with listening, contextlib.suppress(KeyboardInterrupt):
        server.run([listening])
        if not server.started:
            raise CellError(
                "the service could not start.", remedy="The lines above say why.", code="process.start"
            )
