"""What a run already knows: a pure fold over its journalled events."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class EventKind(StrEnum):
    """The events of a run."""

    STARTED = "run_started"
    RESUMED = "run_resumed"
    ENTERED = "step_entered"  # a step that only asks or reads
    INTENT = "intent"  # a step that moves or writes is about to act
    FINDING = "finding"  # the outcome of a step: its value
    CONDITION = "condition"  # a standing condition was found to hold
    FAILED = "failed"  # the outcome of a step that ended otherwise
    APPROVAL = "approval"
    ANSWERS_AS = "answers_as"  # the role in which questions are answered from here on
    MISSING_END = "missing_end_accepted"  # the journal's end was missing, and a person went on all the same
    PICTURE = "picture"  # a photo by its hash; it lies beside the journal
    PAUSED = "paused"
    CONTINUED = "continued"
    FORGOTTEN = "forgotten"  # findings after the n-th no longer count; nothing is deleted
    UNDONE = "undone"  # a mastering was put back before it was confirmed; findings from its write on no longer count
    STORED = "stored"  # a result that outlives its run: mastering record, tool, frame
    ENDED = "run_ended"
    SIGNED = "signed"  # afterwards: a person put a name to what had to be done by hand


class StepEffect(StrEnum):
    """The effect of a step on the world."""

    NONE = "none"
    MOVE = "move"
    WRITE = "write"


@dataclass(frozen=True, slots=True)
class Finding:
    """The value of one step, with what it was asked for. JSON values."""

    step: str
    inputs: Any
    value: Any
    instruments: tuple[str, ...] = ()  # roles of those that were read for it


@dataclass(frozen=True, slots=True)
class RunHistory:
    """Everything a resumed run starts from."""

    findings: tuple[Finding, ...] = ()
    attempts: Mapping[str, int] = field(default_factory=dict)
    in_doubt: str | None = None  # a step that may have acted without an outcome
    resumed: bool = False

    @property
    def instrument_roles(self) -> tuple[str, ...]:
        """Roles of the instruments whose readings count."""
        return tuple(sorted({role for finding in self.findings for role in finding.instruments}))


def fold_events(events: Iterable[tuple[str, Mapping[str, Any]]]) -> RunHistory:
    """Rebuild the past from (kind, body) in order."""
    findings: list[Finding] = []
    attempts: dict[str, int] = {}
    in_doubt: str | None = None
    has_events = False
    for kind, body in events:
        has_events = True
        if kind in (EventKind.ENTERED, EventKind.INTENT):
            attempts[body["step"]] = body["attempt"]
        if kind == EventKind.INTENT:
            in_doubt = body["step"]
        elif kind == EventKind.FINDING:
            read = tuple(body.get("instruments", ()))
            findings.append(Finding(body["step"], body["inputs"], body["value"], read))
            in_doubt = None if in_doubt == body["step"] else in_doubt
        elif kind == EventKind.FAILED:
            in_doubt = _doubt_after_failure(in_doubt, body)
        elif kind in (EventKind.FORGOTTEN, EventKind.UNDONE):
            del findings[body["keep"] :]
            in_doubt = None if kind == EventKind.UNDONE else in_doubt
    return RunHistory(tuple(findings), attempts, in_doubt, resumed=has_events)


def _doubt_after_failure(in_doubt: str | None, body: Mapping[str, Any]) -> str | None:
    settled = body["stopped"] and body["effect"] != StepEffect.WRITE
    return None if settled and in_doubt == body["step"] else in_doubt
