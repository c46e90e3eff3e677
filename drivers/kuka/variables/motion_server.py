"""The handshake with CELLCAL.SRC, the program that moves the robot (deploy/controller_setup/kuka)."""

import asyncio
import math
from enum import IntEnum

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import MotionStoppedError, RefusedError
from cellcal.drivers.kuka.variables.state import read_value
from cellcal.drivers.kuka.variables.values import read_number, write_axes
from cellcal.drivers.kuka.variables.variable_link import VariableLink

_HIGHEST = 30_000
_POLL_S = 0.01
_START = "Select CELLCAL at the pendant, in AUT or EXT, and start it."


class ServerState(IntEnum):
    """CC_STATE."""

    OFF = 0
    WAITING = 1
    MOVING = 2
    STOPPED = 3


class MotionServer:
    """CELLCAL on the controller. The heartbeat is written while a step is waited for."""

    def __init__(self, link: VariableLink) -> None:
        self._link = link
        self._beat = 0

    async def read_server_state(self) -> ServerState:
        """Return what the program does; OFF where its variables are not there."""
        try:
            number = await self._read("CC_STATE")
        except RefusedError:
            return ServerState.OFF
        return ServerState(number) if number in tuple(ServerState) else ServerState.OFF

    async def require_running(self) -> None:
        """Raise where the program does not wait for orders; a stop of before is released."""
        await self.beat()
        await self._link.write_variable("CC_STOP", "FALSE")
        before = await self._read("CC_LIFE")
        for _ in range(200):
            state = await self.read_server_state()
            if state is ServerState.WAITING and await self._read("CC_LIFE") != before:
                return
            await asyncio.sleep(_POLL_S)
        raise RefusedError(self._link.device, "the program CELLCAL does not run.", remedy=_START)

    async def order_move(self, joints_rad: tuple[float, ...], percent: int) -> int:
        """Order one step; return the number under which it is acknowledged. The request is written last."""
        request = (await self._read("CC_ACK")) % _HIGHEST + 1
        await self._link.write_variable("CC_AXIS", write_axes(joints_rad))
        await self._link.write_variable("CC_VEL", str(percent))
        await self.beat()
        await self._link.write_variable("CC_REQ", str(request))
        return request

    async def has_finished(self, request: int) -> bool:
        """Return whether a step was acknowledged; raise where the program was stopped.

        The acknowledgement is read first: a stopped step is acknowledged too, and a state read before it
        could still be that of before the step.
        """
        await self.beat()
        acknowledged = await self._read("CC_ACK") == request
        state = await self.read_server_state()
        if state in (ServerState.STOPPED, ServerState.OFF):
            raise MotionStoppedError(
                self._link.device,
                "the program CELLCAL was stopped.",
                remedy=f"Look at the robot and the pendant. {_START}",
            )
        return acknowledged and state is ServerState.WAITING

    async def stop(self) -> None:
        """Brake; the program gives up what it was doing."""
        await self._link.write_variable("CC_STOP", "TRUE")

    async def beat(self) -> None:
        """Say that this client is alive."""
        self._beat = self._beat % _HIGHEST + 1
        await self._link.write_variable("CC_HB", str(self._beat))

    async def _read(self, variable: str) -> int:
        return int(await read_value(self._link, variable, read_number))


def speed_percent(device: str, speed_rad_s: float, fastest_axis_rad_s: float) -> int:
    """Return the axis speed in whole per cent, rounded down.

    Raises
    ------
    RefusedError
        Slower than one per cent, the least that a joint move of this controller takes.
    """
    percent = math.floor(100.0 * speed_rad_s / fastest_axis_rad_s)
    if percent < 1:
        least = math.degrees(fastest_axis_rad_s) / 100.0
        raise RefusedError(
            device,
            make_message(
                "the slowest joint move of this controller is {least:.2f} deg/s, and a slower one was "
                "asked for.",
                least=least,
            ),
            remedy="Raise speed_limit_rad_s in the cell file, or turn the override down at the pendant.",
        )
    return min(100, percent)
