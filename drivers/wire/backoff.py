"""When to try a lost link again: soon at first, then less often, and never in a storm."""

import asyncio
import time


class Backoff:
    """Doubles the pause after each failure; a success starts over."""

    def __init__(self, *, first_s: float = 0.05, longest_s: float = 0.5) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self._pause_s = 0.0
        self._not_before_s = 0.0

    async def wait(self) -> None:
        """Sleep until the next attempt is due."""
        await asyncio.sleep(max(0.0, self._not_before_s - time.monotonic()))

    def note_failure(self) -> None:
        """Note a failed attempt."""
        self._pause_s = min(self._longest_s, max(self._first_s, 2 * self._pause_s))
        self._not_before_s = time.monotonic() + self._pause_s

    def note_success(self) -> None:
        """Start over."""
        self._pause_s = 0.0
        self._not_before_s = 0.0
