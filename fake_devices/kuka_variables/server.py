"""The variable server on TCP port 7000, in both personalities.

Imitates
    KUKAVARPROXY and C3 Bridge.
Source
    The C3 Bridge protocol description 1.5; the source of KUKAVARPROXY (VB6).
Modelled
    Types 0 and 1. KUKAVARPROXY answers an unknown variable with success and an empty value, ends with 00 01 and its
    flag; C3 Bridge with an error code and flag 0. Faults ``silent``, ``refuse``, ``reset``, ``split``, ``stale`` (an
    answer to an earlier tag first), ``short`` (lengths that do not fit).
Not modelled
    The other types; 10 clients at most; the idle limit of 30 s comes when a test asks for it (``drop_connection``).
"""

import asyncio
import struct
from contextlib import suppress

from cellcal.fake_devices.kuka_variables.variables import VariableTable
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.listening_port import ListeningPort

LINK_FAULTS = ("silent", "refuse", "reset", "split", "stale", "short")
_VERSION = "@PROXY_VERSION"


class ProxyPort(ListeningPort):
    """The port of the variable server."""

    def __init__(self, host: str, port: int, table: VariableTable, faults: LinkFaults) -> None:
        super().__init__(host, port, self._serve_requests)
        self._table, self._faults = table, faults
        self.is_c3 = True

    def drop_connection(self) -> None:
        """End every connection in good order, as KUKAVARPROXY does with clients that are silent for 30 s."""
        for writer in tuple(self._connections.values()):
            writer.close()

    async def _serve_requests(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        earlier: int | None = None
        with suppress(struct.error):
            while True:
                tag, length = struct.unpack(">HH", await reader.readexactly(4))
                await self._answer(tag, await reader.readexactly(length), writer, earlier)
                earlier = tag

    async def _answer(self, tag: int, body: bytes, writer: asyncio.StreamWriter, earlier: int | None) -> None:
        if self._faults.use_once("silent") is not None:
            return
        if self._faults.use_once("reset") is not None:
            writer.transport.abort()
            return
        kind, size = body[0], struct.unpack_from(">H", body, 1)[0]
        name = body[3 : 3 + size].decode("ascii", "replace")
        if kind == 1:
            value = body[5 + size : 5 + size + struct.unpack_from(">H", body, 3 + size)[0]].decode("ascii")
            text = value if self._table.write(name, value) else None
        else:
            text = self._read(name)
        frame = self._frame(tag, kind, text)
        if earlier is not None and self._faults.use_once("stale") is not None:
            frame = self._frame(earlier, kind, "stale") + frame
        if self._faults.use_once("short") is not None:
            frame = frame[:2] + struct.pack(">H", len(frame) - 5) + frame[4:-1]
        step = 1 if self._faults.active_parameters("split") is not None else len(frame)
        for k in range(0, len(frame), step):
            writer.write(frame[k : k + step])
            await writer.drain()

    def _read(self, name: str) -> str | None:
        if name == _VERSION and self.is_c3:
            return '"1.7.0"'
        return self._table.read(name)

    def _frame(self, tag: int, kind: int, text: str | None) -> bytes:
        value = (text or "").encode("ascii")
        if self.is_c3:
            end = b"\x00\x01\x01" if text is not None else b"\x00\x00\x00"
        else:
            end = b"\x00\x01\x01" if text is not None or kind == 0 else b"\x00\x01\x00"
        body = bytes([kind]) + struct.pack(">H", len(value)) + value + end
        return struct.pack(">HH", tag, len(body)) + body
