"""Both TCP ports: the first names the second, the second serves one client.

Imitates
    Port 16001 and the port that it names.
Source
    FANUC B-84184EN/03; a second client as measured on a CRX (airo-fanuc): only the first port answers it.
Modelled
    Packets that share a segment; link faults ``silent``, ``refuse``, ``reset``, ``garbage``, ``split`` (octet by
    octet), ``unasked`` (a packet of its own accord before each reply).
Not modelled
    The idle limit of 60 minutes.
"""

import asyncio
import json
from contextlib import suppress
from typing import Any

from cellcal.fake_devices.fanuc_rmi.controller import RmiController
from cellcal.fake_devices.fanuc_rmi.packets import PacketTable, parse_packet
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.listening_port import ListeningPort

LINK_FAULTS = ("silent", "refuse", "reset", "garbage", "split", "unasked")
_TICK_REAL_S = 0.005


class RmiServer:
    """Both ports of one controller."""

    def __init__(
        self, host: str, ports: tuple[int, int], controller: RmiController, faults: LinkFaults
    ) -> None:
        self._second_port, self._faults = ports[1], faults
        self.controller, self._table = controller, PacketTable(controller)
        self._first = ListeningPort(host, ports[0], self._serve_first)
        self._second = ListeningPort(host, ports[1], self._serve_second)
        self._client: asyncio.StreamWriter | None = None

    async def open(self) -> None:
        """Listen at both ports, where nothing listens yet."""
        await self._first.open()
        await self._second.open()

    def close(self) -> None:
        """Stop listening and hang up."""
        self._first.close()
        self._second.close()

    def drop_connection(self) -> None:
        """Cut every connection."""
        self._first.cut_connections()
        self._second.cut_connections()

    async def follow_motions(self) -> None:
        """Run the queue and send the replies of what has ended."""
        while True:
            ended = self.controller.advance()
            if ended is not None:
                reply = {"Instruction": ended.name, "ErrorID": 0, "SequenceID": ended.sequence_id}
                if self._client is not None and ended.client is self._client:
                    await self._send(self._client, reply)
            await asyncio.sleep(_TICK_REAL_S)

    async def push_packet(self, packet: dict[str, Any]) -> None:
        """Send a packet of its own accord."""
        if self._client is not None:
            await self._send(self._client, packet)

    async def _serve_first(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        fields = parse_packet(await reader.readuntil(b"\r\n")) or {}
        if fields.get("Communication") in ("FRC_Connect", "FRC_Connect_STMO"):
            reply = {"Communication": fields["Communication"], "ErrorID": 0}
            reply |= {"PortNumber": self._second_port, "MajorVersion": 7, "MinorVersion": 0}
            await self._send(writer, reply)

    async def _serve_second(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._client is not None and not self._client.is_closing():
            with suppress(OSError):
                await reader.read()  # it is never answered
        self._client = writer
        try:
            while await self._serve_packet(await reader.readuntil(b"\r\n"), writer):
                pass
        finally:
            if self._client is writer:
                self._client = None

    async def _serve_packet(self, line: bytes, writer: asyncio.StreamWriter) -> bool:
        """Answer one packet; return whether the connection stays."""
        fields = parse_packet(line)
        if self._faults.use_once("silent") is not None:
            return True
        if fields is None:
            await self._send(writer, {"Command": "Unknown", "ErrorID": 2_556_928 + 22})
        elif fields.get("Communication") == "FRC_Disconnect":
            await self._send(writer, {"Communication": "FRC_Disconnect", "ErrorID": 0})
            return False
        elif "Instruction" in fields:
            refusal = self._table.take_instruction(fields, writer)
            if refusal is not None:
                await self._send(writer, refusal)
        else:
            await self._send(writer, self._table.answer_command(fields))
        return True

    async def _send(self, writer: asyncio.StreamWriter, packet: dict[str, Any]) -> None:
        octets = json.dumps(packet).encode() + b"\r\n"
        if self._faults.use_once("garbage") is not None:
            octets = b"{not json}\r\n"
        if self._faults.active_parameters("unasked") is not None:
            octets = b'{"Communication":"FRC_AsbnReady"}\r\n' + octets
        if self._faults.use_once("reset") is not None:
            writer.transport.abort()
            return
        pieces = [octets]
        if self._faults.active_parameters("split") is not None:
            pieces = [octets[k : k + 1] for k in range(len(octets))]
        with suppress(OSError):
            for piece in pieces:
                writer.write(piece)
                await writer.drain()
