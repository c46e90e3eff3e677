"""The time of the fake world.

Imitates
    One clock that every fake device shares. World seconds run ``time_factor`` times as fast as real ones.
Source
    tests/README: fast-forward changes the world's time only, never the event loop's.
Modelled
    A factor from 0 (stands still until ``advance``) to several thousand, which ``set_time_factor`` changes;
    jumps ahead with
    ``advance``.
Not modelled
    Clocks that differ from device to device. Link timers (heartbeats, cyclic telegrams, a program's cycle
    counter, how long a link fault lasts) are real time: agreements with a client that runs in real time.
"""

import asyncio
import time


class WorldClock:
    """World seconds since the world began."""

    def __init__(self, time_factor: float = 1.0) -> None:
        self.time_factor = _check_factor(time_factor)
        self._real_origin_s = time.monotonic()
        self._jumped_s = 0.0
        self._jumped = asyncio.Event()

    def now_s(self) -> float:
        """Return world seconds."""
        return self._jumped_s + self.time_factor * self.real_now_s()

    def real_now_s(self) -> float:
        """Return real seconds since the world began, for link timers."""
        return time.monotonic() - self._real_origin_s

    def world_time_at(self, real_s: float) -> float:
        """Return the world time at a real time, as if no jump, and no other pace, had happened since."""
        return self._jumped_s + self.time_factor * real_s

    def advance(self, seconds: float) -> None:
        """Jump ahead; never back."""
        if not seconds >= 0.0:
            raise ValueError("the clock does not run backwards")
        self._jumped_s += seconds
        self._jumped.set()
        self._jumped = asyncio.Event()

    def set_time_factor(self, time_factor: float) -> None:
        """Run faster or slower from now on."""
        now_s = self.now_s()
        self.time_factor = _check_factor(time_factor)
        self._jumped_s += now_s - self.now_s()
        self.advance(0.0)  # sleeping tasks compute their time again

    async def sleep_until(self, world_s: float) -> None:
        """Wait until the world's time has come, also when it jumps."""
        while (left_s := world_s - self.now_s()) > 0.0:
            real_s = left_s / self.time_factor if self.time_factor > 0.0 else 3600.0
            jumped = self._jumped
            try:
                async with asyncio.timeout(min(max(real_s, 0.0005), 3600.0)):
                    await jumped.wait()
            except TimeoutError:
                continue

    async def sleep(self, seconds: float) -> None:
        """Wait that many world seconds."""
        await self.sleep_until(self.now_s() + seconds)


def _check_factor(time_factor: float) -> float:
    if not 0.0 <= time_factor <= 1e5:
        raise ValueError(f"time_factor {time_factor} is outside 0 to 100000")
    return time_factor
