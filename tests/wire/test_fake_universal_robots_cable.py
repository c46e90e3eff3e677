"""The cable of the fake controller, pulled and put back by several hands; the control door meanwhile."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

from cellcal.fake_devices.cell import FakeCell
from cellcal.fake_devices.control_server import ControlServer
from cellcal.fake_devices.universal_robots.device import FakeUniversalRobot
from tests.wire.fake_cells import until
from tests.wire.fake_ur import fake_ur
from tests.wire.rtde_client import DEADLINE_S, watching

PORTS = (30001, 30002, 30003, 30004, 29999)
ROUNDS = 10


async def restore(robot: FakeUniversalRobot) -> None:
    await robot.inject_fault("link_restore", {})


async def clear(robot: FakeUniversalRobot) -> None:
    robot.clear_faults()
    await robot.server.open_ports()  # what the beat does next, here without waiting for it


async def pull(robot: FakeUniversalRobot) -> None:
    await robot.inject_fault("link_loss_all", {})


def all_open(robot: FakeUniversalRobot) -> bool:
    return all(port.is_open for port in robot.server.ports.values())


async def listens(robot: FakeUniversalRobot) -> bool:
    """Whether every port lets a client in."""
    for port in PORTS:
        try:
            _, writer = await asyncio.open_connection(robot.server.address, port)
        except ConnectionRefusedError:
            return False
        writer.close()
        await writer.wait_closed()
    return True


@pytest.mark.parametrize("acts", [(clear, restore), (restore, clear), (restore, restore, clear, clear)])
async def test_clear_and_link_restore_open_the_ports_once(
    acts: tuple[Callable[[FakeUniversalRobot], Awaitable[None]], ...],
) -> None:
    async with fake_ur() as robot:
        for _ in range(ROUNDS):
            await pull(robot)
            assert not await listens(robot)
            await asyncio.gather(*(act(robot) for act in acts))
            assert await listens(robot)
            for act in acts:  # and again one after another, on ports that are open
                await act(robot)
            assert all_open(robot)
        async with await watching(robot.server.address, ["timestamp"]) as rtde:
            assert (await rtde.read())["timestamp"] > 0.0


@pytest.mark.parametrize("first", [restore, clear])
async def test_the_hand_that_was_last_at_the_cable_decides(
    first: Callable[[FakeUniversalRobot], Awaitable[None]],
) -> None:
    async with fake_ur() as robot:
        for _ in range(ROUNDS):
            await pull(robot)
            await asyncio.gather(first(robot), pull(robot))
            assert not await listens(robot)
            await asyncio.gather(pull(robot), first(robot))
            assert await listens(robot)


# the control door


@asynccontextmanager
async def door_of(robot: FakeUniversalRobot) -> AsyncIterator[Callable[..., Awaitable[dict[str, Any]]]]:
    """Ask through one connection to a control door of a cell with this robot, which runs already."""
    cell = FakeCell({})
    cell.robots = [robot]
    async with ControlServer(cell) as door:
        reader, writer = await asyncio.open_connection(door.host, door.port)

        async def ask(**question: Any) -> dict[str, Any]:
            writer.write(json.dumps(question).encode() + b"\n")
            async with asyncio.timeout(DEADLINE_S):
                answer: dict[str, Any] = json.loads(await reader.readline())
            return answer

        try:
            yield ask
        finally:
            writer.close()
            await writer.wait_closed()


@pytest.mark.parametrize("questions", [("clear", "link_restore"), ("link_restore", "clear")])
async def test_the_door_takes_clear_and_link_restore_in_either_order(questions: tuple[str, str]) -> None:
    async with fake_ur() as robot, door_of(robot) as ask:
        for _ in range(ROUNDS):
            assert await ask(do="fault", name="link_loss_all") == {"ok": True}
            for name in questions:
                asked = {"do": "clear"} if name == "clear" else {"do": "fault", "name": name}
                assert await ask(**asked) == {"ok": True}
            assert await listens(robot)


async def test_the_door_says_so_when_a_port_is_taken_and_stays_open() -> None:
    async with fake_ur() as robot, door_of(robot) as ask:
        await ask(do="fault", name="link_loss_all")
        with socket.create_server((robot.server.address, 30004)):
            refused = await ask(do="fault", name="link_restore")
            assert "address already in use" in refused["error"]
            assert (await ask(do="truth"))["ok"]
        assert await ask(do="fault", name="link_restore") == {"ok": True}
        await until(lambda: all_open(robot))
        assert await listens(robot)


async def test_the_door_answers_what_a_verb_did_not_expect() -> None:
    async with fake_ur() as robot, door_of(robot) as ask:
        assert "mastering" in (await ask(do="tcp_error"))["error"]
        assert "infinity" in (await ask(do="fault", name="silent_accept", port=float("inf")))["error"]
        assert (await ask(do="truth"))["ok"]
