"""What the primary interface (port 30001) sends to every client: sub-packages of the robot's state.

Source: the maker's description of the primary client interface: packets of i32 length and u8 type; type 16 holds
sub-packages of u32 length and u8 type. Nothing is sent to the controller.
"""

import asyncio
import contextlib
from collections.abc import Collection, Iterator, Mapping
from struct import Struct

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import UnreachableError, WireProtocolError
from cellcal.drivers.wire.link_errors import find_reason

PORT = 30001
_PACKET = Struct(">iB")
_SUB_PACKET = Struct(">IB")
_ROBOT_STATE = 16
_LONGEST_PACKET = 1 << 16
_HEX_SHOWN = 48
_PORT_BLOCKED = (
    "Check that the controller is switched on, that the network cable is plugged in, and that its security settings "
    "do not block port 30001."
)


async def read_sub_packages(
    device: str, address: str, wanted: Collection[int], *, deadline_s: float
) -> Mapping[int, bytes]:
    """Connect, wait until each wanted type of sub-package has come once, and hang up; return them by type.

    Raises
    ------
    UnreachableError
        No connection, or one of them did not come in time.
    WireProtocolError
        Bytes that are no packets.
    """
    try:
        async with asyncio.timeout(deadline_s):
            reader, writer = await asyncio.open_connection(address, PORT)
            try:
                return await _collect(device, reader, wanted)
            finally:
                writer.transport.abort()
                with contextlib.suppress(OSError):
                    await writer.wait_closed()
    except TimeoutError:
        what = make_message("did not describe the arm within {deadline_s:g} s", deadline_s=deadline_s)
    except (OSError, EOFError) as error:
        what = make_message("cannot be reached ({error})", error=find_reason(error))
    raise UnreachableError(
        device,
        make_message("the primary interface of {address} {what}.", address=address, what=what),
        remedy=_PORT_BLOCKED,
    )


async def _collect(device: str, reader: asyncio.StreamReader, wanted: Collection[int]) -> Mapping[int, bytes]:
    found: dict[int, bytes] = {}
    while True:
        header = await reader.readexactly(_PACKET.size)
        size, kind = _PACKET.unpack(header)
        if not _PACKET.size <= size <= _LONGEST_PACKET:
            raise unreadable_error(device, make_message("a packet of {size} bytes", size=size), header)
        body = await reader.readexactly(size - _PACKET.size)
        if kind == _ROBOT_STATE:
            found |= {part: data for part, data in sub_packages(device, body) if part in wanted}
            if all(part in found for part in wanted):
                return found


def sub_packages(device: str, body: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (type, data) of the sub-packages of a robot state packet."""
    start = 0
    while start < len(body):
        if len(body) - start < _SUB_PACKET.size:
            raise unreadable_error(device, "half a sub-package", body[start:])
        size, kind = _SUB_PACKET.unpack_from(body, start)
        if not _SUB_PACKET.size <= size <= len(body) - start:
            raise unreadable_error(
                device, make_message("a sub-package of {size} bytes", size=size), body[start:]
            )
        yield kind, body[start + _SUB_PACKET.size : start + size]
        start += size


def unreadable_error(device: str, what: str, frame: bytes) -> WireProtocolError:
    """Return the error of bytes that the maker's document does not allow."""
    return WireProtocolError(
        device,
        make_message("the primary interface sent {what}.", what=what),
        remedy="Report this with the controller's version; nothing in the cell is at fault.",
        frame=frame[:_HEX_SHOWN].hex(),
    )
