"""The handshake with a motion program of ours on a controller that has no command for a joint move.

The program counts what it has done: a step is ordered by a new request number and has ended when the program
acknowledges that number. It brakes by itself where the heartbeat of this client stops.
"""

import asyncio
from abc import ABC, abstractmethod
from enum import IntEnum

from cellcal.drivers.errors import MotionStoppedError, RefusedError

_HIGHEST = 30_000
_POLL_S = 0.01
_POLLS_AT_START = 200
_POLLS_AT_STOP = 100


class ProgramState(IntEnum):
    """The state of the program."""

    OFF = 0
    WAITING = 1
    MOVING = 2
    STOPPED = 3
    REFUSED = 4  # the step that was ordered; the program waits for a stop

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
    async def _read_heartbeat_counter(self) -> int:
        """Return the number that the controller raises as long as the program runs."""

    @abstractmethod
    async def _read_request(self) -> int:
        """Return the number of the last step that was ordered, by whatever client."""

    @abstractmethod
    async def _read_acknowledged(self) -> int:
        """Return the number of the last step that has ended, in whatever way."""

    @abstractmethod
    async def _refused_error(self) -> RefusedError:
        """Return why the program has refused its step."""

    @abstractmethod
    async def _order_stop(self) -> None:
        """Tell the program to brake and to give up its step."""

    @abstractmethod
    async def _release_stop(self) -> None:
        """Take back the stop that this client or the program ordered."""

    @abstractmethod
    async def _write_request(self, number: int) -> None:
        """Start the step that was written before."""

    @abstractmethod
    async def _write_heartbeat(self, number: int) -> None:
        """Write a number that differs from the last one."""

    @abstractmethod
    def _not_running_error(self) -> RefusedError:
        """Return that the program does not wait for orders, and what a person does to start it."""

    @abstractmethod
    def _stop_unconfirmed_error(self) -> MotionStoppedError:
        """Return that the program runs on although a stop was ordered."""

    @abstractmethod
    def _stopped_error(self) -> MotionStoppedError:
        """Return that the program was stopped, and what a person does to start it."""

    async def beat(self) -> None:
        """Say that this client is alive."""
        self._beat = self._beat % _HIGHEST + 1
        await self._write_heartbeat(self._beat)

    async def require_running(self) -> None:
        """Release a stop of before and wait until the program waits for orders.

        A step that was ordered just before a stop must have been given up: it would run once the stop is
        released, and would be taken for the next one. A program that was paused in a step would go on with it: it
        gets its stop before, and the stop is released once the program runs and has confirmed it.

        Raises
        ------
        RefusedError
            The program does not run, or an old step is pending.
        """
        before = await self._read_heartbeat_counter()
        for _ in range(_POLLS_AT_START):
            await self.beat()
            if await self._read_heartbeat_counter() != before and await self._is_waiting():
                return
            await asyncio.sleep(_POLL_S)
        raise self._not_running_error()

    async def _is_waiting(self) -> bool:
        """Bring a program that runs to wait for orders; return whether it does."""
        state = await self._read_state()
        if state is ProgramState.WAITING:
            return await self._read_request() == await self._read_acknowledged()
        if state is ProgramState.STOPPED:
            await self._release_stop()
        else:
            await self._order_stop()
        return False

    async def stop(self) -> None:
        """Brake, and return when the program has confirmed it or does not run.

        A stop that is released before the program has seen it would not have been one.

        Raises
        ------
        MotionStoppedError
            The program runs on and has not confirmed the stop.
        """
        await self._order_stop()
        before = await self._read_heartbeat_counter()
        for _ in range(_POLLS_AT_STOP):
            if await self._read_state() in (ProgramState.STOPPED, ProgramState.OFF):
                return
            await asyncio.sleep(_POLL_S)
        if await self._read_heartbeat_counter() != before:
            raise self._stop_unconfirmed_error()

    async def has_finished(self, request: int) -> bool:
        """Return whether a step was acknowledged; raise where the program was stopped.

        The acknowledgement is read first: a stopped step is acknowledged too, and a state read before it
        could still be that of before the step.
        """
        await self.beat()
        acknowledged = await self._read_acknowledged() == request
        state = await self._read_state()
        if state is ProgramState.REFUSED:
            raise await self._refused_error()
        if state not in (ProgramState.WAITING, ProgramState.MOVING):
            raise self._stopped_error()
        return acknowledged and state is ProgramState.WAITING

    async def require_alive(self) -> None:
        """Raise where the program does not count: it was stopped in its step, which its state does not tell."""
        before = await self._read_heartbeat_counter()
        for _ in range(_POLLS_AT_STOP):
            await self.beat()
            if await self._read_heartbeat_counter() != before:
                return
            await asyncio.sleep(_POLL_S)
        raise self._stopped_error()

    async def _next_request(self) -> int:
        return await self._read_acknowledged() % _HIGHEST + 1

    async def _start_step(self, request: int) -> int:
        """Order the step whose target and speed are written; the request is written last."""
        await self.beat()
        await self._write_request(request)
        return request
