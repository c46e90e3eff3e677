"""A small RTDE client written from the maker's guide; it shares nothing with the fake or the driver."""

import asyncio
import struct
from contextlib import suppress
from typing import Any, Self

from tests.machine_speed import stretched_s

CODES = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
DEADLINE_S = stretched_s(10.0)


class RawRtde:
    """One connection to port 30004."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.names: list[str] = []
        self.kinds: list[str] = []
        self.protocol = 1

    @classmethod
    async def connect(cls, host: str) -> Self:
        async with asyncio.timeout(DEADLINE_S):
            return cls(*await asyncio.open_connection(host, 30004))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.writer.close()
        with suppress(ConnectionError):
            await self.writer.wait_closed()

    def send(self, kind: str, payload: bytes = b"") -> None:
        self.writer.write(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    async def receive(self) -> tuple[str, bytes]:
        async with asyncio.timeout(DEADLINE_S):
            size, kind = struct.unpack(">HB", await self.reader.readexactly(3))
            return chr(kind), await self.reader.readexactly(size - 3)

    async def send_and_receive(self, kind: str, payload: bytes = b"") -> bytes:
        """Send and return the answer, data packages in between left aside."""
        self.send(kind, payload)
        while True:
            answered, answer = await self.receive()
            if answered != "U":
                assert answered == kind
                return answer

    async def negotiate_version(self, version: int = 2) -> bool:
        accepted = await self.send_and_receive("V", struct.pack(">H", version)) == b"\1"
        if accepted:
            self.protocol = version
        return accepted

    async def set_up_outputs(self, names: list[str], hz: float = 125.0) -> tuple[int | None, list[str]]:
        head = struct.pack(">d", hz) if self.protocol == 2 else b""
        answer = await self.send_and_receive("O", head + ",".join(names).encode())
        recipe_id = None
        if self.protocol == 2:
            recipe_id, answer = answer[0], answer[1:]
        self.names, self.kinds = names, answer.decode().split(",")
        return recipe_id, self.kinds

    async def set_up_inputs(self, names: list[str]) -> tuple[int, list[str]]:
        answer = await self.send_and_receive("I", ",".join(names).encode())
        return answer[0], answer[1:].decode().split(",")

    async def start_stream(self) -> bool:
        return await self.send_and_receive("S") == b"\1"

    async def read_package(self) -> dict[str, Any]:
        """Return the next data package by name."""
        kind, payload = await self.receive()
        while kind != "U":
            kind, payload = await self.receive()
        if self.protocol == 2:
            assert payload[0] == 1
            payload = payload[1:]
        values: dict[str, Any] = {}
        for name, typed in zip(self.names, self.kinds, strict=True):
            code = ">" + CODES[typed]
            found = struct.unpack_from(code, payload)
            payload = payload[struct.calcsize(code) :]
            values[name] = found if len(found) > 1 else found[0]
        assert payload == b""
        return values

    async def wait_for(self, name: str, expected: Any) -> dict[str, Any]:
        """Read until a variable has a value."""
        async with asyncio.timeout(DEADLINE_S):
            while (values := await self.read_package())[name] != expected:
                pass
            return values


async def start_client(host: str, names: list[str], hz: float = 125.0) -> RawRtde:
    """Return a started client."""
    client = await RawRtde.connect(host)
    assert await client.negotiate_version()
    _, kinds = await client.set_up_outputs(names, hz)
    assert "NOT_FOUND" not in kinds
    assert await client.start_stream()
    return client
