"""One difference between a controller's files and its newest record."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

_MOST_NAMES = 8


class ChangeKind(StrEnum):
    """The kinds of change; the order is that of their gravity."""

    LOSS = "loss"
    OTHER_ROBOT = "other robot"
    CONTRADICTION = "contradiction"
    COPIED = "copied mastering"
    OLD_BACKUP = "old backup"
    MASTERING = "mastering"
    DRIVES = "drives"
    BATTERY = "low battery"
    FRAME = "frame"
    TOOL = "tool"
    SAFETY = "DCS"
    PROGRAM = "program"
    SOFTWARE = "software"
    CLOCK = "clock"


@dataclass(frozen=True, slots=True)
class FileChange:
    """One difference, with its figures."""

    kind: ChangeKind
    text: str


def list_some(names: Sequence[str]) -> str:
    """Write names one after the other, and of many the first ones."""
    rest = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {rest} more" if rest > 0 else "")
