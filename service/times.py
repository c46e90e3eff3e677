"""Times of day as files and messages carry them: ISO 8601 with a time zone."""

from datetime import datetime


def read_time(text: str) -> datetime:
    """Return a time of day.

    Raises
    ------
    ValueError
        It is none, or has no time zone: nobody could tell which moment is meant.
    """
    found = datetime.fromisoformat(text)
    if found.tzinfo is None:
        raise ValueError(f"the time {text!r} has no time zone")
    return found
