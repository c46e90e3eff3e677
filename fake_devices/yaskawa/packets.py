"""Packets of the High Speed Ethernet Server, seen from the controller.

Imitates
    The UDP service of an FS100, DX200 or YRC1000 on ports 10040 (robot) and 10041 (files).
Source
    Yaskawa 160766-1CD as the clients fs100 (hsinkoyu), moto-hses and yrcom lay it out.
Modelled
    Request header, answer header with the added status in octets 26 and 28; blocks of a file.
Not modelled
    Requests in several blocks: no order that is played needs more than 479 octets.
"""

import struct
from dataclasses import dataclass

_REQUEST = struct.Struct("<4s2HBBBBI8sHHBBH")
LAST_BLOCK = 1 << 31


class PacketError(ValueError):
    """These octets are no request."""


class CommandRefusal(Exception):  # noqa: N818 - an answer, no fault of the program
    """The controller says no: a status octet, and an added word where the octet is 1F."""

    def __init__(self, status: int, added: int = 0) -> None:
        super().__init__(f"{status:02X} {added:04X}")
        self.status, self.added = status, added


@dataclass(frozen=True)
class HostRequest:
    """A request of a host."""

    division: int
    confirms: bool  # an acknowledgement of a block
    number: int
    block: int
    command: int
    instance: int
    attribute: int
    service: int
    data: bytes


def parse_request(octets: bytes) -> HostRequest:
    """Take a packet apart."""
    if len(octets) < _REQUEST.size:
        raise PacketError("too short")
    magic, header, size, _, division, ack, number, block, _, command, instance, attribute, service, _ = (
        _REQUEST.unpack_from(octets)
    )
    if magic != b"YERC" or header != _REQUEST.size or len(octets) != header + size:
        raise PacketError("not a packet of this service")
    return HostRequest(
        division, ack == 1, number, block, command, instance, attribute, service, octets[header:]
    )


def build_answer(
    request: HostRequest, data: bytes, *, block: int = LAST_BLOCK, status: int = 0, added: int = 0
) -> bytes:
    """Return the octets of an answer."""
    head = struct.pack(
        "<4s2HBBBBI8s", b"YERC", 0x20, len(data), 3, request.division, 1, request.number, block, b"99999999"
    )
    words = 1 if status == 0x1F else 0
    tail = struct.pack("<BBBBHH", request.service | 0x80, status, words, 0, added if words else 0, 0)
    return head + tail + data
