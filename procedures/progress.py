"""What a run shows while it goes on, and the gate where it can wait."""

import asyncio
from dataclasses import dataclass
from typing import Any

from cellcal.drivers.interfaces import Joints
from cellcal.procedures.instruction_page import InstructionPage


@dataclass(frozen=True, slots=True)
class StepProgress:
    """The progress that a screen shows: which step, its number and their count, and its outcome."""

    kind: str  # started, finding, replayed, condition, failed, asked, answered, paused, resumed, ended
    step: str
    index: int  # 1-based
    expected: int
    message: str = ""
    value: Any = None  # JSON
    does: str = ""  # of a step: read, move, write, solve
    page: InstructionPage | None = None  # of a step that asks: what it shows
    goal_rad: Joints | None = None  # where a step that moves wants to be


class PauseGate:
    """Lets a run pause at the border between two steps."""

    def __init__(self) -> None:
        self._open = asyncio.Event()
        self._open.set()

    @property
    def is_closed(self) -> bool:
        """Whether the run will wait before its next step."""
        return not self._open.is_set()

    def pause(self) -> None:
        """Let the present step finish, then wait."""
        self._open.clear()

    def resume(self) -> None:
        """Go on."""
        self._open.set()

    async def wait_until_open(self) -> None:
        """Wait until the gate is open."""
        await self._open.wait()


def ignore_progress(_: StepProgress) -> None:
    """Show nothing."""
