"""Hold to move: a second consent on top of the robot's own enabling device, never a replacement for it.

A move begins while the button is held, and the robot is asked to stop when it is let go, when the screen falls
silent, or when it hides. Held again, the move goes on to where it was going: a joint move stands still on its
own straight line, so the rest of the way was checked with the whole.
"""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from cellcal.drivers.interfaces import Joints

DEAD_MAN_S = (
    0.45  # let go within half a second, the way to the robot included; a screen says "held" four times in it
)


class HoldButton:
    """The button on a screen, as last known of: held until so long after the last moment when it surely was."""

    def __init__(self, changed: Callable[[], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._changed, self._clock = changed, clock
        self._last_received_s = float("-inf")
        self._wake = asyncio.Event()
        self.is_required = False  # whether moves of this run need it
        self.waiting = False  # a move waits for it

    @property
    def is_held(self) -> bool:
        """Whether the button is held now."""
        return self._clock() - self._last_received_s < DEAD_MAN_S

    def update_state(self, *, is_held: bool, age_s: float = 0.0) -> None:
        """Take note of what a screen says, and how long ago it may have said so: that much is over already."""
        self._last_received_s = (
            max(self._last_received_s, self._clock() - age_s) if is_held else float("-inf")
        )
        self._wake.set()

    async def wait_until_held(self) -> None:
        """Wait until a screen holds the button."""
        self.waiting = True
        self._changed()
        try:
            while not self.is_held:
                self._wake.clear()
                await self._wake.wait()
        finally:
            self.waiting = False
            self._changed()

    async def until_released(self) -> None:
        """Wait until the hold button is released."""
        while self.is_held:
            self._wake.clear()
            remaining = DEAD_MAN_S - (self._clock() - self._last_received_s)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), max(remaining, 0.01))


class HoldToMoveRobot:
    """A robot whose moves need the button, where the run says so; everything else goes straight through."""

    def __init__(self, robot: Any, hold: HoldButton) -> None:
        self._robot, self._hold = robot, hold

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)

    async def move_joints(self, target_rad: Joints, *, speed_rad_s: float) -> None:
        while not await self._move_while_held(
            partial(self._robot.move_joints, target_rad, speed_rad_s=speed_rad_s)
        ):
            pass

    async def jog_axis(self, axis: int, delta_rad: float, *, speed_rad_s: float) -> None:
        remaining = delta_rad
        while True:
            before = (await self._robot.read_joints()).joints_rad[axis]
            jog = partial(self._robot.jog_axis, axis, remaining, speed_rad_s=speed_rad_s)
            if await self._move_while_held(jog):
                return
            remaining -= (await self._robot.read_joints()).joints_rad[axis] - before

    async def _move_while_held(self, start: Callable[[], Awaitable[None]]) -> bool:
        """Move while the button is held; return whether the move has ended by itself."""
        if not self._hold.is_required:
            await start()
            return True
        await self._hold.wait_until_held()
        move = asyncio.ensure_future(start())
        released = asyncio.ensure_future(self._hold.until_released())
        try:
            await asyncio.wait({move, released}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            released.cancel()
            arrived = move.done()
            move.cancel()  # a cancelled move stops the arm and waits for standstill
            await asyncio.wait({move})
        if not move.cancelled():
            move.result()  # arrived, or the robot's own reason why not
        return arrived or not move.cancelled()
