"""A process that stood still itself does not take a device for silent: what came in time counts."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from cellcal.drivers.errors import DeviceTimeoutError
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.modbus import ModbusLink
from tests.machine_speed import stretched_s

DEADLINE_S = stretched_s(1.0)


class DelayedServer:
    """Answers one request for two registers when it is told to, from a thread of its own."""

    def __init__(self) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listening.getsockname()[1])
        self.was_asked, self.may_answer, self.answered = (
            threading.Event(),
            threading.Event(),
            threading.Event(),
        )
        self._thread = threading.Thread(target=self._serve_request, daemon=True)
        self._thread.start()

    def _serve_request(self) -> None:
        connection, _ = self._listening.accept()
        with connection:
            request = connection.recv(256)
            self.was_asked.set()
            self.may_answer.wait()
            connection.sendall(
                request[:4] + bytes.fromhex("0007") + request[6:8] + bytes.fromhex("0400070009")
            )
            self.answered.set()
            connection.recv(256)  # until the other side hangs up

    def close(self) -> None:
        self.may_answer.set()
        self._listening.close()


@pytest.fixture
def server() -> Iterator[DelayedServer]:
    server = DelayedServer()
    yield server
    server.close()


def stand_still_until(moment_s: float) -> None:
    """Block the event loop, as a slow disk or a busy machine does."""
    time.sleep(max(0.0, moment_s - time.monotonic()))


async def test_an_answer_that_came_while_the_process_stood_still_is_taken(server: DelayedServer) -> None:
    link = ModbusLink("arm", "127.0.0.1", server.port, deadline_s=DEADLINE_S)
    asking = asyncio.create_task(link.read(1, 2))
    while not server.was_asked.is_set():
        await asyncio.sleep(0)
    server.may_answer.set()
    server.answered.wait()
    stand_still_until(time.monotonic() + 1.2 * DEADLINE_S)
    assert await asking == (7, 9)
    await link.close()


async def test_a_block_whose_answer_came_during_a_standstill_is_not_too_long() -> None:
    loop = asyncio.get_running_loop()
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    with ours, theirs:

        async def wait_for_answer() -> bytes:
            async with answer_deadline("arm", 0.1, "reading"):
                return await loop.sock_recv(ours, 16)

        reading = asyncio.create_task(wait_for_answer())
        await asyncio.sleep(0)
        theirs.sendall(b"here")
        stand_still_until(time.monotonic() + 0.3)
        assert await reading == b"here"


async def test_a_device_that_says_nothing_is_too_late_all_the_same() -> None:
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    with ours, theirs:

        async def wait_for_answer(stands_still_s: float) -> None:
            async with answer_deadline("arm", 0.1, "reading"):
                stand_still_until(time.monotonic() + stands_still_s)
                await asyncio.get_running_loop().sock_recv(ours, 16)

        for stands_still_s in (0.0, 0.3):
            with pytest.raises(DeviceTimeoutError, match=r"arm: reading took longer than 0\.1 s"):
                await wait_for_answer(stands_still_s)
