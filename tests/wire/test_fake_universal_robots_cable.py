"""The cable of the fake controller, pulled and put back by several clients; the control port meanwhile."""

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
from tests.wire.fake_cells import wait_until
from tests.wire.fake_ur import fake_ur
from tests.wire.rtde_client import DEADLINE_S, start_client

PORTS = (30001, 30002, 30003, 30004, 29999)
ROUNDS = 10


async def restore_link(robot: FakeUniversalRobot) -> None:
    await robot.inject_fault("link_restore", {})


async def clear_faults(robot: FakeUniversalRobot) -> None:
    robot.clear_faults()
    await robot.server.open_ports()  # what the beat does next, here without waiting for it


async def pull_cable(robot: FakeUniversalRobot) -> None:
    await robot.inject_fault("link_loss_all", {})


def all_open(robot: FakeUniversalRobot) -> bool:
    return all(port.is_open for port in robot.server.ports.values())


async def is_listening(robot: FakeUniversalRobot) -> bool:
    """Whether every port lets a client in."""
    for port in PORTS:
        try:
            _, writer = await asyncio.open_connection(robot.server.address, port)
        except ConnectionRefusedError:
            return False
        writer.close()
        await writer.wait_closed()
    return True


@pytest.mark.parametrize(
    "acts",
    [
        (clear_faults, restore_link),
        (restore_link, clear_faults),
        (restore_link, restore_link, clear_faults, clear_faults),
    ],
)
async def test_clear_and_link_restore_open_the_ports_once(
    acts: tuple[Callable[[FakeUniversalRobot], Awaitable[None]], ...],
) -> None:
    async with fake_ur() as robot:
        for _ in range(ROUNDS):
            await pull_cable(robot)
            assert not await is_listening(robot)
            await asyncio.gather(*(act(robot) for act in acts))
            assert await is_listening(robot)
            for act in acts:  # and again one after another, on ports that are open
                await act(robot)
            assert all_open(robot)
        async with await start_client(robot.server.address, ["timestamp"]) as rtde:
            assert (await rtde.read_package())["timestamp"] > 0.0


@pytest.mark.parametrize("first", [restore_link, clear_faults])
async def test_the_hand_that_was_last_at_the_cable_decides(
    first: Callable[[FakeUniversalRobot], Awaitable[None]],
) -> None:
    async with fake_ur() as robot:
        for _ in range(ROUNDS):
            await pull_cable(robot)
            await asyncio.gather(first(robot), pull_cable(robot))
            assert not await is_listening(robot)
            await asyncio.gather(pull_cable(robot), first(robot))
            assert await is_listening(robot)


# the control port


@asynccontextmanager
async def control_server_of(
    robot: FakeUniversalRobot,
) -> AsyncIterator[Callable[..., Awaitable[dict[str, Any]]]]:
    """Ask through one connection to a control port of a cell with this robot, which runs already."""
    cell = FakeCell({})
    cell.robots = [robot]
    async with ControlServer(cell) as control_server:
        reader, writer = await asyncio.open_connection(control_server.host, control_server.port)

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
async def test_the_control_server_takes_clear_and_link_restore_in_either_order(
    questions: tuple[str, str],
) -> None:
    async with fake_ur() as robot, control_server_of(robot) as ask:
        for _ in range(ROUNDS):
            assert await ask(do="fault", name="link_loss_all") == {"ok": True}
            for name in questions:
                command = {"do": "clear"} if name == "clear" else {"do": "fault", "name": name}
                assert await ask(**command) == {"ok": True}
            assert await is_listening(robot)


async def test_the_control_server_reports_a_taken_port_and_stays_open() -> None:
    async with fake_ur() as robot, control_server_of(robot) as ask:
        await ask(do="fault", name="link_loss_all")
        with socket.create_server((robot.server.address, 30004)):
            refused = await ask(do="fault", name="link_restore")
            assert "address already in use" in refused["error"]
            assert (await ask(do="truth"))["ok"]
        assert await ask(do="fault", name="link_restore") == {"ok": True}
        await wait_until(lambda: all_open(robot))
        assert await is_listening(robot)


async def test_the_control_server_answers_unexpected_errors_of_a_verb() -> None:
    async with fake_ur() as robot, control_server_of(robot) as ask:
        assert "mastering" in (await ask(do="tcp_error"))["error"]
        assert "infinity" in (await ask(do="fault", name="silent_accept", port=float("inf")))["error"]
        assert (await ask(do="truth"))["ok"]
