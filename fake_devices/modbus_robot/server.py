"""Modbus TCP on a socket: framing, connections, and everything a link can do wrong.

Imitates
    The Modbus TCP server of FANUC's HMI device option.
Source
    Modbus Application Protocol V1.1b3 and Modbus Messaging on TCP/IP V1.0b;
    deploy/controller_setup/fanuc_hmi.md (unit id ignored); public notes on $NUM_MODBUS (beyond it the
    oldest connection is dropped).
Modelled
    Function codes 1 to 6, 15, 16; exceptions 1 to 3; several telegrams in one read; the connection limit;
    the link faults of ``KINDS``.
Not modelled
    TLS, other function codes (exception 1), Modbus RTU.
"""

import asyncio
import socket
import struct
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol

from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.listening_port import ListeningPort

MAX_CONNECTIONS = 4
KINDS: dict[str, dict[str, Any]] = {
    "silent": {},  # swallows requests
    "lost_reply": {},  # obeys, then swallows the answer
    "slow": {"delay_s": 1.0},
    "late": {},  # an answer comes after the next request, under its own transaction id
    "late_same_tid": {},  # … under the transaction id of the next request
    "duplicate": {},  # every answer twice, in one segment
    "half_frames": {"pause_s": 0.02},
    "wrong_tid": {},
    "wrong_unit": {},
    "wrong_function": {},
    "wrong_protocol": {},
    "short_list": {},
    "exception": {"code": 4, "function": 0},
    "cut": {"bytes": 5},  # part of the answer, then the connection closes
    "act_then_cut": {},  # obeys a write, then the connection closes without an answer
    "reset": {},  # RST instead of an answer
    "refuse": {},  # no listener on the port
    "flap": {"period_s": 0.5},  # listens and refuses in turn
}


class HoldingRegisters(Protocol):
    """The registers that the server serves."""

    def read(self, address: int, count: int) -> list[int]: ...
    def write(self, address: int, values: list[int]) -> None: ...


class ModbusError(Exception):
    """An exception response."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


def answer_request(registers: HoldingRegisters, request: bytes) -> bytes:
    """Return the response PDU to a request PDU; raise ModbusError."""
    function = request[0]
    if function not in (1, 2, 3, 4, 5, 6, 15, 16):
        raise ModbusError(1)
    if len(request) < 5:
        raise ModbusError(3)
    address, second = struct.unpack(">HH", request[1:5])
    if function in (1, 2, 3, 4):
        return _read_response(registers, function, address, second)
    if function in (5, 15):
        return request[:5]
    return _write_response(registers, function, address, second, request)


def _read_response(registers: HoldingRegisters, function: int, address: int, count: int) -> bytes:
    limit = 125 if function in (3, 4) else 2000
    if not 1 <= count <= limit:
        raise ModbusError(3)
    if address + count > 0x10000:
        raise ModbusError(2)
    if function in (1, 2):
        return bytes([function, (count + 7) // 8]) + bytes((count + 7) // 8)
    words = registers.read(address + 1, count) if function == 3 else [0] * count
    return bytes([function, 2 * count]) + struct.pack(f">{count}H", *words)


def _write_response(
    registers: HoldingRegisters, function: int, address: int, second: int, request: bytes
) -> bytes:
    if function == 6:
        values = [second]
    else:
        if (
            len(request) < 6
            or not 1 <= second <= 123
            or request[5] != 2 * second
            or len(request) != 6 + 2 * second
        ):
            raise ModbusError(3)
        values = list(struct.unpack(f">{second}H", request[6:]))
    if address + len(values) > 0x10000:
        raise ModbusError(2)
    registers.write(address + 1, values)
    return request[:5]


def _is_write(request: bytes) -> bool:
    return request[0] in (5, 6, 15, 16)


class ModbusServer(ListeningPort):
    """Serves one register map on one address; closed while the controller has no power."""

    def __init__(
        self, host: str, port: int, reply: HoldingRegisters | Callable[[bytes], bytes], faults: LinkFaults
    ) -> None:
        """Serve registers, or whatever turns a request PDU into a response PDU or raises ModbusError."""
        super().__init__(host, port, self._serve_client)
        self.faults = faults
        self._reply = reply if callable(reply) else partial(answer_request, reply)
        self._late_response: bytes | None = None

    def close(self) -> None:
        super().close()
        self._late_response = None

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self.client_count > MAX_CONNECTIONS:
            self.cut_oldest_connection()
        sock: socket.socket = writer.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        await self._read_requests(reader, writer)

    async def _read_requests(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            head = await reader.readexactly(7)
            tid, protocol, length, unit = struct.unpack(">HHHB", head)
            if protocol != 0 or not 2 <= length <= 254:
                return
            request = await reader.readexactly(length - 1)
            if self.faults.use_once("silent") is not None:
                continue
            if self.faults.use_once("reset") is not None:
                reset_connection(writer)
                return
            response = self._respond_to(request)
            if not await self._send_response(writer, tid, unit, request, response):
                return

    def _respond_to(self, request: bytes) -> bytes:
        try:
            self._injected_exception(request)
            return self._reply(request)
        except ModbusError as error:
            return bytes([request[0] | 0x80, error.code])

    def _injected_exception(self, request: bytes) -> None:
        exception = self.faults.active_parameters("exception")
        if exception is not None and exception["function"] in (0, request[0]):
            self.faults.use_once("exception")
            raise ModbusError(int(exception["code"]))

    async def _send_response(
        self, writer: asyncio.StreamWriter, tid: int, unit: int, request: bytes, response: bytes
    ) -> bool:
        """Send one answer, or what a fault makes of it; return whether the connection stays open."""
        if self.faults.use_once("lost_reply") is not None:
            return True
        if _is_write(request) and self.faults.use_once("act_then_cut") is not None:
            return False
        if (slow := self.faults.use_once("slow")) is not None:
            await asyncio.sleep(float(slow["delay_s"]))
        frame = self._corrupted_frame(tid, unit, response)
        if frame is None:
            return True
        if (cut := self.faults.use_once("cut")) is not None:
            writer.write(frame[: int(cut["bytes"])])
            await writer.drain()
            return False
        if (half := self.faults.use_once("half_frames")) is not None:
            for k in range(0, len(frame), 5):
                writer.write(frame[k : k + 5])
                await writer.drain()
                await asyncio.sleep(float(half["pause_s"]) if k < 15 else 0.0)
            return True
        writer.write(frame)
        await writer.drain()
        return True

    def _corrupted_frame(self, tid: int, unit: int, response: bytes) -> bytes | None:
        """Return the bytes to send; None while an answer is held back."""
        if self.faults.use_once("late_same_tid") is not None:
            late_response, self._late_response = self._late_response, response
            return None if late_response is None else _tcp_frame(tid, unit, late_response)
        if self.faults.active_parameters("late") is not None:
            late_response, self._late_response = self._late_response, _tcp_frame(tid, unit, response)
            if late_response is None:
                return None
            self._late_response = None
            return late_response + _tcp_frame(tid, unit, response)
        self._late_response = None
        for kind, change in _CHANGES.items():
            if self.faults.use_once(kind) is not None:
                return change(tid, unit, response)
        return _tcp_frame(tid, unit, response)


def _tcp_frame(tid: int, unit: int, response: bytes, protocol: int = 0) -> bytes:
    return struct.pack(">HHHB", tid, protocol, len(response) + 1, unit) + response


def _wrong_function(response: bytes) -> bytes:
    return bytes([{3: 4, 4: 3, 6: 16, 16: 6}.get(response[0], response[0] ^ 1)]) + response[1:]


def _short_response(response: bytes) -> bytes:
    if response[0] not in (3, 4) or response[1] < 4:
        return response
    return bytes([response[0], response[1] - 2]) + response[2:-2]


_CHANGES: dict[str, Callable[[int, int, bytes], bytes]] = {
    "duplicate": lambda tid, unit, pdu: _tcp_frame(tid, unit, pdu) * 2,
    "wrong_tid": lambda tid, unit, pdu: _tcp_frame((tid + 1) & 0xFFFF, unit, pdu),
    "wrong_unit": lambda tid, unit, pdu: _tcp_frame(tid, (unit + 1) & 0xFF, pdu),
    "wrong_function": lambda tid, unit, pdu: _tcp_frame(tid, unit, _wrong_function(pdu)),
    "wrong_protocol": lambda tid, unit, pdu: _tcp_frame(tid, unit, pdu, protocol=0x1234),
    "short_list": lambda tid, unit, pdu: _tcp_frame(tid, unit, _short_response(pdu)),
}


def reset_connection(writer: asyncio.StreamWriter) -> None:
    """End a connection with RST instead of FIN."""
    sock: socket.socket = writer.get_extra_info("socket")
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


def link_faults(real: Any, more: Mapping[str, dict[str, Any]] | None = None) -> LinkFaults:
    """Return the faults this kind of link can show."""
    return LinkFaults({**KINDS, **(more or {})}, real)
