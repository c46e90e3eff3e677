"""A server that answers each question twice: the second answer is taken for no other question's."""

import asyncio
import json
import struct
from collections.abc import AsyncIterator

import pytest

from cellcal.drivers.errors import WireProtocolError
from cellcal.drivers.kuka.variables.variable_link import VariableLink
from cellcal.drivers.universal_robots.robot_api import RobotApiClient
from cellcal.fake_devices.listening_port import ListeningPort

ANSWERS = {
    "openapi.json": {"info": {"version": "3.2.1"}},
    "controlmode": {"mode": "REMOTE"},
    "operationalmode": {"mode": "MANUAL"},
}


@pytest.fixture
async def doubling_port() -> AsyncIterator[int]:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while head := await reader.readuntil(b"\r\n\r\n"):
            path = head.split(b" ")[1].decode()
            body = json.dumps(ANSWERS[path.rpartition("/")[2]]).encode()
            head = b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(body)
            writer.write(2 * (head + body))
            await writer.drain()

    async with ListeningPort("127.0.0.1", 0, serve) as port:
        yield port.port


async def test_the_robot_api_is_asked_on_a_connection_for_each_question(doubling_port: int) -> None:
    client = RobotApiClient("ur", "127.0.0.1", doubling_port, deadline_s=5.0)
    try:
        await client.connect()
        for _ in range(3):
            assert await client.in_remote_control()
            assert await client.operational_mode() == "MANUAL"
    finally:
        await client.close()


async def test_an_answer_that_was_sent_before_its_question_is_none() -> None:
    def answer(tag: int, value: bytes) -> bytes:
        body = b"\0" + struct.pack(">H", len(value)) + value + b"\0\1\1"
        return struct.pack(">HH", tag, len(body)) + body

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while header := await reader.readexactly(4):
            tag, length = struct.unpack(">HH", header)
            await reader.readexactly(length)
            writer.write(answer(tag, b"#AUT") + answer(tag, b"#AUT") + answer(tag % 65535 + 1, b"#T1"))
            await writer.drain()

    async with ListeningPort("127.0.0.1", 0, serve) as port:
        link = VariableLink("kuka", "127.0.0.1", port.port, deadline_s=5.0)
        try:
            for _ in range(3):
                assert await link.read_variable("$MODE_OP") == "#AUT"
                with pytest.raises(WireProtocolError):
                    await link.read_variable("$MODE_OP")
        finally:
            await link.close()
