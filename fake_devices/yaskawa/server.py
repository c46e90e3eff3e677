"""Both UDP ports: packets in, packets out, and everything a network can do to them in between.

Imitates
    Ports 10040 and 10041 of the controller.
Source
    As packets.py.
Modelled
    Link faults: ``silent``, ``refuse`` (nothing listens), ``cut`` (short answers), ``late`` (an answer after the
    next question), ``doubled``, ``foreign`` (another number), ``other_service``, ``lossy`` (each second answer
    is lost, though the order was obeyed), ``unnumbered`` (a file that fits one answer comes without block number, as
    moto-hses expects and sends it).
Not modelled
    Packets in pieces: the network puts them together.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import cast

from cellcal.fake_devices.link_faults import LinkFaults
from cellcal.fake_devices.yaskawa.commands import CommandTable
from cellcal.fake_devices.yaskawa.packets import (
    LAST_BLOCK,
    CommandRefusal,
    HostRequest,
    PacketError,
    build_answer,
    parse_request,
)

LINK_FAULTS = (
    "silent",
    "refuse",
    "cut",
    "late",
    "doubled",
    "foreign",
    "other_service",
    "lossy",
    "unnumbered",
)
_BLOCK = 400
_LOAD = 0x15
Sender = Callable[[bytes], None]


class RobotPort(asyncio.DatagramProtocol):
    """Port 10040."""

    def __init__(self, commands: CommandTable, faults: LinkFaults) -> None:
        self._commands, self._faults = commands, faults
        self._transport: asyncio.DatagramTransport | None = None
        self._answers = 0
        self._withheld: bytes | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(
            asyncio.DatagramTransport, transport
        )  # the loop's own class is not derived from it

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        if self._faults.use_once("silent") is not None:
            return
        with suppress(PacketError):
            self.take_request(parse_request(data), lambda octets: self._send(octets, addr))

    def take_request(self, request: HostRequest, send: Sender) -> None:
        """Answer one request."""
        if request.division != 1:
            return
        try:
            send(build_answer(request, self._commands.answer_command(request)))
        except CommandRefusal as refusal:
            send(build_answer(request, b"", status=refusal.status, added=refusal.added))

    def _send(self, octets: bytes, addr: tuple[str, int]) -> None:
        self._answers += 1
        if self._faults.active_parameters("lossy") is not None and self._answers % 2:
            return
        for packet in self._corrupt(octets):
            if self._transport is not None:
                self._transport.sendto(packet, addr)

    def _corrupt(self, octets: bytes) -> list[bytes]:
        if self._faults.use_once("late") is not None:
            earlier, self._withheld = self._withheld, octets
            return [] if earlier is None else [earlier]
        if self._faults.use_once("cut") is not None:
            return [octets[:20]]
        if self._faults.use_once("doubled") is not None:
            return [octets, octets]
        if self._faults.use_once("foreign") is not None:
            return [octets[:11] + bytes([octets[11] ^ 0x55]) + octets[12:]]
        if self._faults.use_once("other_service") is not None:
            return [octets[:24] + bytes([octets[24] ^ 0x0F]) + octets[25:]]
        return [octets]


class FilePort(RobotPort):
    """Port 10041: a file goes out block by block, each after the host's word that it has the one before."""

    def __init__(self, commands: CommandTable, faults: LinkFaults) -> None:
        super().__init__(commands, faults)
        self._content: list[bytes] = []
        self._upload: tuple[str, list[bytes]] | None = None  # name and blocks of a file that comes in

    def take_request(self, request: HostRequest, send: Sender) -> None:
        if request.division != 2:
            return
        if request.service == _LOAD:
            self._take_upload(request, send)
            return
        if request.confirms:
            block = request.block & ~LAST_BLOCK
            if block < len(self._content):
                self._send_block(request, block, send)
            return
        try:
            content = self._commands.read_file(request)
        except CommandRefusal as refusal:
            send(build_answer(request, b"", status=refusal.status, added=refusal.added))
            return
        self._content = [content[k : k + _BLOCK] for k in range(0, len(content), _BLOCK)] or [b""]
        self._send_block(request, 0, send)

    def _take_upload(self, request: HostRequest, send: Sender) -> None:
        """Take the name of a file, then its blocks; it is there when the last one has come."""
        try:
            self._commands.require_writable()
        except CommandRefusal as refusal:
            send(build_answer(request, b"", status=refusal.status, added=refusal.added))
            return
        if not request.confirms:
            self._upload = (request.data.partition(b"\0")[0].decode("ascii", "replace"), [])
        elif self._upload is not None:
            name, blocks = self._upload
            if request.block & ~LAST_BLOCK == len(blocks) + 1:
                blocks.append(request.data)
            if request.block & LAST_BLOCK:
                self._commands.store_job(name, b"".join(blocks))
                self._upload = None
        send(build_answer(request, b"", block=request.block))

    def _send_block(self, request: HostRequest, index: int, send: Sender) -> None:
        last = LAST_BLOCK if index + 1 == len(self._content) else 0
        alone = len(self._content) == 1 and self._faults.active_parameters("unnumbered") is not None
        send(build_answer(request, self._content[index], block=(0 if alone else index + 1) | last))


class HsesServer:
    """Both sockets of one controller."""

    def __init__(self, host: str, ports: tuple[int, int], commands: CommandTable, faults: LinkFaults) -> None:
        self._host, self._ports, self._commands, self._faults = host, ports, commands, faults
        self._transports: list[asyncio.DatagramTransport] = []

    async def open(self) -> None:
        """Bind both sockets, if they are not bound."""
        if self._transports:
            return
        loop = asyncio.get_running_loop()
        for kind, port in ((RobotPort, self._ports[0]), (FilePort, self._ports[1])):
            transport, _ = await loop.create_datagram_endpoint(
                lambda kind=kind: kind(self._commands, self._faults),  # type: ignore[misc]
                local_addr=(self._host, port),
            )
            self._transports.append(transport)

    def close(self) -> None:
        """Close both sockets."""
        for transport in self._transports:
            transport.close()
        self._transports = []
