"""The arm's own kinematics, measured by the maker at the factory, from the controller's primary interface.

Source: the maker's description of the primary client interface (port 30001): packets of i32 length and u8
type; type 16 holds sub-packages of u32 length and u8 type; sub-package 5 holds checksums, theta, a, d, alpha.
The numbers are absolute, not differences to the nominal arm. d of the parallel joints may be hundreds of
metres that cancel: see cellcal.calibration.arm.ur_factory before using them as they are.
"""

import asyncio
import contextlib
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import DhTable
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import UnreachableError, WireProtocolError
from cellcal.drivers.universal_robots.state import CABLE, Six

PORT = 30001
_PACKET = struct.Struct(">iB")
_SUB_PACKET = struct.Struct(">IB")
_KINEMATICS = struct.Struct(">6I6d6d6d6dI")
_ROBOT_STATE = 16
_KINEMATICS_INFO = 5
_LONGEST_PACKET = 1 << 16
_HEX_SHOWN = 48


@dataclass(frozen=True, slots=True)
class FactoryKinematics:
    """DH parameters as the controller uses them: Rz(theta + q) Tz(d) Tx(a) Rx(alpha), joint by joint."""

    theta_rad: Six
    a_m: Six
    d_m: Six
    alpha_rad: Six
    checksums: tuple[int, int, int, int, int, int]
    status: int  # 0 not initialised, 1 not linearised, 2 linearised

    def to_table(self) -> DhTable:
        """Return the table for cellcal.calibration.arm.ur_factory.factory_model."""
        return DhTable.from_rows(np.array([self.theta_rad, self.d_m, self.a_m, self.alpha_rad]).T)


async def read_factory_kinematics(device: str, address: str, *, deadline_s: float) -> FactoryKinematics:
    """Connect to the primary interface and take the first kinematics it sends; change nothing."""
    try:
        async with asyncio.timeout(deadline_s):
            reader, writer = await asyncio.open_connection(address, PORT)
            try:
                return await _first_kinematics(device, reader)
            finally:
                writer.transport.abort()
                with contextlib.suppress(OSError):
                    await writer.wait_closed()
    except TimeoutError:
        what = make_message("sent no factory calibration within {deadline_s:g} s", deadline_s=deadline_s)
    except (OSError, EOFError) as error:
        what = make_message("cannot be reached ({error})", error=error)
    raise UnreachableError(
        device,
        make_message("the primary interface of {address} {what}.", address=address, what=what),
        remedy=CABLE,
    )


async def _first_kinematics(device: str, reader: asyncio.StreamReader) -> FactoryKinematics:
    while True:
        header = await reader.readexactly(_PACKET.size)
        size, kind = _PACKET.unpack(header)
        if not _PACKET.size <= size <= _LONGEST_PACKET:
            raise _unreadable_error(device, make_message("a packet of {size} bytes", size=size), header)
        body = await reader.readexactly(size - _PACKET.size)
        if kind == _ROBOT_STATE:
            for sub_kind, data in sub_packages(device, body):
                if sub_kind == _KINEMATICS_INFO:
                    return decode_kinematics(device, data)


def sub_packages(device: str, body: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (type, data) of the sub-packages of a robot state packet."""
    start = 0
    while start < len(body):
        if len(body) - start < _SUB_PACKET.size:
            raise _unreadable_error(device, "half a sub-package", body[start:])
        size, kind = _SUB_PACKET.unpack_from(body, start)
        if not _SUB_PACKET.size <= size <= len(body) - start:
            raise _unreadable_error(
                device, make_message("a sub-package of {size} bytes", size=size), body[start:]
            )
        yield kind, body[start + _SUB_PACKET.size : start + size]
        start += size


def decode_kinematics(device: str, data: bytes) -> FactoryKinematics:
    """Read the kinematics sub-package."""
    if len(data) != _KINEMATICS.size:
        raise _unreadable_error(
            device, make_message("kinematics of {data_count} bytes", data_count=len(data)), data
        )
    values = _KINEMATICS.unpack(data)
    if not all(map(math.isfinite, values[6:30])):
        raise _unreadable_error(device, "kinematics that are not numbers", data)
    return FactoryKinematics(
        theta_rad=values[6:12],
        a_m=values[12:18],
        d_m=values[18:24],
        alpha_rad=values[24:30],
        checksums=values[:6],
        status=values[30],
    )


def _unreadable_error(device: str, what: str, frame: bytes) -> WireProtocolError:
    return WireProtocolError(
        device,
        make_message("the primary interface sent {what}.", what=what),
        remedy="Report this with the controller's version; nothing in the cell is at fault.",
        frame=frame[:_HEX_SHOWN].hex(),
    )
