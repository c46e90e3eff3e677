"""No answer of an OPC UA server fills the memory, whatever length it claims and however often it goes on."""

import asyncio
import contextlib
import itertools
import struct

import pytest

from cellcal.drivers.errors import DeviceError
from cellcal.drivers.opc_ua.server_access import ServerAccess
from cellcal.drivers.opc_ua.server_link import ServerLink
from cellcal.fake_devices.listening_port import ListeningPort
from tests.machine_speed import stretched_s

DEADLINE_S = stretched_s(3.0)
PATIENCE_S = stretched_s(60.0)  # an answer without an end would outlast it
ACKNOWLEDGE = struct.pack("<4sIIIIII", b"ACKF", 28, 0, 2**32 - 1, 2**32 - 1, 0, 0)
CHUNK = 65_000
SECURITY = (
    struct.pack("<II", 47, 0)
    + b"http://opcfoundation.org/UA/SecurityPolicy#None"
    + struct.pack("<ii", -1, -1)
)


def one_endless_chunk(_number: int) -> bytes:
    return struct.pack("<4sI", b"OPNF", 2**32 - 1) if _number == 0 else bytes(1_000_000)


def endless_chunks(number: int) -> bytes:
    body = SECURITY[:4] + SECURITY[8:] + struct.pack("<II", number + 1, 1) + bytes(CHUNK)
    return struct.pack("<4sII", b"OPNC", 12 + len(body), 1) + body


@pytest.mark.parametrize("part", [one_endless_chunk, endless_chunks])
@pytest.mark.parametrize("head", [b"", ACKNOWLEDGE])
async def test_an_answer_without_an_end_is_broken_off(part, head: bytes) -> None:
    sent = [0]

    async def reply(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError):
            await reader.read(1000)
            if head:
                writer.write(head)
                await reader.read(1000)
            for number in itertools.count():
                piece = part(number)
                writer.write(piece)
                await writer.drain()
                sent[0] += len(piece)
        writer.transport.abort()

    async with ListeningPort("127.0.0.1", 0, reply) as port:
        link = ServerLink("arm", f"opc.tcp://127.0.0.1:{port.port}/", ServerAccess(), deadline_s=DEADLINE_S)
        async with asyncio.timeout(PATIENCE_S):
            with pytest.raises(DeviceError):
                await link.connect()
            await link.close()
    assert sent[0] < 40_000_000  # what two sockets hold, and the bound
