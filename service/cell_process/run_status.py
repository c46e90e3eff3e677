"""What a screen knows of the run under way: its steps as planned, where it stands, how it ended."""

from dataclasses import dataclass, field

from cellcal.procedures.procedure_definition import Phase, with_planned_counts
from cellcal.procedures.progress import StepProgress
from cellcal.service.cell_process.plan_progress import PlanProgress
from cellcal.service.cell_process.remaining_time import RemainingTime
from cellcal.service.session_documents import OutcomeDocument, RunDocument, RunEventDocument

_MOST_EVENTS = 200  # events; the journal has them all


@dataclass(slots=True)
class RunStatus:
    """One run, from its start until a person leaves its page."""

    procedure: str
    title: str
    who: str  # began or resumed it; the watch and the service are told as such
    phases: tuple[Phase, ...] = ()
    run_id: str = ""
    state: str = "starting"  # starting, running, paused, ended
    step: str = ""
    index: int = 0
    expected: int = 0
    events: list[RunEventDocument] = field(default_factory=list)
    found: list[str] = field(
        default_factory=list
    )  # of a run that goes on, from its journal: before it is replayed
    outcome: OutcomeDocument | None = None
    hold_to_move: bool = False
    does: str = ""  # what the present step does: read, move, write, solve
    instrument: str = ""  # the role of the one that was asked for a reading last
    time_left: RemainingTime = field(default_factory=RemainingTime)
    series: PlanProgress = field(default_factory=PlanProgress)

    @property
    def has_ended(self) -> bool:
        """Whether nothing of it goes on."""
        return self.state == "ended"

    def record_progress(self, progress: StepProgress) -> None:
        """Note one event of the run."""
        self.step, self.index = progress.step, progress.index
        if progress.page is not None:
            self.phases = with_planned_counts(
                self.phases, progress.page.data.get("plan", {}).get("planned", {})
            )
        self.expected = sum(len(phase.step_names) for phase in self.phases) or progress.expected
        self.time_left.phases = self.phases
        self.time_left.record_progress(progress)
        self.series.record_progress(progress)
        if progress.kind == "started":
            self.does = progress.does
        if progress.kind in ("finding", "replayed") and progress.step not in self.found:
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
        del self.events[:-_MOST_EVENTS]

    def as_json(self) -> RunDocument:
        """Return it for a screen."""
        return {
            "id": self.run_id,
            "procedure": self.procedure,
            "title": self.title,
            "who": self.who,
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
            "instrument": self.instrument,
            "left_s": None if self.has_ended else self.time_left.estimate_seconds(),
            "series": None if self.has_ended else self.series.as_json(),
        }
