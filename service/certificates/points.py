"""What a run measured, read from its journal: every reading, and why some of them were not used."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NotRequired, TypedDict

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.procedures.canonical_json import canonical_json, sha256_of
from cellcal.procedures.run import DeclinedError
from cellcal.procedures.run_history import EventKind, StepEffect
from cellcal.service.record.journal import JournalEvent

_LARGEST_VALUE = 20_000  # characters; what is longer, such as a stored record, is named by its hash


class ReadingEntry(TypedDict):
    """A reading of a run. A failed one has no value; a long value is named by its hash."""

    step: str
    at_utc: str
    used: bool
    reason: str  # why it was not used; empty where it was
    value: NotRequired[Any]
    value_sha256: NotRequired[str]


@dataclass(slots=True)
class _RecordedFinding:
    """One finding, and what became of it."""

    step: str
    at_utc: str
    body: Mapping[str, Any]
    reason: str = ""  # why it was not used


def list_readings(events: Sequence[JournalEvent], judgement: Mapping[str, Any] | None) -> list[ReadingEntry]:
    """Return the readings of a run in the order they were taken; those not used carry the reason.

    ``judgement`` is the run's verdict: it names the steps that the procedure itself did not use, with the reason.
    """
    set_aside = {entries["step"]: entries["reason"] for entries in (judgement or {}).get("set_aside", [])}
    entries = [
        _reading_to_json(taken, set_aside) for taken in _all_findings(events) if _is_reading(taken.body)
    ]
    return sorted(entries + _failed_readings(events), key=lambda reading: str(reading["at_utc"]))


def raw_data_sha256(events: Sequence[JournalEvent]) -> str:
    """Return the hash over every finding of the run, discarded ones too, as the journal has them."""
    found = [[taken.step, taken.body["inputs"], taken.body["value"]] for taken in _all_findings(events)]
    return sha256_of(found)


def list_answers(events: Iterable[JournalEvent]) -> list[dict[str, str]]:
    """Return who said yes to what, and when."""
    found = []
    for event in events:
        body = parse_json(event.body)
        who = _answer_author(event.kind, body)
        if who:
            step = str(body.get("step", body.get("before", "")))
            found.append({"who": who, "step": step, "at_utc": event.wall_utc})
    return found


def list_air_states(taken: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the air as instruments reported it with their readings, each different state once."""
    found = {canonical_json(air): air for reading in taken for air in _air_readings_in(reading.get("value"))}
    return list(found.values())


def _all_findings(events: Iterable[JournalEvent]) -> list[_RecordedFinding]:
    """Return all findings ever made; those a redo has discarded say so."""
    counted: list[_RecordedFinding] = []
    everything: list[_RecordedFinding] = []
    for event in events:
        body = parse_json(event.body)
        if event.kind == EventKind.FINDING:
            counted.append(_RecordedFinding(body["step"], event.wall_utc, body))
            everything.append(counted[-1])
        elif event.kind in (EventKind.FORGOTTEN, EventKind.UNDONE):
            for taken in counted[body["keep"] :]:
                taken.reason = make_message(
                    "discarded by {actor}: done again from {body!r}", actor=event.actor, body=body["step"]
                )
            del counted[body["keep"] :]
    return everything


def _is_reading(body: Mapping[str, Any]) -> bool:
    """Return whether a step looked at the world: it neither acted, nor calculated, nor asked a person."""
    value = body["value"]
    is_answer = isinstance(value, dict) and value.keys() == {"who", "value"}
    calculated = isinstance(body["inputs"], dict)
    return bool(body["effect"] == StepEffect.NONE and not calculated and not is_answer)


def _reading_to_json(taken: _RecordedFinding, set_aside: Mapping[str, str]) -> ReadingEntry:
    reason = taken.reason or set_aside.get(taken.step, "")
    document: ReadingEntry = {
        "step": taken.step,
        "at_utc": taken.at_utc,
        "used": not reason,
        "reason": reason,
    }
    value = taken.body["value"]
    if len(canonical_json(value)) > _LARGEST_VALUE:
        return {**document, "value_sha256": sha256_of(value)}
    return {**document, "value": value}


def _failed_readings(events: Iterable[JournalEvent]) -> list[ReadingEntry]:
    """Return the attempts to read that gave nothing; a person's no and a calculation's refusal are none."""
    calculated: set[str] = set()
    failed: list[ReadingEntry] = []
    for event in events:
        body = parse_json(event.body)
        if event.kind == EventKind.ENTERED and isinstance(body["inputs"], dict):
            calculated.add(body["step"])
        if event.kind != EventKind.FAILED or body["effect"] != StepEffect.NONE:
            continue
        if body["step"] not in calculated and body["code"] != DeclinedError.code:
            failed.append(
                {
                    "step": body["step"],
                    "at_utc": event.wall_utc,
                    "used": False,
                    "reason": _failure_reason(body),
                }
            )
    return failed


def _failure_reason(body: Mapping[str, Any]) -> str:
    return make_message("no reading: {body}", body=body["message"] or body["error"])


def _answer_author(kind: str, body: Mapping[str, Any]) -> str:
    if kind == EventKind.APPROVAL:
        return str(body["who"])
    value = body.get("value")
    if kind in (EventKind.FINDING, EventKind.CONDITION) and isinstance(value, dict):
        return str(value.get("who", ""))
    return ""


def _air_readings_in(value: Any) -> list[dict[str, Any]]:
    if isinstance(value, list):
        return [air for part in value for air in _air_readings_in(part)]
    if not isinstance(value, dict):
        return []
    own = [value["air"]] if isinstance(value.get("air"), dict) else []
    return own + [air for key, part in value.items() if key != "air" for air in _air_readings_in(part)]
