"""Times of day as files and messages carry them: ISO 8601 with a time zone; and one that setting the clock leaves."""

import sys
import time
from datetime import date, datetime

# Linux' goes on while the computer sleeps.
_UPTIME = time.CLOCK_BOOTTIME if sys.platform == "linux" else time.CLOCK_MONOTONIC
_STARTED_S = time.time() - time.clock_gettime(_UPTIME)


def steady_time() -> float:
    """Return the time of day [s] at the start of this process and what passed since, however the clock is set."""
    return _STARTED_S + time.clock_gettime(_UPTIME)


def read_time(text: str) -> datetime:
    """Return a time of day.

    Raises
    ------
    ValueError
        It is none, or has no time zone: the moment is ambiguous.
    """
    found = datetime.fromisoformat(text)
    if found.tzinfo is None:
        raise ValueError(f"the time {text!r} has no time zone")
    return found


def read_day(text: str) -> date:
    """Return a day; raises ValueError where it is none."""
    return date.fromisoformat(text)


def has_time_zone(text: str) -> bool:
    """Whether a text is a time of day with a time zone."""
    try:
        read_time(text)
    except ValueError:
        return False
    return True
