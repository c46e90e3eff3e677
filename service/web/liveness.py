"""Whether the process of the cell hangs: it is asked all the time, and only what it could have answered in counts.

A clock alone would take a busy machine for a process that hangs. What counts is what the process did while a
question was open: computing counts with the processor time that it got, so that one that waits for a processor is
not blamed; being stopped, or asleep with a question to answer, counts in full; waiting for a disk counts a quarter.
A standstill of our own process, or of the whole computer, counts as one tick.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message

TICK_S = 0.5
HANGS_AFTER_S = 10.0
_STARTING = 6.0  # so many times longer until the first answer: it loads its libraries
_DISK, _UNKNOWN = 0.25, 0.3  # shares of a tick
_STAT_STATE, _STAT_USER, _STAT_SYSTEM = 0, 11, 12  # fields of /proc/…/stat behind the name
_COMPUTES, _STOPPED, _WAITS, _DISK_WAIT = "R", "T", "S", "D"


@dataclass(frozen=True, slots=True)
class ProcessState:
    """The state of a process: computes, waits, waits for a disk, or is stopped; and its processor time."""

    does: str
    cpu_s: float


class CellHangsError(CellError):
    """The cell's process runs and does not answer."""

    code = "desk.hangs"

    def __init__(self, does: str) -> None:
        how = {
            _COMPUTES: "it computes without an end",
            _STOPPED: "it was stopped by a signal",
            _DISK_WAIT: "it waits for a disk",
        }.get(does, "it waits for something that does not come")
        super().__init__(
            make_message(
                "the cell's process did not answer any more: {how}. It was ended and is started again; a "
                "run under way was broken off.",
                how=how,
            ),
            remedy="If the robot moves, press the emergency stop. Look at the robot, then resume the run from the "
            "history.",
        )


def read_process_state(pid: int) -> ProcessState | None:
    """Return what a process does, by all its threads; None where the system does not tell."""
    place = Path(f"/proc/{pid}")
    try:
        whole = _stat(place / "stat")
        states = {_state_of(thread) for thread in (place / "task").iterdir()}
        cpu_s = (int(whole[_STAT_USER]) + int(whole[_STAT_SYSTEM])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return None
    does = next((state for state in (_STOPPED, _COMPUTES, _DISK_WAIT) if state in states), _WAITS)
    return ProcessState(does, cpu_s)


class UnansweredTime:
    """The time in which a process could have answered and did not."""

    def __init__(self, hangs_after_s: float = HANGS_AFTER_S) -> None:
        self._hangs_after_s = hangs_after_s
        self._ever = False
        self._before: ProcessState | None = None
        self.counted_s = 0.0

    @property
    def hangs(self) -> bool:
        """Whether it is too long."""
        return self.counted_s > self._hangs_after_s * (1.0 if self._ever else _STARTING)

    @property
    def does(self) -> str:
        """The state of the process at the last look."""
        return "" if self._before is None else self._before.does

    def note_message(self) -> None:
        """Note that the process said something."""
        self._ever, self.counted_s, self._before = True, 0.0, None

    def count(self, state: ProcessState | None, tick_s: float = TICK_S) -> None:
        """Count one tick in which nothing was heard."""
        before, self._before = self._before, state
        if state is None:
            self.counted_s += _UNKNOWN * tick_s
        elif state.does == _COMPUTES:
            used_s = 0.0 if before is None else state.cpu_s - before.cpu_s
            self.counted_s += min(max(used_s, 0.0), tick_s)
        else:
            self.counted_s += tick_s * (_DISK if state.does == _DISK_WAIT else 1.0)


def _stat(path: Path) -> list[str]:
    return path.read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()


def _state_of(thread: Path) -> str:
    try:
        return _stat(thread / "stat")[_STAT_STATE].upper()
    except (FileNotFoundError, ProcessLookupError):  # it has just ended
        return _WAITS
