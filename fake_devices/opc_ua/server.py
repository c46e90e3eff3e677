"""The server on TCP port 4840, and how its link fails.

Imitates
    The OPC UA server of a robot controller.
Source
    OPC 10000-6, chapter 7 (UA TCP).
Modelled
    Faults of the link: ``silent``, ``refuse``, ``reset``, ``half`` (an answer in pieces). A restart ends all
    connections and sessions; the address space may come back in another order.
Not modelled
    See session.py.
"""

import asyncio
import logging
import struct

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import header_from_binary
from cryptography.exceptions import InvalidSignature

from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.listening_port import ListeningPort
from cellcal.fake_devices.opc_ua.node_table import NodeTable
from cellcal.fake_devices.opc_ua.server_guard import ServerGuard
from cellcal.fake_devices.opc_ua.session import ClientConnection, ServerState

LINK_FAULTS = ("silent", "refuse", "reset", "half")
_LARGEST_MESSAGE = 1 << 20
logging.getLogger("asyncua").setLevel(logging.CRITICAL + 1)  # a client that hangs up is no news here


class OpcUaPort(ListeningPort):
    """The port of the server."""

    def __init__(
        self, host: str, port: int, table: NodeTable, faults: LinkFaults, guard: ServerGuard | None = None
    ) -> None:
        super().__init__(host, port, self._serve_messages)
        self._endpoint, self._faults, self._guard = f"opc.tcp://{host}:{port}/", faults, guard
        self.state = ServerState(table, self._endpoint, guard)

    def restart(self, table: NodeTable) -> None:
        """Come back with these nodes; no session is known any more."""
        self.state = ServerState(table, self._endpoint, self._guard)
        self.cut_connections()

    async def _serve_messages(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connection = ClientConnection(self.state)
        while True:
            head = await reader.readexactly(8)
            size = struct.unpack("<I", head[4:])[0]
            if not 8 < size <= _LARGEST_MESSAGE:
                return
            message = Buffer(head + await reader.readexactly(size - 8))
            try:
                answer = connection.answer(header_from_binary(message), message)
            except (ua.UaError, InvalidSignature, ValueError):  # not encrypted or signed as it must be
                answer = None
            if answer is None or self._faults.use_once("reset") is not None:
                writer.transport.abort()
                return
            if self._faults.use_once("silent") is None:
                await self._send(answer, writer)

    async def _send(self, answer: bytes, writer: asyncio.StreamWriter) -> None:
        step = 7 if self._faults.active_parameters("half") is not None else max(1, len(answer))
        for k in range(0, len(answer), step):
            writer.write(answer[k : k + step])
            await writer.drain()
