"""The handshake with a motion program of ours on a controller that has no command for a joint move.

The program counts what it has done: a step is ordered by a new request number and has ended when the program
acknowledges that number. It brakes by itself where the heartbeat of this client stops.
"""

from abc import ABC, abstractmethod
from enum import IntEnum

from cellcal.drivers.errors import MotionStoppedError

_HIGHEST = 30_000


class ProgramState(IntEnum):
    """What the program does."""

    OFF = 0
    WAITING = 1
    MOVING = 2
    STOPPED = 3

    @classmethod
    def _missing_(cls, value: object) -> "ProgramState":
        return cls.OFF  # a number that the program never writes


class ProgramHandshake(ABC):
    """Steps of one motion program. The heartbeat is written while a step is waited for."""

    def __init__(self) -> None:
        self._beat = 0

    @abstractmethod
    async def _read_state(self) -> ProgramState:
        """Return what the program does; OFF where it does not say."""

    @abstractmethod
    async def _read_acknowledged(self) -> int:
        """Return the number of the last step that has ended, in whatever way."""

    @abstractmethod
    async def _write_request(self, number: int) -> None:
        """Start the step that was written before."""

    @abstractmethod
    async def _write_heartbeat(self, number: int) -> None:
        """Write a number that differs from the last one."""

    @abstractmethod
    def _stopped_error(self) -> MotionStoppedError:
        """Return that the program was stopped, and what a person does to start it."""

    async def beat(self) -> None:
        """Say that this client is alive."""
        self._beat = self._beat % _HIGHEST + 1
        await self._write_heartbeat(self._beat)

    async def has_finished(self, request: int) -> bool:
        """Return whether a step was acknowledged; raise where the program was stopped.

        The acknowledgement is read first: a stopped step is acknowledged too, and a state read before it
        could still be that of before the step.
        """
        await self.beat()
        acknowledged = await self._read_acknowledged() == request
        state = await self._read_state()
        if state not in (ProgramState.WAITING, ProgramState.MOVING):
            raise self._stopped_error()
        return acknowledged and state is ProgramState.WAITING

    async def _next_request(self) -> int:
        return await self._read_acknowledged() % _HIGHEST + 1

    async def _start_step(self, request: int) -> int:
        """Order the step whose target and speed are written; the request is written last."""
        await self.beat()
        await self._write_request(request)
        return request
