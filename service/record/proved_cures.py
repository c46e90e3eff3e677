"""Cures at the pendant that passed after a robot's position record, and what the controller showed in them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.mastering.position_record import ShownValue
from cellcal.procedures.run_history import EventKind
from cellcal.service.record.journal import JournalEvent

POSITION_RECORD = "position_record"
_CURE, _PASS = "position_cure", "pass"
_SHOWN: TypeAdapter[tuple[ShownValue, ...]] = TypeAdapter(tuple[ShownValue, ...])


@dataclass(frozen=True, slots=True)
class ProvedCure:
    """One cure whose lengths proved every axis."""

    run_id: str
    shown: tuple[ShownValue, ...] = ()  # after the work at the pendant; empty where its end does not tell it


def newest_cures(events: Iterable[JournalEvent], robot_serial: str) -> tuple[ProvedCure | None, str]:
    """Return the newest cure of a robot that passed after its position record, and the run of an unproved one since.

    A cure that is gone on with counts by its next end.
    """
    cures, proofs, open_run = set[str](), dict[str, ProvedCure](), ""
    for event in events:
        if event.kind == EventKind.STARTED and is_run_of(parse_json(event.body), _CURE, robot_serial):
            cures.add(event.run_id)
        elif event.kind in (EventKind.RESUMED, EventKind.FORGOTTEN, EventKind.ENDED):
            proofs.pop(event.run_id, None)  # it goes on: only its next end counts
        if event.kind == EventKind.ENDED and event.run_id in cures:
            end = parse_json(event.body)
            word = (end.get("judgement") or {}).get("word")
            if word == _PASS:
                proofs[event.run_id] = ProvedCure(event.run_id, _read_shown(end.get("result")))
            open_run = "" if word == _PASS else event.run_id if word else open_run
        elif event.kind == EventKind.STORED and (proofs or open_run):
            fact = parse_json(event.body)
            if (fact["what"], fact["robot_serial"]) == (POSITION_RECORD, robot_serial):
                proofs.clear()
                open_run = ""
    return next(reversed(proofs.values()), None), open_run


def is_run_of(header: Mapping[str, Any], procedure: str, robot_serial: str) -> bool:
    """Return whether the head of a run is that of a procedure on a robot."""
    robot = header["cell"]["devices"][0]["identity"]["serial"]
    return bool(header["procedure"] == procedure and robot == robot_serial)


def _read_shown(result: Any) -> tuple[ShownValue, ...]:
    try:
        return _SHOWN.validate_python((result or {}).get("shown", ()))
    except (ValidationError, AttributeError):
        return ()
