"""What the Robot API of PolyScope X may answer: versions with what follows them, and success without content."""

import asyncio

import pytest

from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.drivers.universal_robots.robot_api import RobotApiClient
from cellcal.fake_devices.listening_port import ListeningPort
from tests.machine_speed import stretched_s


@pytest.fixture
async def client():
    found = RobotApiClient("ur", "127.0.0.1", 80, deadline_s=1.0)
    yield found
    await found.close()


@pytest.mark.parametrize(
    ("text", "numbers"),
    [("3.1.4", (3, 1, 4)), ("v3.1.4", (3, 1, 4)), ("3.2.0-rc.1+build7", (3, 2, 0)), ("3.1", (3, 1))],
)
async def test_a_version_is_read_whatever_follows_it(
    client: RobotApiClient, text: str, numbers: tuple[int, ...]
) -> None:
    assert client.read_version(text) == numbers


@pytest.mark.parametrize("text", ["", "beta", "3", "3.", None, 3.1, "3.1." + "9" * 5000])
async def test_what_is_no_version_is_refused(client: RobotApiClient, text: object) -> None:
    with pytest.raises(WireProtocolError, match="version is missing"):
        client.read_version(text)


@pytest.mark.parametrize(
    ("status", "is_taken"),
    [("200 OK", True), ("202 Accepted", True), ("204 No Content", True), ("409 No", False)],
)
async def test_a_stop_is_taken_where_the_controller_says_so_without_content(
    status: str, is_taken: bool
) -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        await reader.readexactly(len(b'{"action":"stop"}'))
        length = "" if status.startswith("204") else "Content-Length: 0\r\n"
        writer.write(f"HTTP/1.1 {status}\r\n{length}Connection: close\r\n\r\n".encode())
        await writer.drain()

    async with ListeningPort("127.0.0.1", 0, serve) as port:
        client = RobotApiClient("ur", "127.0.0.1", port.port, deadline_s=stretched_s(5.0))
        try:
            await client.stop_program()
            assert is_taken
        except RefusedError:
            assert not is_taken
        finally:
            await client.close()
