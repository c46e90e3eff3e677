"""One motion session: ur-rtde in a process of its own, and a program on the controller that ends when we do.

The controller's program ends, and the arm stops, when it is not fed for ``1 / watchdog_hz`` seconds. Feeding
runs through this event loop and through the child, so a stuck loop, a stuck child and a dead one all stop the
arm. A session is never repaired: after any trouble it is killed, and the next move opens a new one.
"""

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, MotionStoppedError, RefusedError, UnreachableError
from cellcal.drivers.supervision import message_and_remedy_of, start_link_task
from cellcal.drivers.universal_robots.health import translate_refusal
from cellcal.drivers.universal_robots.state import CABLE, Six
from cellcal.drivers.wire.process import ChildProcess

_MODULE = "cellcal.drivers.universal_robots.child"
_TITLE = "the process that commands the arm"
_START_S = 10.0  # of a Python process on a busy machine; the robot has no part in it
_FEEDS_PER_PERIOD = 4.0
_CALL_S = 1.0


@dataclass(frozen=True, slots=True)
class SessionOptions:
    """Options of how a session connects and ends."""

    address: str
    watchdog_hz: float
    connect_s: float
    release_after_s: float


class MotionSession:
    """Commands for the arm while its program runs. One caller at a time."""

    def __init__(self, child: ChildProcess, options: SessionOptions, link_stands: Callable[[], bool]) -> None:
        self._child, self._options, self._link_stands = child, options, link_stands
        self._error: DeviceError | None = None
        self._leaving = False
        self._idle_since_s: float | None = asyncio.get_running_loop().time()
        self._keeper: asyncio.Task[None] | None = None

    @classmethod
    async def open(
        cls, device: str, options: SessionOptions, link_stands: Callable[[], bool]
    ) -> "MotionSession":
        """Start the child, let it connect and upload its program; raise a DeviceError if it cannot.

        ``link_stands`` tells of our own state stream: where that is lost, ur-rtde's connection is lost too,
        and it must be ended before it tries to reconnect.
        """
        child = await ChildProcess.start(device, _MODULE, title=_TITLE, start_s=_START_S)
        try:
            await child.call_verb(
                "connect",
                deadline_s=options.connect_s,
                address=options.address,
                watchdog_hz=options.watchdog_hz,
            )
        except RefusedError as error:
            await child.close()
            raise translate_refusal(error) from error
        except BaseException:
            child.kill("it could not connect")
            await child.close()
            raise
        session = cls(child, options, link_stands)
        session._keeper = start_link_task(
            make_message("control of {device}", device=device), session._keep_alive, session._end_broken
        )
        return session

    @property
    def is_usable(self) -> bool:
        """Whether another move may be started in this session."""
        return self._error is None and not self._leaving and self._child.is_alive

    def raise_failure(self) -> None:
        """Raise what has ended the session, if anything has."""
        if self._error is not None:
            raise self._error

    def begin_move(self) -> None:
        """Keep the session while a move is under way."""
        self._idle_since_s = None

    def end_move(self) -> None:
        """Allow the session to end after a while without a move."""
        self._idle_since_s = asyncio.get_running_loop().time()

    async def move_joints(self, target_rad: Six, speed_rad_s: float, acceleration_rad_s2: float) -> None:
        """Start a move and return; the arm is on its way."""
        self.raise_failure()
        accepted = await self._child.call_verb(
            "move_joints",
            deadline_s=_CALL_S,
            target_rad=list(target_rad),
            speed_rad_s=speed_rad_s,
            acceleration_rad_s2=acceleration_rad_s2,
        )
        if not accepted:
            raise MotionStoppedError(
                self._child.device,
                "the controller did not take the move.",
                remedy="Read the message on the pendant, then try again.",
            )

    async def move_running(self) -> bool:
        """Whether the controller's program still works on the move."""
        return bool(await self._child.call_verb("move_running", deadline_s=_CALL_S))

    async def decelerate_arm(self, deceleration_rad_s2: float, *, deadline_s: float) -> None:
        """Let the arm decelerate; returns before it stands."""
        self.raise_failure()
        await self._child.call_verb("stop", deadline_s=deadline_s, deceleration_rad_s2=deceleration_rad_s2)

    def kill(self, reason: str) -> None:
        """End the child at once; the robot's program ends by its watchdog."""
        self._leaving = True
        self._child.kill(reason)

    async def close(self) -> None:
        """Give the robot back if the child still listens; end it in any case."""
        if self._keeper is not None and not self._leaving:
            self._keeper.cancel()
        if self._keeper is not None:
            await asyncio.wait({self._keeper})
        if self.is_usable:
            await self._leave_robot()
        await self._child.close()

    async def _keep_alive(self) -> None:
        pause_s = 1.0 / (_FEEDS_PER_PERIOD * self._options.watchdog_hz)
        try:
            while self._child.is_alive:
                if self._idle_too_long():
                    await self._leave_robot()
                    return
                if not self._link_stands():
                    raise self._link_lost()
                if not await self._child.call_verb("keep_alive", deadline_s=_CALL_S):
                    raise self._program_ended()
                await asyncio.sleep(pause_s)
            self._error = self._child.ended_error()
        except DeviceError as error:
            self._error = error
            self._child.kill(error.message)

    def _end_broken(self, error: Exception) -> None:
        """End the session that nothing keeps alive any more; the robot's program ends by its watchdog."""
        message, remedy = message_and_remedy_of(error)
        self._error = UnreachableError(
            self._child.device,
            make_message("the program failed while it kept control: {message}.", message=message),
            remedy=remedy,
        )
        self._child.kill(message)

    async def _leave_robot(self) -> None:
        self._leaving = True
        with contextlib.suppress(DeviceError):
            await self._child.call_verb("release", deadline_s=_CALL_S)
        await self._child.close()

    def _idle_too_long(self) -> bool:
        if self._idle_since_s is None:
            return False
        return asyncio.get_running_loop().time() - self._idle_since_s > self._options.release_after_s

    def _link_lost(self) -> UnreachableError:
        return UnreachableError(self._child.device, "the link to the controller was lost.", remedy=CABLE)

    def _program_ended(self) -> MotionStoppedError:
        return MotionStoppedError(
            self._child.device,
            make_message(
                "our program on the controller has ended: stopped at the pendant or by another client, "
                "or because this computer was silent for {watchdog_hz:g} s.",
                watchdog_hz=1 / self._options.watchdog_hz,
            ),
            remedy="Look at the pendant; if it was not stopped there, check the network, then repeat the step.",
        )
