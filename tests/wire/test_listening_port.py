"""A fake's port leaves no connection open, and every server of the fakes and the tests is such a port."""

import ast
import asyncio
import gc
import socket
from pathlib import Path

from cellcal.fake_devices.listening_port import ListeningPort

ROOT = Path(__file__).parents[2]


async def test_a_client_that_comes_while_the_port_closes_is_hung_up() -> None:
    served: list[asyncio.StreamWriter] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        served.append(writer)
        await reader.read()

    port = ListeningPort("127.0.0.1", 0, serve)
    await port.open()
    with socket.create_connection((port.host, port.port)) as client:
        while not port.client_count:
            await asyncio.sleep(0)
        await port.wait_closed()
        assert not served
        assert not port.client_count
        assert await asyncio.to_thread(client.recv, 1) == b""


async def test_a_port_keeps_its_number_and_can_be_opened_again() -> None:
    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"hello")

    async with ListeningPort("127.0.0.1", 0, serve) as port:
        number = port.port
        port.close()
        await port.open()
        reader, writer = await asyncio.open_connection(port.host, number)
        assert await reader.read() == b"hello"
        writer.close()


async def test_a_task_that_is_cancelled_while_it_opens_a_port_leaves_no_socket() -> None:
    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()

    for steps in range(8):
        port = ListeningPort("127.0.0.1", 0, serve)
        opening = asyncio.create_task(port.open())
        for _ in range(steps):
            await asyncio.sleep(0)
        opening.cancel()
        await asyncio.wait({opening})
        await port.wait_closed()
        gc.collect()  # a socket that was left raises a warning, which is an error here


async def test_two_tasks_that_open_a_port_at_once_open_one() -> None:
    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()

    port = ListeningPort("127.0.0.1", 0, serve)
    await asyncio.gather(port.open(), port.open())
    assert port.is_listening
    await port.wait_closed()
    gc.collect()


def test_no_other_server_is_started() -> None:
    found = {
        path.relative_to(ROOT).as_posix()
        for folder in ("fake_devices", "tests")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if "start_server" in path.read_text(encoding="utf-8")
        and any(
            isinstance(node, ast.Attribute) and node.attr == "start_server"
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        )
    }
    assert found == {"fake_devices/listening_port.py"}
