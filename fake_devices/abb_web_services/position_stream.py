"""The position stream of Externally Guided Motion: EgmRobot messages over UDP.

Imitates
    A controller with option 689-1 that runs ``EGMSetupUC`` for joints and ``EGMStreamStart``.
Source
    egm.proto as abb-robot-client 0.4.0 carries it, compiled: field numbers and types.
Modelled
    header (seqno, tm, mtype DATA), feedBack and planned joints in degrees, clocks, motorState, rapidExecState,
    utilizationRate.
Not modelled
    Cartesian feedback, external axes, and guidance: what a client sends back is counted and moves nothing.
"""

import struct
from collections.abc import Sequence

_DATA = 2
_ON, _RUNNING = 1, 2
_UINT32 = 1 << 32


def encode_robot_message(count: int, real_s: float, joints_deg: Sequence[float]) -> bytes:
    """Return one EgmRobot message."""
    header = _encode_number(1, count) + _encode_number(2, int(real_s * 1000.0)) + _encode_number(3, _DATA)
    joints = _encode_message(1, b"".join(_encode_double(1, angle) for angle in joints_deg))
    clock = _encode_message(4, _encode_long(1, int(real_s)) + _encode_long(2, int(real_s * 1e6) % 1_000_000))
    states = (
        _encode_message(4, _encode_number(1, _ON))
        + _encode_message(8, _encode_number(1, _RUNNING))
        + _encode_double(10, 0.0)
    )
    return (
        _encode_message(1, header)
        + _encode_message(2, joints + clock)
        + _encode_message(3, joints + clock)
        + states
    )


def _encode_key(field: int, kind: int) -> bytes:
    return _encode_base128(field * 8 + kind)


def _encode_base128(value: int) -> bytes:
    octets = bytearray()
    while value > 127:
        octets.append(value % 128 + 128)
        value //= 128
    octets.append(value)
    return bytes(octets)


def _encode_number(field: int, value: int) -> bytes:
    return _encode_key(field, 0) + _encode_base128(value % _UINT32)


def _encode_long(field: int, value: int) -> bytes:
    return _encode_key(field, 0) + _encode_base128(value)


def _encode_double(field: int, value: float) -> bytes:
    return _encode_key(field, 1) + struct.pack("<d", value)


def _encode_message(field: int, content: bytes) -> bytes:
    return _encode_key(field, 2) + _encode_base128(len(content)) + content
