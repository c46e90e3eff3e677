"""Frames of the High Speed Ethernet Server: 32 octets of header, up to 479 of data, little endian.

Source: Yaskawa HW1483358 and 160766-1CD (ethernet function manuals) as three independent clients read them
(fs100 of hsinkoyu, moto-hses, YHSES); the status octet is octet 25, see README.
"""

import struct
from dataclasses import dataclass

from cellcal.calibration.message import make_message

ROBOT_PORT, FILE_PORT = 10040, 10041
ROBOT_DIVISION, FILE_DIVISION = 1, 2
LAST_BLOCK = 0x8000_0000
MOST_DATA = 479
_HEADER = struct.Struct("<4sHHBBBBI8s")
_REQUEST, _ANSWER = struct.Struct("<HHBBH"), struct.Struct("<BBBBHH")
_SIZE = _HEADER.size + _REQUEST.size
_MAGIC, _RESERVED = b"YERC", b"99999999"


@dataclass(frozen=True, slots=True)
class HsesRequest:
    """One question or order. ``repeatable``: sent twice it does no more than sent once."""

    command: int
    instance: int
    attribute: int
    service: int
    data: bytes = b""
    division: int = ROBOT_DIVISION
    repeatable: bool = True

    def to_frame(self, request_id: int, *, block: int = 0, acknowledges: bool = False) -> bytes:
        """Return the octets of the request, or of the acknowledgement of a block of a file."""
        head = _HEADER.pack(
            _MAGIC, _SIZE, len(self.data), 3, self.division, int(acknowledges), request_id, block, _RESERVED
        )
        return head + _REQUEST.pack(self.command, self.instance, self.attribute, self.service, 0) + self.data


@dataclass(frozen=True, slots=True)
class HsesAnswer:
    """One answer as it was sent; ``added_status`` is 0 where the controller added none."""

    request_id: int
    block: int
    service: int
    status: int
    added_status: int
    data: bytes

    @property
    def ends_file(self) -> bool:
        """Whether no further block follows."""
        return bool(self.block & LAST_BLOCK)

    def answers(self, request: HsesRequest, request_id: int) -> bool:
        """Whether this is the answer to a request, not a late one to an earlier."""
        return self.request_id == request_id and self.service == request.service | 0x80


def read_answer(frame: bytes, division: int) -> HsesAnswer:
    """Take an answer apart.

    Raises
    ------
    ValueError
        It is no whole answer of this division.
    """
    if len(frame) < _SIZE:
        raise ValueError(
            make_message(
                "an answer of {frame_count} octets is shorter than its header", frame_count=len(frame)
            )
        )
    magic, size, data_size, _, from_division, acknowledges, request_id, block, _ = _HEADER.unpack_from(frame)
    if magic != _MAGIC or size != _SIZE or acknowledges != 1 or from_division != division:
        raise ValueError("the header is not one of the High Speed Ethernet Server")
    if len(frame) != _SIZE + data_size:
        raise ValueError(
            make_message(
                "{data_size} octets of data are announced and {frame_count} came",
                data_size=data_size,
                frame_count=len(frame) - _SIZE,
            )
        )
    if data_size > MOST_DATA:
        raise ValueError(
            make_message(
                "{data_size} octets of data are more than an answer holds ({most_data})",
                data_size=data_size,
                most_data=MOST_DATA,
            )
        )
    service, status, added_words, _, added, _ = _ANSWER.unpack_from(frame, _HEADER.size)
    return HsesAnswer(request_id, block, service, status, added if added_words else 0, frame[_SIZE:])
