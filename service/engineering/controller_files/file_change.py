"""One difference between a controller's files and its newest record."""

from dataclasses import dataclass
from enum import StrEnum


class ChangeKind(StrEnum):
    """The kinds of change; the order is that of their gravity."""

    LOSS = "loss"
    OTHER_ROBOT = "other robot"
    CONTRADICTION = "contradiction"
    COPIED = "copied mastering"
    OLD_BACKUP = "old backup"
    MASTERING = "mastering"
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
