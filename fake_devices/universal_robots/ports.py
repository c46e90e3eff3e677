"""Listening ports whose cable can be pulled.

Imitates
    The network side of the control box.
Source
    README of this package: what the unmodified clients do when a link goes.
Modelled
    Several clients per port; packages dropped, never queued without bound, when a client reads too slowly;
    the three kinds of link loss: connections dropped, ports closed, silence on open sockets.
Not modelled
    The limit of clients per port.
"""

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress

_log = logging.getLogger(__name__)
_WRITE_LIMIT_BYTES = 64 * 1024


class TcpPort:
    """One TCP port and the clients on it."""

    def __init__(self, host: str, number: int, connect: Callable[["TcpPort"], "PortConnection"]) -> None:
        self.host, self.number = host, number
        self.connections: set[PortConnection] = set()
        self.stalled = False
        self.silent = False
        self._connect = connect
        self._server: asyncio.Server | None = None
        self._empty = asyncio.Event()
        self._empty.set()

    @property
    def is_open(self) -> bool:
        """Whether new clients can connect."""
        return self._server is not None

    async def open(self) -> None:
        """Listen; raise OSError when the address is taken."""
        if self._server is None:
            loop = asyncio.get_running_loop()
            self._server = await loop.create_server(lambda: self._connect(self), self.host, self.number)

    def drop_connections(self) -> None:
        """Cut every connection; the port stays open."""
        for connection in list(self.connections):
            connection.drop()

    async def close(self) -> None:
        """Stop listening and cut every connection."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
        self.drop_connections()
        await self._empty.wait()

    def add_connection(self, connection: "PortConnection") -> None:
        """Count a client in."""
        self.connections.add(connection)
        self._empty.clear()

    def remove_connection(self, connection: "PortConnection") -> None:
        """Count a client out."""
        self.connections.discard(connection)
        if not self.connections:
            self._empty.set()

    def stall_connections(self, *, on: bool) -> None:
        """Leave the sockets open without a byte in either direction, or let them send again."""
        self.stalled = on
        for connection in self.connections:
            connection.set_reading(on=not on)


class PortConnection(asyncio.Protocol):
    """One client. Subclasses say what is answered."""

    def __init__(self, port: TcpPort) -> None:
        self.port = port
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet, unless the cable is pulled."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self.port.add_connection(self)
        if self.port.stalled:
            self.set_reading(on=False)
        self.send_greeting()

    def connection_lost(self, _reason: Exception | None) -> None:
        """Forget the client."""
        self.port.remove_connection(self)
        self._transport = None
        self.on_disconnect()

    def data_received(self, data: bytes) -> None:
        """Pass on what arrived, unless this port plays dead."""
        if self.port.silent:
            return
        try:
            self.on_bytes(data)
        except ValueError as problem:
            _log.warning("port %d: %s; connection closed", self.port.number, problem)
            self.drop()

    def set_reading(self, *, on: bool) -> None:
        """Read from the socket or leave the bytes in the cable."""
        if self._transport is not None and not self._transport.is_closing():
            with suppress(RuntimeError):
                (self._transport.resume_reading if on else self._transport.pause_reading)()

    def send(self, data: bytes) -> bool:
        """Send, or drop the data when no client takes them; return whether they went out."""
        transport = self._transport
        if transport is None or transport.is_closing() or self.port.stalled or self.port.silent:
            return False
        if transport.get_write_buffer_size() > _WRITE_LIMIT_BYTES:
            return False
        transport.write(data)
        return True

    def finish(self) -> None:
        """Close after what was written has gone out."""
        if self._transport is not None:
            self._transport.close()

    def drop(self) -> None:
        """Cut the connection."""
        if self._transport is not None:
            self._transport.abort()

    def send_greeting(self) -> None:
        """Say what this port says first."""

    def on_disconnect(self) -> None:
        """Clean up after a client."""

    def on_bytes(self, data: bytes) -> None:
        """Handle bytes."""
