"""No HTTP answer of a controller fills the memory or lasts longer than the deadline of its driver."""

import asyncio
import contextlib
import functools
import gzip
import re
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

import cellcal.drivers
from cellcal.drivers.abb.robot_web_services.generation import ServiceAddress, find_service
from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import DeviceError, UnreachableError, WireProtocolError
from cellcal.drivers.universal_robots.robot_api import RobotApiClient
from cellcal.fake_devices.listening_port import ListeningPort
from tests.machine_speed import stretched_s

DEADLINE_S = stretched_s(2.0)
PATIENCE_S = stretched_s(60.0)  # an answer without an end would outlast it
MOST_SENT = 64_000_000  # octets that a server gets rid of: what is in the buffers of two sockets at most
CHALLENGE = b'HTTP/1.1 401 No\r\nWWW-Authenticate: Digest realm="r", qop="auth", nonce="n", opaque="o"\r\n'
FOUND = b"HTTP/1.1 200 OK\r\n"
MOVED = b"HTTP/1.1 302 Found\r\nLocation: /elsewhere\r\n"


@functools.cache
def make_bomb() -> bytes:
    """Return a small body that is 100 MB when it is unpacked."""
    return gzip.compress(b" " * 100_000_000, 1)


@contextlib.asynccontextmanager
async def serving(head: bytes, how: str, first: bytes = b"") -> AsyncIterator[tuple[int, list[int]]]:
    """Serve one kind of answer without an end; the first of all connections gets ``first`` before."""
    sent, waiting = [0], [first] if first else []

    async def reply(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
            await reader.readuntil(b"\r\n\r\n")
            await answer(writer)
        writer.transport.abort()

    async def answer(writer: asyncio.StreamWriter) -> None:
        if waiting:
            writer.write(waiting.pop())
            await writer.drain()
            writer.write_eof()
            await asyncio.sleep(DEADLINE_S)
        elif how == "packed":
            bomb = make_bomb()
            writer.write(head + b"Content-Encoding: gzip\r\nContent-Length: %d\r\n\r\n" % len(bomb) + bomb)
            await writer.drain()
            await asyncio.sleep(DEADLINE_S)
        else:
            writer.write(head + b"Content-Type: application/json\r\n\r\n{")
            while sent[0] < MOST_SENT * 10:
                part = b" " * (1 if how == "dripping" else 1_000_000)
                writer.write(part)
                await writer.drain()
                sent[0] += len(part)
                await asyncio.sleep(0.02 if how == "dripping" else 0)

    async with ListeningPort("127.0.0.1", 0, reply) as port:
        yield port.port, sent


HOWS = ("endless", "dripping", "packed")


@pytest.mark.parametrize("how", HOWS)
@pytest.mark.parametrize("head", [FOUND, MOVED])
async def test_the_robot_api_of_polyscope_x(head: bytes, how: str) -> None:
    async with serving(head, how) as (port, sent):
        client = RobotApiClient("arm", "127.0.0.1", port, deadline_s=DEADLINE_S)
        async with asyncio.timeout(PATIENCE_S):
            with pytest.raises(UnreachableError if how == "dripping" else WireProtocolError):
                await client.connect()
        assert sent[0] < MOST_SENT
        await client.close()


@pytest.mark.parametrize("how", HOWS)
@pytest.mark.parametrize("head", [FOUND, CHALLENGE])
async def test_robot_web_services(head: bytes, how: str) -> None:
    async with serving(head, how, CHALLENGE + b"Content-Length: 0\r\n\r\n") as (port, sent):
        link = WebLink(ServiceAddress("arm", "127.0.0.1", port), ("u", "p"), deadline_s=DEADLINE_S)
        await link.connect()
        async with asyncio.timeout(PATIENCE_S):
            with pytest.raises(DeviceError) as refusal:
                await link.get_state("/rw/panel/opmode")
        assert isinstance(refusal.value, WireProtocolError) is (how != "dripping")
        assert sent[0] < MOST_SENT
        await link.close()


@pytest.mark.parametrize("how", HOWS)
async def test_the_question_which_generation_answers(how: str) -> None:
    async with serving(FOUND, how) as (port, sent):
        async with asyncio.timeout(PATIENCE_S):
            with pytest.raises(UnreachableError):
                await find_service(ServiceAddress("arm", "127.0.0.1", port), DEADLINE_S)
        assert sent[0] < MOST_SENT


def test_every_client_of_a_driver_reads_through_the_bounded_transport() -> None:
    sources = sorted(Path(cellcal.drivers.__path__[0]).rglob("*.py"))
    assert sources
    for path in sources:
        text = path.read_text()
        assert len(re.findall(r"AsyncClient\(", text)) == len(re.findall(r"\bBoundedTransport\(", text)) - (
            path.name == "http_answers.py"
        ), path
        assert not re.search(
            r"\bhttpx\.(?:get|post|put|stream|request|Client)\(|urlopen|\baiohttp\b", text
        ), path
