"""The handshake with the background program CELLCAL: one request at a time, followed to its end.

Nothing here trusts a value because it was answered: the program's counter must move on between two looks.
"""

import asyncio
import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    MotionStoppedError,
    RefusedError,
    UnreachableError,
)
from cellcal.drivers.modbus_robot.profile import Operation
from cellcal.drivers.modbus_robot.register_client import RegisterClient
from cellcal.drivers.wire.move_timeout import MoveTimeout
from cellcal.drivers.wire.tables import CodeEntry, code_table

_LOG = logging.getLogger(__name__)
_POLL_S = 0.01
_OVERRIDE_EVERY_S = 0.5
_LAST_NUMBER = 2**31 - 1
_ARGUMENTS = 6
_PRESS_STOP = "Press the emergency stop if the arm still moves, then look at the controller."


class SwitchMode(IntEnum):
    """R[125]."""

    AUTO = 1
    T1 = 2
    T2 = 3


class RequestPhase(IntEnum):
    """R[122]."""

    IDLE = 0
    RUNNING = 1
    DONE = 2
    REFUSED = 3
    STOPPED = 4


@dataclass(frozen=True, slots=True)
class ProgramState:
    """The state that the program reports, from one telegram."""

    answered: int
    phase: int
    reason: int
    moving: bool
    mode: int
    emergency: bool
    counter: int

    @property
    def mode_name(self) -> str:
        """The mode switch as the maker calls its places."""
        return (
            SwitchMode(self.mode).name
            if self.mode in set(SwitchMode)
            else make_message("mode {mode}", mode=self.mode)
        )


@dataclass(frozen=True, slots=True)
class ProgramRequest:
    """One operation with its arguments in SI units."""

    operation: Operation
    axis: int = 0  # 0-based
    arguments_rad: Sequence[float] = ()
    speed_rad_s: float = 0.0
    within_s: float = 1.0  # of real time, beyond what the override stretches
    full_override_s: float = 0.0  # what its motion takes at most at full override
    speed_share: float | None = None  # of each axis' own speed limit, where the controller wants that


class CellProgram:
    """Lets the program do one thing and waits for its end."""

    def __init__(self, panel: RegisterClient, *, deadline_s: float) -> None:
        self._panel, self._deadline_s = panel, deadline_s
        self._device, self._limits = panel.device, panel.profile.limits
        self._stops = 0
        self._beats = 0

    async def read_state(self) -> ProgramState:
        """Read the program's state once."""
        block = await self._panel.read_block("program")
        return ProgramState(
            answered=block.integer_of("answered"),
            phase=block.integer_of("state"),
            reason=block.integer_of("reason"),
            moving=block.integer_of("moving") != 0,
            mode=block.integer_of("mode"),
            emergency=block.integer_of("emergency") != 0,
            counter=block.integer_of("counter"),
        )

    async def newer_than(self, before: ProgramState) -> ProgramState:
        """Look until the counter has moved on: what was read in between is alive."""
        limit_s = time.monotonic() + self._limits.stale_after_s
        while True:
            state = await self.read_state()
            if state.counter != before.counter:
                return state
            if time.monotonic() > limit_s:
                raise self._stale_values_error()
            await asyncio.sleep(_POLL_S / 2)

    async def run_request(self, request: ProgramRequest) -> None:
        """Do one request to its end. Whatever goes wrong after its start, cancellation too, stops the arm."""
        stops = self._stops
        number = await self._next_number()
        await self._panel.write_registers(self._request_arguments(request))
        if self._stops != stops:
            raise self._request_error(8, stopped=True)
        try:
            await self._panel.write_registers({"request": (number,)})
            last = await self._follow_request(number, request)
        except BaseException:
            await self._halt_quietly()
            raise
        if last.phase == RequestPhase.STOPPED:
            await self._halt_quietly()
        if last.phase != RequestPhase.DONE:
            raise self._request_error(last.reason, stopped=last.phase == RequestPhase.STOPPED)

    async def hold_arm(self) -> None:
        """Hold the arm and wait until it stands."""
        self._stops += 1
        await self._panel.write_registers({"hold": (1,)})
        limit_s = time.monotonic() + self._deadline_s
        before = await self.read_state()
        while True:
            state = await self.newer_than(before)
            if not state.moving and state.phase != RequestPhase.RUNNING:
                return
            if time.monotonic() > limit_s:
                raise DeviceTimeoutError(
                    self._device, "the arm did not come to a standstill after a stop.", remedy=_PRESS_STOP
                )
            await asyncio.sleep(_POLL_S)

    async def _next_number(self) -> int:
        """Return a number that the program has not seen, while it is alive and idle."""
        state = await self.newer_than(await self.read_state())
        if state.moving or state.phase == RequestPhase.RUNNING:
            raise self._request_error(4, stopped=False)
        last_number = (await self._panel.read_registers("request")).integer_of("request")
        last = max(last_number, state.answered)
        return last + 1 if 0 <= last < _LAST_NUMBER else 1

    def _request_arguments(self, request: ProgramRequest) -> dict[str, Sequence[float]]:
        target = (*request.arguments_rad, *(0.0,) * (_ARGUMENTS - len(request.arguments_rad)))
        return {
            "operation": (self._panel.profile.operations[request.operation],),
            "number": (request.axis + 1,),
            "target": target,
            "speed": (request.speed_rad_s if request.speed_share is None else request.speed_share,),
            "hold": (0,),
            "heartbeat": (self._next_beat(),),
        }

    async def _follow_request(self, number: int, request: ProgramRequest) -> ProgramState:
        """Keep the heartbeat up until the request is done, refused or stopped."""
        pulse = _Heartbeat(self._limits.stale_after_s, self._limits.heartbeat_s)
        patience = MoveTimeout(request.full_override_s, request.within_s, time.monotonic())
        override, override_at_s = 1.0, float("-inf")
        taken = False
        while True:
            state = await self.read_state()
            if not pulse.is_alive(state.counter):
                raise self._stale_values_error()
            if state.answered == number:
                taken = True
                if _has_ended(state):
                    return state
            if request.full_override_s and time.monotonic() - override_at_s > _OVERRIDE_EVERY_S:
                override = (await self._panel.read_registers("override")).numbers_of("override")[0]
                override_at_s = time.monotonic()
            over = patience.has_expired(time.monotonic(), override)
            self._check_time(patience.passed_s(), over, taken, state.answered == number, request)
            if pulse.beat_is_due():
                await self._panel.write_registers({"heartbeat": (self._next_beat(),)})
            await asyncio.sleep(_POLL_S)

    def _check_time(
        self, passed_s: float, over: bool, taken: bool, ours: bool, request: ProgramRequest
    ) -> None:
        if taken and not ours:
            raise MotionStoppedError(
                self._device,
                "the program left our request: the controller restarted, or another computer commands it.",
                remedy="Make sure that only one computer commands this controller, then repeat the step.",
            )
        if not taken and passed_s > self._deadline_s:
            raise DeviceTimeoutError(
                self._device,
                "the program CELLCAL did not take the request.",
                remedy="Check on the pendant that CELLCAL runs and no alarm is active.",
            )
        if over:
            raise DeviceTimeoutError(
                self._device,
                make_message(
                    "{operation} did not end within {passed_s:.1f} s.",
                    operation=request.operation,
                    passed_s=passed_s,
                ),
                remedy="Check the override and that nothing blocks the arm, then repeat the step.",
            )

    async def _halt_quietly(self) -> None:
        """Stop on the way out of a failure; the failure itself is raised to the caller."""
        try:
            async with asyncio.timeout(self._deadline_s):
                await self.hold_arm()
        except (DeviceError, TimeoutError) as error:
            _LOG.warning("%s: could not confirm standstill: %s", self._device, error)

    def _next_beat(self) -> int:
        self._beats = self._beats % _LAST_NUMBER + 1
        return self._beats

    def _stale_values_error(self) -> UnreachableError:
        return UnreachableError(
            self._device,
            "the controller answers, but its program CELLCAL stands still, so its values are stale.",
            remedy="Start the background program CELLCAL on the controller, then repeat the step.",
        )

    def _request_error(self, reason: int, *, stopped: bool) -> DeviceError:
        entry = code_table("cellcal.drivers.modbus_robot", "reasons.tsv").get(reason, _unknown_reason(reason))
        if stopped or entry.kind == "stopped":
            return MotionStoppedError(
                self._device,
                make_message("the robot stopped: {entry_text}.", entry_text=entry.text),
                remedy=entry.remedy,
            )
        return RefusedError(
            self._device,
            make_message("the robot refused: {entry_text}.", entry_text=entry.text),
            remedy=entry.remedy,
            vendor_code=reason,
            vendor_text=entry.text,
        )


class _Heartbeat:
    """Whether the program still runs, and when it needs the next heartbeat."""

    def __init__(self, stale_after_s: float, heartbeat_s: float) -> None:
        self._stale_after_s, self._heartbeat_s = stale_after_s, heartbeat_s
        self._counter: int | None = None
        self._changed_s = self._last_beat_s = time.monotonic()

    def is_alive(self, counter: int) -> bool:
        now_s = time.monotonic()
        if counter != self._counter:
            self._counter, self._changed_s = counter, now_s
        return now_s - self._changed_s <= self._stale_after_s

    def beat_is_due(self) -> bool:
        now_s = time.monotonic()
        if now_s - self._last_beat_s < self._heartbeat_s:
            return False
        self._last_beat_s = now_s
        return True


def _has_ended(state: ProgramState) -> bool:
    if state.phase == RequestPhase.DONE:
        return not state.moving
    return state.phase in (RequestPhase.REFUSED, RequestPhase.STOPPED)


def _unknown_reason(reason: int) -> CodeEntry:
    return CodeEntry(
        reason, "refused", make_message("reason {number}", number=reason), "Look at the controller's pendant."
    )
