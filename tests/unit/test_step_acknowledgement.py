"""A step that was braked is never taken for one that has arrived, whenever its states are read."""

from collections.abc import Callable
from typing import Any

import pytest

from cellcal.drivers.abb.robot_web_services.motion_server import MotionServer as AbbMotionServer
from cellcal.drivers.errors import MotionStoppedError
from cellcal.drivers.kuka.variables.motion_server import MotionServer as KukaMotionServer

REQUEST = 7
WAITING, STOPPED = 1, 3
BEFORE = {"state": WAITING, "ack": REQUEST - 1}
BRAKED = {"state": STOPPED, "ack": REQUEST}
ARRIVED = {"state": WAITING, "ack": REQUEST}


class Program:
    """A motion program on a controller that ends its step after a number of exchanges with the driver."""

    def __init__(self, end: dict[str, int], exchanges: int) -> None:
        self._end, self._remaining = end, exchanges

    def values(self) -> dict[str, int]:
        """Return what the next exchange finds."""
        self._remaining -= 1
        return BEFORE if self._remaining >= 0 else self._end


class AbbLink:
    """What the driver uses of its link to Robot Web Services."""

    device = "abb"

    def __init__(self, program: Program) -> None:
        self._program = program

    async def read_symbol(self, name: str) -> str:
        values = self._program.values()
        return str(values["ack" if name.endswith("nAck") else "state"])

    async def write_symbol(self, name: str, value: str) -> None:
        self._program.values()


class KukaLink:
    """What the driver uses of its link to the variable server."""

    device = "kuka"

    def __init__(self, program: Program) -> None:
        self._program = program

    async def read_variable(self, variable: str) -> str:
        values = self._program.values()
        return str(values["ack" if variable == "CC_ACK" else "state"])

    async def write_variable(self, variable: str, value: str) -> None:
        self._program.values()


SERVERS: dict[str, Callable[[Program], Any]] = {
    "abb": lambda program: AbbMotionServer(AbbLink(program)),  # type: ignore[arg-type]
    "kuka": lambda program: KukaMotionServer(KukaLink(program)),  # type: ignore[arg-type]
}


async def ask_until_finished(motion: Any) -> None:
    """Return once the step is said to have finished."""
    for _ in range(8):
        if await motion.has_finished(REQUEST):
            return
    pytest.fail("the step has neither finished nor stopped")


@pytest.mark.parametrize("exchanges", range(8))
@pytest.mark.parametrize("server", SERVERS.values(), ids=SERVERS)
async def test_a_braked_step_is_reported_as_stopped_at_any_moment(
    server: Callable[[Program], Any], exchanges: int
) -> None:
    motion = server(Program(BRAKED, exchanges))
    with pytest.raises(MotionStoppedError, match="was stopped"):
        await ask_until_finished(motion)


@pytest.mark.parametrize("exchanges", range(8))
@pytest.mark.parametrize("server", SERVERS.values(), ids=SERVERS)
async def test_an_arrived_step_is_reported_as_finished_at_any_moment(
    server: Callable[[Program], Any], exchanges: int
) -> None:
    motion = server(Program(ARRIVED, exchanges))
    await ask_until_finished(motion)
