"""Who accepted, approved and signed what of a run, in which role and when: folded from its journal."""

from collections.abc import Iterable, Mapping
from typing import Any, TypedDict

from cellcal.calibration.documents.json_text import parse_json
from cellcal.procedures.run_history import EventKind
from cellcal.service.record.journal import JournalEvent

_APPROVED = ("approve", "may_")  # how the keys of questions begin that let a robot move


class SignOffEntry(TypedDict):
    """One acceptance, approval or signature."""

    did: str
    what: str
    what_sha256: str
    who: str
    people: list[dict[str, str]]
    at_utc: str


def list_sign_offs(events: Iterable[JournalEvent]) -> list[SignOffEntry]:
    """Return every acceptance, approval and signature of a run, in the order given.

    Each has ``did`` (accepted, approved or signed), ``what`` (the step, or the line that was signed), ``who`` as
    entered, ``people`` (name and role at that moment; empty where the journal knows no roles), ``at_utc``, and
    ``what_sha256``: the hash of what was accepted, empty where the words are all.
    """
    roles: dict[str, list[dict[str, str]]] = {}
    found: list[SignOffEntry] = []
    for event in events:
        body = parse_json(event.body)
        if event.kind == EventKind.ANSWERS_AS:
            roles[body["who"]] = body["people"]
        for did, what, sha256 in _sign_off_actions(event.kind, body):
            who = str(body["who"] if "who" in body else body["value"]["who"])
            found.append(
                {
                    "did": did,
                    "what": what,
                    "what_sha256": sha256,
                    "who": who,
                    "people": roles.get(who, []),
                    "at_utc": event.wall_utc,
                }
            )
    return found


def list_unsigned(content: Mapping[str, Any]) -> list[str]:
    """Return the lines that a person must still sign by hand."""
    signed = {entry["what"] for entry in content.get("sign_off", []) if entry["did"] == "signed"}
    return [line for line in content["verdict"].get("to_sign", []) if line not in signed]


def _sign_off_actions(kind: str, body: Mapping[str, Any]) -> Iterable[tuple[str, str, str]]:
    if kind == EventKind.SIGNED:
        return [("signed", line, "") for line in body["lines"]]
    if kind == EventKind.MISSING_END:
        return [("accepted", f"{body['missing']}.", "")]
    if kind == EventKind.APPROVAL:
        return [("approved", f"{body['before']}: {body['text']}", "")]
    if kind not in (EventKind.FINDING, EventKind.CONDITION) or not _is_answer(body["value"]):
        return []
    key, sha256 = _question_key(body["inputs"])
    if sha256:
        return [("accepted", body["step"], sha256)]
    return [("approved", body["step"], sha256)] if key.startswith(_APPROVED) else []


def _is_answer(value: Any) -> bool:
    return isinstance(value, dict) and value.keys() == {"who", "value"}


def _question_key(inputs: Any) -> tuple[str, str]:
    """Return the key of the question that a step asked, and the hash of what it showed."""
    question = inputs[0] if isinstance(inputs, list) and inputs else []
    key = question[0].get("key", "") if question and isinstance(question[0], dict) else ""
    shown = question[1] if len(question) > 1 and isinstance(question[1], str) else ""
    return str(key), shown
