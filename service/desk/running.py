"""What a screen knows of the run under way: its steps as planned, where it stands, how it ended."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from procedures.entry import Phase
from procedures.progress import Progress

_TELLING = 5  # steps, before the time that is left is told
_KEPT = 200  # events; the journal has them all


@dataclass(slots=True)
class Running:
    """One run, from its start until a person leaves its page."""

    procedure: str
    title: str
    phases: tuple[Phase, ...] = ()
    run_id: str = ""
    state: str = "starting"  # starting, running, paused, ended
    step: str = ""
    index: int = 0
    expected: int = 0
    events: list[dict[str, Any]] = field(default_factory=list)
    found: list[str] = field(default_factory=list)
    outcome: dict[str, Any] | None = None
    hold_to_move: bool = False
    does: str = ""  # what the present step does: read, move, write, solve
    clock: Callable[[], float] = time.monotonic
    worked_s: float = 0.0  # in steps that were done since this entry, without waiting for people
    worked: int = 0
    _since_s: float | None = None

    @property
    def ended(self) -> bool:
        """Whether nothing of it goes on."""
        return self.state == "ended"

    def take(self, progress: Progress) -> None:
        """Note one event of the run."""
        self.step, self.index, self.expected = progress.step, progress.index, progress.expected
        self._keep_time(progress)
        if progress.kind in ("finding", "replayed"):
            self.found.append(progress.step)
        if progress.kind in ("paused", "resumed"):
            self.state = "paused" if progress.kind == "paused" else "running"
        elif self.state == "starting":
            self.state = "running"
        self.events.append(
            {
                "n": (self.events[-1]["n"] + 1) if self.events else 1,
                "kind": progress.kind,
                "step": progress.step,
                "message": progress.message,
            }
        )
        del self.events[:-_KEPT]

    @property
    def left_s(self) -> float | None:
        """About how long the rest takes by what was seen so far, people not counted; None: too early to tell."""
        if self.worked < _TELLING or self.ended:
            return None
        return self.worked_s / self.worked * max(self.expected - self.index + 1, 0)

    def _keep_time(self, progress: Progress) -> None:
        now_s = self.clock()
        if progress.kind == "started":
            self.does, self._since_s = progress.does, now_s
        elif progress.kind == "answered":
            self._since_s = now_s
        elif self._since_s is not None and progress.kind in ("asked", "finding"):
            self.worked_s += now_s - self._since_s
            self.worked += progress.kind == "finding"
            self._since_s = None

    def as_json(self) -> dict[str, Any]:
        """Return it for a screen."""
        return {
            "id": self.run_id,
            "procedure": self.procedure,
            "title": self.title,
            "state": self.state,
            "step": self.step,
            "index": self.index,
            "expected": self.expected,
            "phases": [
                {"name": phase.name, "repeats": phase.repeats, "adaptive": phase.adaptive}
                for phase in self.phases
            ],
            "found": self.found,
            "events": self.events[-20:],
            "outcome": self.outcome,
            "hold_to_move": self.hold_to_move,
            "does": self.does,
            "left_s": self.left_s,
        }
