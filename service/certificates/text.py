"""A certificate for people: 80 columns, millimetres and degrees. What is signed is the JSON file beside it."""

import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from cellcal.service.certificates.sign_offs import unsigned
from cellcal.service.certificates.words import (
    NO_TEMPERATURE,
    WHOLE_RESULT,
    WORDS,
    accepted_by,
    answers_by_person,
    at_time,
    change_rows,
    controller_rows,
    figure_in_words,
    file_stem,
    head_rows,
    made_with_rows,
    picture_rows,
    short_facts,
    sign_off_rows,
)

WIDTH = 80
_RULE = "=" * WIDTH


def as_text(content: Mapping[str, Any], sha256: str, public_key: str) -> str:
    """Return the certificate as a page of text."""
    run, verdict, refusal = content["run"], content["verdict"], content.get("refusal")
    sections = (
        ("", _head(content)),
        ("The controller when the run began", _named(controller_rows(content))),
        ("Verdict", [WORDS[verdict["word"]], *_optional("judged by ", verdict.get("limits_from"))]),
        ("Why it was refused", _optional("", refusal and refusal["reason"])),
        ("What to do next", _optional("", refusal and refusal["remedy"])),
        ("What was decided", _figures(verdict["characteristics"])),
        ("Before and after", _changes(verdict.get("changes", []))),
        ("Evidence" if refusal else "Result", _result(content["result"])),
        ("Remarks", _bullets(verdict.get("remarks", []))),
        ("Not verified", _bullets([*verdict.get("not_verified", []), *_environment(content)])),
        ("Measurements", _points(content["points"])),
        ("Accepted, approved and signed", _sign_off(content.get("sign_off", []))),
        ("Photos", _photos(content.get("pictures", []))),
        ("People", _people(content["people"])),
        ("Traceability and safety", [*_wrapped(content["traceability"]), *_wrapped(content["safety"])]),
        ("To be signed by hand", _to_sign(unsigned(content))),
        ("Made with", _made_with(run)),
        (
            "Signature",
            _signature(file_stem(content), run, sha256, public_key),
        ),
    )
    lines = ["REFUSAL RECORD" if refusal else "CALIBRATION REPORT", _RULE]
    for title, body in sections:
        if body:
            lines += ([title, "-" * len(title)] if title else []) + [*body, ""]
    return "\n".join(_clipped(lines)) + "\n"


def _head(content: Mapping[str, Any]) -> list[str]:
    return _named([*head_rows(content), ("status", content["status"])])


def _named(rows: Iterable[tuple[str, str]]) -> list[str]:
    return [line for name, value in rows for line in _wrapped(value, f"{name:<16}")]


def _figures(characteristics: Iterable[Mapping[str, Any]]) -> list[str]:
    lines: list[str] = []
    for figure in map(figure_in_words, characteristics):
        lines += _wrapped(figure.name, f"{figure.word:<10} ", 11)
        lines += [line for text in (figure.told, figure.rule) if text for line in _wrapped(text, " " * 11)]
        for name, u, source in figure.budget:
            lines += _wrapped(f"budget: {name}, u = {u} ({source})", " " * 11)
    return lines


def _changes(changes: Iterable[Mapping[str, Any]]) -> list[str]:
    rows = [f"{name:<32.32}{before:>20}{after:>20}" for name, before, after in change_rows(changes)]
    return [f"{'':<32}{'before':>20}{'after':>20}", *rows] if rows else []


def _result(result: Any) -> list[str]:
    """Return what fits on a line, and where the rest is."""
    if result is None:
        return []
    lines = [line for name, value in short_facts(result) for line in _wrapped(value, f"{name}: ", 4)]
    return [*lines, WHOLE_RESULT]


def _points(points: list[Mapping[str, Any]]) -> list[str]:
    unused = [point for point in points if not point["used"]]
    lines = [f"{len(points)} readings, {len(points) - len(unused)} used; each one is in the JSON file."]
    for point in unused:
        lines += _wrapped(f"{point['step']}: {point['reason']}", "  not used: ", 4)
    return lines


def _people(people: list[Mapping[str, str]]) -> list[str]:
    lines = []
    for who, own in answers_by_person(people):
        told = (
            f"{who}: {len(own)} answers from {at_time(own[0]['at_utc'])} to {at_time(own[-1]['at_utc'])} UTC"
        )
        accepted = accepted_by(own)
        lines += _wrapped(told + (f"; accepted: {accepted}" if accepted else ""))
    return lines


def _sign_off(given: Iterable[Mapping[str, Any]]) -> list[str]:
    lines: list[str] = []
    for what, who, role, at, shown in sign_off_rows(given):
        lines += _wrapped(what, "* ", 2)
        lines += _wrapped(f"by {who} ({role}), {at} UTC", "    ")
        lines += _wrapped(shown, "    ") if shown else []
    return lines


def _photos(pictures: Iterable[Mapping[str, Any]]) -> list[str]:
    lines: list[str] = []
    for what, who, at, sha256 in picture_rows(pictures):
        lines += [*_wrapped(f"{what}, by {who}, {at} UTC", "* ", 2), f"  SHA-256 {sha256}"]
    return lines


def _environment(content: Mapping[str, Any]) -> list[str]:
    return [] if content["environment"] else [NO_TEMPERATURE]


def _to_sign(lines: Iterable[str]) -> list[str]:
    fields = "Name ______________________  Date ______________  Signature ________________"
    return [line for text in lines for line in (*_wrapped(text, "[ ] ", 4), "", f"    {fields}"[:WIDTH])]


def _made_with(run: Mapping[str, Any]) -> list[str]:
    lines: list[str] = []
    for software, definition in made_with_rows(run):
        lines += _wrapped(software)
        lines += _wrapped(definition, "definition      ")
    return lines


def _signature(file: str, run: Mapping[str, Any], sha256: str, public_key: str) -> list[str]:
    return [
        f"journal head    {run['journal_head_sha256']}",
        f"content SHA-256 {sha256}",
        f"public key      {public_key}",
        *_wrapped(
            f"This page is a rendering. What is signed is {file}.json; check it with `cellcal verify FILE "
            "--key PUBKEY`. A check tells that it is unchanged and which key signed it, not whose key that is."
        ),
    ]


def _optional(before: str, text: str | None) -> list[str]:
    return _wrapped(before + text) if text else []


def _bullets(lines: Iterable[str]) -> list[str]:
    return [wrapped for line in lines for wrapped in _wrapped(line, "* ", 2)]


def _wrapped(text: str, first: str = "", indent: int | None = None) -> list[str]:
    rest = " " * (len(first) if indent is None else indent)
    return textwrap.wrap(str(text), WIDTH, initial_indent=first, subsequent_indent=rest) or [first.rstrip()]


def _clipped(lines: Iterable[str]) -> list[str]:
    return [line.rstrip()[:WIDTH] for line in lines]
