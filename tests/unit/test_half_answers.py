"""A server that begins an answer and stops is named as that, and not as a slow one."""

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import httpx
import pytest

from cellcal.drivers.errors import DeviceTimeoutError
from cellcal.drivers.kuka.variables.variable_link import VariableLink
from cellcal.drivers.opc_ua.bounded_protocol import BoundedProtocol
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.http_answers import BoundedTransport


@pytest.mark.parametrize(
    ("is_half", "words"), [(True, "asking: an answer began and did not end"), (False, "asking took longer")]
)
async def test_a_missed_deadline_says_whether_an_answer_has_begun(is_half: bool, words: str) -> None:
    with pytest.raises(DeviceTimeoutError, match=words) as missed:
        async with answer_deadline("arm", 0.01, "asking", is_half=lambda: is_half):
            await asyncio.Event().wait()
    assert ("firewall" in missed.value.remedy) == is_half


class _Writer:
    """Takes everything, and goes nowhere."""

    def write(self, data: bytes) -> None: ...
    async def drain(self) -> None: ...
    def close(self) -> None: ...
    async def wait_closed(self) -> None: ...


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        (b"", "took longer"),
        (b"\x00", "began and did not end"),
        (b"\x00\x01\x00\x0b\x00\x00", "began and did not end"),
    ],
)
async def test_half_an_answer_of_a_kuka(sent: bytes, words: str) -> None:
    link: Any = VariableLink("kuka", "127.0.0.1", 7000, deadline_s=0.02)
    link._new_tag = lambda: 1
    reader = asyncio.StreamReader()
    reader.feed_data(sent)
    link._streams = (reader, _Writer())
    with pytest.raises(DeviceTimeoutError, match=words):
        await link.read_variable("$MODE_OP")


class _Parts(httpx.AsyncByteStream):
    def __init__(self, parts: list[bytes]) -> None:
        self._parts = parts

    async def __aiter__(self) -> AsyncIterator[bytes]:
        for part in self._parts:
            yield part


async def test_http_tells_whether_an_answer_came_to_its_end() -> None:
    transport: Any = BoundedTransport(100, verify=False)

    class Inner:
        async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
            return httpx.Response(200, stream=_Parts([b"{", b"}"]))

    transport._inner = Inner()
    assert not transport.is_half
    response = await transport.handle_async_request(httpx.Request("GET", "http://arm/"))
    parts = aiter(response.stream)
    assert (await anext(parts), transport.is_half) == (b"{", True)
    assert [part async for part in parts] == [b"}"]
    assert not transport.is_half


def test_opc_ua_tells_whether_a_chunk_came_to_its_end() -> None:
    protocol = BoundedProtocol.__new__(BoundedProtocol)
    protocol.receive_buffer = b"ACKF"
    assert protocol.is_half
    protocol.receive_buffer = None
    assert not protocol.is_half
