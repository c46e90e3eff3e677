"""A certificate for people: 80 columns, millimetres and degrees. What is signed is the JSON file beside it."""

import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.service.certificates.certificate_texts import (
    NO_TEMPERATURE,
    WHOLE_RESULT,
    WORDS,
    answers_by_person,
    change_rows,
    controller_rows,
    describe_figure,
    file_stem,
    format_time,
    head_rows,
    join_accepted,
    made_with_rows,
    picture_rows,
    short_facts,
    sign_off_rows,
)
from cellcal.service.certificates.sign_offs import list_unsigned

WIDTH = 80
_RULE = "=" * WIDTH


def as_text(content: Mapping[str, Any], sha256: str, public_key: str) -> str:
    """Return the certificate as a page of text."""
    run, verdict, refusal = content["run"], content["verdict"], content.get("refusal")
    sections = (
        ("", _head_lines(content)),
        ("The controller when the run began", _named_lines(controller_rows(content))),
        ("Verdict", [WORDS[verdict["word"]], *_optional_lines("judged by ", verdict.get("limits_from"))]),
        ("Why it was refused", _optional_lines("", refusal and refusal["reason"])),
        ("What to do next", _optional_lines("", refusal and refusal["remedy"])),
        ("What was decided", _figure_lines(verdict["characteristics"])),
        ("Before and after", _change_lines(verdict.get("changes", []))),
        ("Evidence" if refusal else "Result", _result_lines(content["result"])),
        ("Remarks", _bullet_lines(verdict.get("remarks", []))),
        ("Not verified", _bullet_lines([*verdict.get("not_verified", []), *_environment_lines(content)])),
        ("Measurements", _point_lines(content["points"])),
        ("Accepted, approved and signed", _sign_off(content.get("sign_off", []))),
        ("Photos", _photo_lines(content.get("pictures", []))),
        ("People", _people_lines(content["people"])),
        ("Traceability and safety", [*_wrap_text(content["traceability"]), *_wrap_text(content["safety"])]),
        ("To be signed by hand", _to_sign(list_unsigned(content))),
        ("Made with", _made_with(run)),
        (
            "Signature",
            _signature_lines(file_stem(content), run, sha256, public_key),
        ),
    )
    lines = ["REFUSAL RECORD" if refusal else "CALIBRATION REPORT", _RULE]
    for title, body in sections:
        if body:
            lines += ([title, "-" * len(title)] if title else []) + [*body, ""]
    return "\n".join(_clip_lines(lines)) + "\n"


def _head_lines(content: Mapping[str, Any]) -> list[str]:
    return _named_lines([*head_rows(content), ("status", content["status"])])


def _named_lines(rows: Iterable[tuple[str, str]]) -> list[str]:
    return [line for name, value in rows for line in _wrap_text(value, f"{name:<16}")]


def _figure_lines(characteristics: Iterable[Mapping[str, Any]]) -> list[str]:
    lines: list[str] = []
    for figure in map(describe_figure, characteristics):
        lines += _wrap_text(figure.name, f"{figure.word:<10} ", 11)
        lines += [
            line for text in (figure.result_line, figure.rule) if text for line in _wrap_text(text, " " * 11)
        ]
        for name, u, source in figure.budget:
            lines += _wrap_text(f"budget: {name}, u = {u} ({source})", " " * 11)
    return lines


def _change_lines(changes: Iterable[Mapping[str, Any]]) -> list[str]:
    rows = [f"{name:<32.32}{before:>20}{after:>20}" for name, before, after in change_rows(changes)]
    return [f"{'':<32}{'before':>20}{'after':>20}", *rows] if rows else []


def _result_lines(result: Any) -> list[str]:
    """Return what fits on a line, and where the rest is."""
    if result is None:
        return []
    lines = [line for name, value in short_facts(result) for line in _wrap_text(value, f"{name}: ", 4)]
    return [*lines, WHOLE_RESULT]


def _point_lines(points: list[Mapping[str, Any]]) -> list[str]:
    unused = [point for point in points if not point["used"]]
    lines = [
        make_message(
            "{point_count} readings, {used} used; each one is in the JSON file.",
            point_count=len(points),
            used=len(points) - len(unused),
        )
    ]
    for point in unused:
        lines += _wrap_text(f"{point['step']}: {point['reason']}", "  not used: ", 4)
    return lines


def _people_lines(people: list[Mapping[str, str]]) -> list[str]:
    lines = []
    for who, own in answers_by_person(people):
        first, last = format_time(own[0]["at_utc"]), format_time(own[-1]["at_utc"])
        summary = f"{who}: {len(own)} answers from {first} to {last} UTC"
        accepted = join_accepted(own)
        lines += _wrap_text(summary + (f"; accepted: {accepted}" if accepted else ""))
    return lines


def _sign_off(sign_offs: Iterable[Mapping[str, Any]]) -> list[str]:
    lines: list[str] = []
    for what, who, role, at, shown in sign_off_rows(sign_offs):
        lines += _wrap_text(what, "* ", 2)
        lines += _wrap_text(f"by {who} ({role}), {at} UTC", "    ")
        lines += _wrap_text(shown, "    ") if shown else []
    return lines


def _photo_lines(pictures: Iterable[Mapping[str, Any]]) -> list[str]:
    lines: list[str] = []
    for what, who, at, sha256 in picture_rows(pictures):
        lines += [*_wrap_text(f"{what}, by {who}, {at} UTC", "* ", 2), f"  SHA-256 {sha256}"]
    return lines


def _environment_lines(content: Mapping[str, Any]) -> list[str]:
    return [] if content["environment"] else [NO_TEMPERATURE]


def _to_sign(lines: Iterable[str]) -> list[str]:
    fields = "Name ______________________  Date ______________  Signature ________________"
    return [line for text in lines for line in (*_wrap_text(text, "[ ] ", 4), "", f"    {fields}"[:WIDTH])]


def _made_with(run: Mapping[str, Any]) -> list[str]:
    lines: list[str] = []
    for software, definition in made_with_rows(run):
        lines += _wrap_text(software)
        lines += _wrap_text(definition, "definition      ")
    return lines


def _signature_lines(file: str, run: Mapping[str, Any], sha256: str, public_key: str) -> list[str]:
    return [
        f"journal head    {run['journal_head_sha256']}",
        f"content SHA-256 {sha256}",
        f"public key      {public_key}",
        *_wrap_text(
            make_message(
                "This page is a rendering. What is signed is {file_stem}.json; check it with `cellcal "
                "verify FILE --key PUBKEY`. A check tells that it is unchanged and which key signed it, "
                "not whose key that is.",
                file_stem=file,
            )
        ),
    ]


def _optional_lines(before: str, text: str | None) -> list[str]:
    return _wrap_text(before + text) if text else []


def _bullet_lines(lines: Iterable[str]) -> list[str]:
    return [wrapped for line in lines for wrapped in _wrap_text(line, "* ", 2)]


def _wrap_text(text: str, first: str = "", indent: int | None = None) -> list[str]:
    rest = " " * (len(first) if indent is None else indent)
    return textwrap.wrap(str(text), WIDTH, initial_indent=first, subsequent_indent=rest) or [first.rstrip()]


def _clip_lines(lines: Iterable[str]) -> list[str]:
    return [line.rstrip()[:WIDTH] for line in lines]
