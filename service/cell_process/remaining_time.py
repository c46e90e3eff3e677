"""How long the rest of a run takes, told by the steps seen so far."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from cellcal.procedures.procedure_definition import Phase
from cellcal.procedures.progress import StepProgress

_MANY = 3  # a phase of so many steps is what takes the time: moves and captures, not questions and sums


@dataclass(slots=True)
class PhaseDurations:
    """The steps of one phase: how many are done, how many of them were timed, and how long those took."""

    done: int = 0
    timed: int = 0
    seconds: float = 0.0


@dataclass(slots=True)
class RemainingTime:
    """Keeps the time of a run's steps phase by phase, without waiting for people."""

    phases: tuple[Phase, ...] = ()
    clock: Callable[[], float] = time.monotonic
    _took: dict[str, PhaseDurations] = field(default_factory=dict)
    _worked_s: float = 0.0
    _since_s: float | None = None

    def record_progress(self, progress: StepProgress) -> None:
        """Note one event of the run."""
        now_s = self.clock()
        if progress.kind in ("started", "answered"):
            self._worked_s *= progress.kind == "answered"
            self._since_s = now_s
            return
        if progress.kind in ("asked", "finding") and self._since_s is not None:
            self._worked_s += now_s - self._since_s
        if progress.kind in ("finding", "replayed"):
            self._count_step(progress.step, timed=progress.kind == "finding" and self._since_s is not None)
        self._since_s = None

    def estimate_seconds(self) -> float | None:
        """About how long the rest takes; None until a step of a phase of many was seen.

        A phase that has not begun is taken to be like the phases of many that have.
        """
        many = [
            self._took[p.name] for p in self.phases if len(p.step_names) >= _MANY and p.name in self._took
        ]
        usual_s = _mean_s(many)
        if usual_s is None:
            return None
        left_s = 0.0
        for phase in self.phases:
            took = self._took.get(phase.name, PhaseDurations())
            mean_s = _mean_s([took])
            if mean_s is None:
                mean_s = usual_s if len(phase.step_names) >= _MANY else 0.0
            left_s += mean_s * max(len(phase.step_names) - took.done, 0)
        return left_s

    def _count_step(self, step: str, *, timed: bool) -> None:
        names = [phase.name for phase in self.phases if step.startswith(phase.name)]
        if not names:
            return
        took = self._took.setdefault(max(names, key=len), PhaseDurations())
        took.done += 1
        if timed:
            took.timed += 1
            took.seconds += self._worked_s


def _mean_s(phases: Sequence[PhaseDurations]) -> float | None:
    timed = sum(took.timed for took in phases)
    return sum(took.seconds for took in phases) / timed if timed else None
