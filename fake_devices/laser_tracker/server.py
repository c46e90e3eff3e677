"""TCP port 700 of an emScon server, and everything that can go wrong on the way.

Imitates
    The emScon server's socket.
Source
    ES_C_API_Def.h: size and type first. The rest is what any TCP stream may do.
Modelled
    Several clients: answers go to who asked, results and events to all. Packets cut in two, cut short, with a wrong
    size or type, garbage, doubled and late answers, events between all answers, silence, a lost connection.
Not modelled
    The limit on clients of some firmwares.
"""

import asyncio
import struct
from collections.abc import Callable
from typing import Any

from cellcal.fake_devices.laser_tracker import layout as at
from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.listening_port import ListeningPort

KINDS: dict[str, dict[str, Any]] = {
    "silent": {},
    "slow": {"delay_s": 0.5},
    "refuse": {},
    "half_packets": {"delay_s": 0.02},
    "truncated": {"bytes": 10},
    "wrong_size": {"by": 4},
    "wrong_type": {"type": 77},
    "garbage": {"bytes": 40},
    "duplicate": {},
    "events": {"count_each": 3},
    "lost_result": {},
    "foreign_answer": {},
    "foreign_result": {},
}
_RESULTS = (at.DT_SINGLE, at.DT_SINGLE2, at.DT_PROBE)
_EVENTS = (at.SSC_ENVIRONMENT, at.SSC_SETTINGS, 853, 4)
_LONGEST_BYTES = 65_536


class TrackerServer(ListeningPort):
    """Frames bytes; knows no meaning but size, type and command."""

    def __init__(self, host: str, port: int, faults: LinkFaults) -> None:
        super().__init__(host, port, self._serve_client)
        self._faults = faults
        self.on_packet: Callable[[bytes, Callable[[bytes], None]], None] = lambda _data, _reply: None
        self._sending: set[asyncio.Task[None]] = set()
        self._last_result = b""

    async def wait_closed(self) -> None:
        """Close, and wait until every connection and every delayed answer has ended."""
        for task in self._sending:
            task.cancel()
        await super().wait_closed()
        if self._sending:
            await asyncio.wait(self._sending)

    def broadcast(self, data: bytes) -> None:
        """Send to all clients."""
        kind = struct.unpack_from("<I", data, 4)[0]
        if kind in _RESULTS:
            if self._faults.use_once("lost_result") is not None:
                return
            self._last_result = data
        for writer in tuple(self._connections.values()):
            self._send_bytes(writer, data)

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._faults.active_parameters("refuse") is not None:
            writer.transport.abort()
            return
        await self._read_packets(reader, writer)

    async def _read_packets(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            head = await reader.readexactly(at.HEADER_BYTES)
            size = struct.unpack_from("<i", head)[0]
            if not at.HEADER_BYTES + 4 <= size <= _LONGEST_BYTES:
                return
            data = head + await reader.readexactly(size - at.HEADER_BYTES)
            if self._faults.use_once("silent") is None:
                self.on_packet(data, lambda answer: self._send_reply(writer, answer))

    def _send_reply(self, writer: asyncio.StreamWriter, answer: bytes) -> None:
        if (events := self._faults.active_parameters("events")) is not None:
            for i in range(int(events["count_each"])):
                self._send_bytes(writer, at.status_change(_EVENTS[i % len(_EVENTS)]))
        if self._faults.active_parameters("foreign_result") is not None and self._last_result:
            self._send_bytes(writer, self._last_result)
        if self._faults.use_once("foreign_answer") is not None:
            self._send_bytes(writer, at.make_reply(at.C_BIRD_BATH, at.RS_OK))
        self._send_bytes(writer, answer)
        if self._faults.use_once("duplicate") is not None:
            self._send_bytes(writer, answer)

    def _send_bytes(self, writer: asyncio.StreamWriter, data: bytes) -> None:
        data = self._corrupt_packet(data)
        slow, halves = self._faults.use_once("slow"), self._faults.use_once("half_packets")
        if slow is None and halves is None and not self._sending:
            if not writer.transport.is_closing():
                writer.write(data)
            return
        pieces = [(0.0, data)] if halves is None else [(0.0, data[:5]), (float(halves["delay_s"]), data[5:])]
        if slow is not None:
            pieces[0] = (float(slow["delay_s"]), pieces[0][1])
        before = set(self._sending)
        task = asyncio.create_task(_send_later(writer, pieces, before))
        self._sending.add(task)
        task.add_done_callback(self._sending.discard)

    def _corrupt_packet(self, data: bytes) -> bytes:
        size, kind = struct.unpack_from("<iI", data)
        if (cut := self._faults.use_once("truncated")) is not None:
            return data[: int(cut["bytes"])]
        if (wrong := self._faults.use_once("wrong_size")) is not None:
            return struct.pack("<iI", size + int(wrong["by"]), kind) + data[8:]
        if (wrong := self._faults.use_once("wrong_type")) is not None:
            return struct.pack("<iI", size, int(wrong["type"])) + data[8:]
        if (garbage := self._faults.use_once("garbage")) is not None:
            return bytes((37 * i + 201) % 256 for i in range(int(garbage["bytes"]))) + data
        return data


async def _send_later(
    writer: asyncio.StreamWriter, pieces: list[tuple[float, bytes]], before: set[asyncio.Task[None]]
) -> None:
    """Send in the order of asking, whatever each piece waits for."""
    if before:
        await asyncio.wait(before)
    for delay_s, piece in pieces:
        await asyncio.sleep(delay_s)
        if not writer.transport.is_closing():
            writer.write(piece)
