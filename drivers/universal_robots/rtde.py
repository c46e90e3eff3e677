"""Framing and names of RTDE, the controller's real-time data exchange.

Source: the maker's RTDE guide, protocol version 2. Messages are u16 size, u8 type, payload; big-endian, no
padding. TCP may cut and join them anywhere.
"""

import asyncio
import struct
from collections.abc import Callable
from enum import IntEnum

from cellcal.calibration.message import make_message

PORT = 30004
HEADER = struct.Struct(">HB")


class MessageType(IntEnum):
    """Types of RTDE messages that we use."""

    PROTOCOL = ord("V")
    VERSION = ord("v")
    OUTPUTS = ord("O")
    START = ord("S")
    DATA = ord("U")
    TEXT = ord("M")


class RuntimeState(IntEnum):
    """The state of the controller's program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


MODE_RUNNING = 7  # robot_mode: brakes released, program may move the arm


def pack_message(kind: MessageType, payload: bytes = b"") -> bytes:
    """Return one message as it goes over the wire."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


class RtdeLink(asyncio.Protocol):
    """Cuts the byte stream into messages.

    A protocol and not a StreamReader: packets are taken as they come in, before any timer of ours looks at
    their age, so a busy event loop is not mistaken for a silent robot.
    """

    def __init__(
        self, on_message: Callable[[int, bytes], None], on_lost: Callable[[Exception | None], None]
    ) -> None:
        self._on_message, self._on_lost = on_message, on_lost
        self._buffer = bytearray()
        self._transport: asyncio.BaseTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        while len(self._buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._buffer)
            if size < HEADER.size:
                self._refuse_stream(ValueError(make_message("a message of {size} bytes", size=size)))
                return
            if len(self._buffer) < size:
                return
            payload = bytes(self._buffer[HEADER.size : size])
            del self._buffer[:size]
            self._on_message(kind, payload)

    def connection_lost(self, exc: Exception | None) -> None:
        self._on_lost(exc)

    def _refuse_stream(self, error: ValueError) -> None:
        self._buffer.clear()
        self._on_lost(error)
        if isinstance(self._transport, asyncio.Transport):
            self._transport.abort()
