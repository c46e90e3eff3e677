"""Datagrams of Externally Guided Motion: the few fields that joint feedback needs.

EGM packs its messages with Protocol Buffers (egm.proto, which ABB ships with RobotWare). Read are, by field numbers:
EgmRobot.header (1) with seqno (1), tm (2, milliseconds) and mtype (3, 2 is data); EgmRobot.feedBack (2) with
joints (1), whose joints (1) are doubles in degrees. Fields that are not known are passed over by their wire type.
"""

import math
import struct
from collections.abc import Iterator
from typing import TypeVar

from cellcal.drivers.wire.joint_stream import StreamPacket

AXES = 6
_MOST_OCTETS = 2048
_MOST_VARINT = 10  # octets
_MOST_DEG = 1e4
_VARINT, _EIGHT, _COUNTED, _FOUR = 0, 1, 2, 5
_DATA = 2
_MOST_COUNT = 2**32 - 1  # seqno and tm are of 32 bits
Value = int | bytes
T = TypeVar("T", int, bytes)


def read_robot_packet(data: bytes) -> StreamPacket:
    """Return sequence, time and joints of an EgmRobot message.

    Raises
    ------
    ValueError
        The octets are no such message, or lack what is needed; a code says why, for the log.
    """
    if len(data) > _MOST_OCTETS:
        raise ValueError("datagram.too_long")
    message = _fields(data)
    header = _fields(_only(message, 1, bytes))
    if _only(header, 3, int) != _DATA:
        raise ValueError("datagram.no_robot_data")
    feedback = _fields(_only(message, 2, bytes))
    angles = _doubles(_fields(_only(feedback, 1, bytes)).get(1, []))
    if len(angles) != AXES:
        raise ValueError("datagram.not_six_joints")
    if not all(math.isfinite(angle) and abs(angle) <= _MOST_DEG for angle in angles):
        raise ValueError("datagram.joint_out_of_range")
    sequence, sent_at_ms = _only(header, 1, int), _only(header, 2, int)
    if max(sequence, sent_at_ms) > _MOST_COUNT:
        raise ValueError("datagram.count_out_of_range")
    return StreamPacket(sequence, sent_at_ms / 1000.0, tuple(map(math.radians, angles)))


def _fields(data: bytes) -> dict[int, list[Value]]:
    found: dict[int, list[Value]] = {}
    for number, value in _walk(data):
        found.setdefault(number, []).append(value)
    return found


def _walk(data: bytes) -> Iterator[tuple[int, Value]]:
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        number, kind = key >> 3, key & 7
        if not number:
            raise ValueError("datagram.field_without_number")
        value: Value
        if kind == _VARINT:
            value, at = _varint(data, at)
        else:
            length, at = _length_of(data, at, kind)
            value = data[at : at + length]
            if len(value) != length:
                raise ValueError("datagram.ends_too_soon")
            at += length
        yield number, value


def _length_of(data: bytes, at: int, kind: int) -> tuple[int, int]:
    if kind == _COUNTED:
        return _varint(data, at)
    if kind in (_EIGHT, _FOUR):
        return (8 if kind == _EIGHT else 4), at
    raise ValueError("datagram.unknown_wire_type")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for place, octet in enumerate(data[at : at + _MOST_VARINT]):
        value |= (octet & 0x7F) << (7 * place)
        if octet < 0x80:
            return value, at + place + 1
    raise ValueError("datagram.endless_number")


def _only(fields: dict[int, list[Value]], number: int, kind: type[T]) -> T:
    values = fields.get(number, [])
    if len(values) != 1 or not isinstance(values[0], kind):
        raise ValueError("datagram.field_missing_or_doubled")
    return values[0]


def _doubles(values: list[Value]) -> list[float]:
    """Return repeated doubles, packed or one by one."""
    octets = b"".join(value if isinstance(value, bytes) else b"?" for value in values)
    if len(octets) % 8:
        raise ValueError("datagram.joints_not_doubles")
    return list(struct.unpack(f"<{len(octets) // 8}d", octets))
