"""The handshake with the RAPID module CellcalServer (deploy/controller_setup/abb)."""

import asyncio
from enum import IntEnum

from cellcal.drivers.abb.robot_web_services.rapid_values import read_numbers, write_joint_target
from cellcal.drivers.abb.robot_web_services.state import converted, read_symbol, write_symbol
from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import MotionStoppedError, RefusedError

_HIGHEST = 30_000
_POLL_S = 0.01
_MODULE = "CellcalServer"
_START = "Load the module CellcalServer, move the program pointer to main, and start it in AUTO."


class ServerState(IntEnum):
    """nState."""

    OFF = 0
    WAITING = 1
    MOVING = 2
    STOPPED = 3


class MotionServer:
    """CellcalServer on the controller. The heartbeat is written while a step is waited for."""

    def __init__(self, link: WebLink) -> None:
        self._link = link
        self._beat = 0

    async def require_running(self) -> None:
        """Raise where the program does not wait for orders; a stop of before is released."""
        await self._write("nStop", 0)
        before = await self._read("nLife")
        for _ in range(100):
            await self.beat()
            state, life = await self._read("nState"), await self._read("nLife")
            if state == ServerState.WAITING and life != before:
                return
            await asyncio.sleep(_POLL_S)
        raise RefusedError(self._link.device, "the program CellcalServer does not run.", remedy=_START)

    async def order_move(self, joints_rad: tuple[float, ...], duration_s: float) -> int:
        """Order one step; return the number under which it is acknowledged. The request is written last."""
        request = (await self._read("nAck")) % _HIGHEST + 1
        await write_symbol(self._link, f"{_MODULE}/jTarget", write_joint_target(joints_rad))
        await write_symbol(self._link, f"{_MODULE}/nTime", f"{max(duration_s, 0.01):.4f}")
        await self.beat()
        await self._write("nReq", request)
        return request

    async def has_finished(self, request: int) -> bool:
        """Return whether a step was acknowledged; raise where the program was stopped.

        The acknowledgement is read first: a stopped step is acknowledged too, and a state read before it
        could still be that of before the step.
        """
        await self.beat()
        acknowledged = await self._read("nAck") == request
        state = await self._read("nState")
        if state not in (ServerState.WAITING, ServerState.MOVING):
            raise MotionStoppedError(
                self._link.device,
                "the program CellcalServer was stopped.",
                remedy=f"Look at the robot and the pendant. {_START}",
            )
        return acknowledged and state == ServerState.WAITING

    async def stop(self) -> None:
        """Brake; the program gives up what it was doing."""
        await self._write("nStop", 1)

    async def beat(self) -> None:
        """Say that this client is alive."""
        self._beat = self._beat % _HIGHEST + 1
        await self._write("nHeart", self._beat)

    async def _read(self, name: str) -> int:
        text = await read_symbol(self._link, f"{_MODULE}/{name}")
        return int(converted(self._link, lambda: read_numbers(text)[0]))

    async def _write(self, name: str, value: int) -> None:
        await write_symbol(self._link, f"{_MODULE}/{name}", str(value))
