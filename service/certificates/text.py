"""A certificate for people: 80 columns, millimetres and degrees. What is signed is the JSON file beside it."""

import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from service.quantities import quantity

WIDTH = 80
_RULE = "=" * WIDTH
_WORDS = {
    "pass": "PASS",
    "fail": "FAIL",
    "undecided": "UNDECIDED - measure more",
    "refused": "REFUSED - nothing is claimed",
    None: "-",
}


def as_text(content: Mapping[str, Any], sha256: str, public_key: str) -> str:
    """Return the certificate as a page of text."""
    run, verdict, refusal = content["run"], content["verdict"], content.get("refusal")
    sections = (
        ("", _head(content)),
        ("Verdict", [_WORDS[verdict["word"]], *_optional("judged by ", verdict.get("limits_from"))]),
        ("Why it was refused", _optional("", refusal and refusal["reason"])),
        ("What to do next", _optional("", refusal and refusal["remedy"])),
        ("What was decided", _figures(verdict["characteristics"])),
        ("Before and after", _changes(verdict.get("changes", []))),
        ("Evidence" if refusal else "Result", _result(content["result"])),
        ("Remarks", _bullets(verdict.get("remarks", []))),
        ("Not verified", _bullets([*verdict.get("not_verified", []), *_environment(content)])),
        ("Measurements", _points(content["points"])),
        ("People", _people(content["people"])),
        ("Traceability and safety", [*_wrapped(content["traceability"]), *_wrapped(content["safety"])]),
        ("To be signed by hand", _to_sign(verdict.get("to_sign", []))),
        ("Made with", _made_with(run)),
        (
            "Signature",
            _signature(f"{run['run_id']}-refused" if refusal else run["run_id"], run, sha256, public_key),
        ),
    )
    lines = ["REFUSAL RECORD" if refusal else "CALIBRATION REPORT", _RULE]
    for title, body in sections:
        if body:
            lines += ([title, "-" * len(title)] if title else []) + [*body, ""]
    return "\n".join(_clipped(lines)) + "\n"


def _head(content: Mapping[str, Any]) -> list[str]:
    run, robot = content["run"], content["devices"][0]["identity"]
    lines = [
        ("procedure", f"{run['title']} ({run['procedure']}, version {run['procedure_version']})"),
        ("robot", _who_is(robot)),
        *((device["role"], _who_is(device["identity"])) for device in content["devices"][1:]),
        ("cell", content["cell"]["name"]),
        ("encoder epoch", f"{content['encoder_epoch_at_start']} at the start"),
        ("run", run["run_id"]),
        ("from, to (UTC)", f"{_time(run['started_utc'])}, {_time(run['ended_utc'])}"),
        ("status", content["status"]),
    ]
    return [line for name, value in lines for line in _wrapped(value, f"{name:<16}")]


def _figures(characteristics: Iterable[Mapping[str, Any]]) -> list[str]:
    lines: list[str] = []
    for figure in characteristics:
        word = "stated" if figure["decision"] is None else figure["decision"].upper()
        lines += _wrapped(figure["name"], f"{word:<10} ", 11)
        bare = figure["limit"] is None and (figure["unit"], figure["value"]) == (
            "1",
            1.0,
        )  # a fact, no figure
        lines += [] if bare else _wrapped(_found(figure), " " * 11)
        lines += _wrapped(figure["rule"], " " * 11) if figure["rule"] else []
        for part in figure["budget"]:
            u = quantity(part["standard_uncertainty"], figure["unit"])
            lines += _wrapped(f"budget: {part['name']}, u = {u} ({part['source']})", " " * 11)
    return lines


def _found(figure: Mapping[str, Any]) -> str:
    """Return what was found, how well it is known, and the limit; a judged uncertainty is itself what was found."""
    unit, expanded = figure["unit"], figure["expanded_uncertainty"]
    told = [] if figure["value"] == expanded > 0.0 else [f"found {quantity(figure['value'], unit)}"]
    if expanded:
        told.append(f"U = {quantity(expanded, unit)} (k = {figure['coverage']:.2f})")
    if figure["limit"] is not None:
        told.append(f"limit {quantity(figure['limit'], unit)}")
    return "; ".join(told)


def _changes(changes: Iterable[Mapping[str, Any]]) -> list[str]:
    def shown(value: float | None, unit: str) -> str:
        return "not read" if value is None else quantity(value, unit)

    rows = []
    for change in changes:
        before, after = (shown(change[when], change["unit"]) for when in ("before", "after"))
        rows.append(f"{change['name']:<32.32}{before:>20}{after:>20}")
    return [f"{'':<32}{'before':>20}{'after':>20}", *rows] if rows else []


def _result(result: Any) -> list[str]:
    """Return what fits on a line, and where the rest is."""
    if result is None:
        return []
    return [*_short(result), "The whole result is in the JSON file of the same name."]


def _short(result: Any) -> list[str]:
    lines: list[str] = []
    for key, value in result.items() if isinstance(result, dict) else ():
        if _is_pose(value):
            x, y, z = (f"{1e3 * v:.3f}" for v in value["position_m"])
            q = ", ".join(f"{v:+.7f}" for v in value["quaternion"])
            lines += _wrapped(f"x {x}, y {y}, z {z} mm; quaternion w x y z {q}", f"{_name(key)}: ", 4)
        elif isinstance(value, bool | int | float | str):
            lines += _wrapped(_scalar(key, value), f"{_name(key)}: ", 4)
        elif isinstance(value, dict):
            inner = {k: v for k, v in value.items() if _is_pose(v)}
            lines += _short(inner)
    return lines


def _points(points: list[Mapping[str, Any]]) -> list[str]:
    unused = [point for point in points if not point["used"]]
    lines = [f"{len(points)} readings, {len(points) - len(unused)} used; each one is in the JSON file."]
    for point in unused:
        lines += _wrapped(f"{point['step']}: {point['reason']}", "  not used: ", 4)
    return lines


def _people(people: list[Mapping[str, str]]) -> list[str]:
    lines = []
    for who in dict.fromkeys(answer["who"] for answer in people):
        own = [answer for answer in people if answer["who"] == who]
        accepted = [answer["step"] for answer in own if answer["step"].startswith("accept")]
        told = f"{who}: {len(own)} answers from {_time(own[0]['at_utc'])} to {_time(own[-1]['at_utc'])} UTC"
        told += (
            f"; accepted: {', '.join(step.removeprefix('accept ') for step in accepted)}" if accepted else ""
        )
        lines += _wrapped(told)
    return lines


def _environment(content: Mapping[str, Any]) -> list[str]:
    if content["environment"]:
        return []
    return ["No temperature was recorded: nothing is corrected for it."]


def _to_sign(lines: Iterable[str]) -> list[str]:
    fields = "Name ______________________  Date ______________  Signature ________________"
    return [line for text in lines for line in (*_wrapped(text, "[ ] ", 4), "", f"    {fields}"[:WIDTH])]


def _made_with(run: Mapping[str, Any]) -> list[str]:
    lines: list[str] = []
    for made in run["made_with"]:
        lines += _wrapped(f"cellcal {made.get('software', '?')}, {made.get('solver', 'solver not recorded')}")
        lines += _wrapped(made.get("definition_sha256", "not recorded"), "definition      ")
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


def _scalar(key: str, value: bool | int | float | str) -> str:
    if isinstance(value, float):
        unit = next((unit for unit in ("rad", "m") if key.endswith(f"_{unit}")), "")
        return quantity(value, unit) if unit else f"{value:.6g}"
    return str(value)


def _is_pose(value: Any) -> bool:
    return isinstance(value, dict) and {"position_m", "quaternion"} <= value.keys()


def _name(key: str) -> str:
    for unit in ("_rad", "_m"):
        key = key.removesuffix(unit)
    return key.replace("_", " ")


def _who_is(identity: Mapping[str, str]) -> str:
    return f"{identity['vendor']} {identity['model']}, serial {identity['serial']}, {identity['firmware']}"


def _time(wall_utc: str) -> str:
    return wall_utc[:19].replace("T", " ")


def _optional(before: str, text: str | None) -> list[str]:
    return _wrapped(before + text) if text else []


def _bullets(lines: Iterable[str]) -> list[str]:
    return [wrapped for line in lines for wrapped in _wrapped(line, "* ", 2)]


def _wrapped(text: str, first: str = "", indent: int | None = None) -> list[str]:
    rest = " " * (len(first) if indent is None else indent)
    return textwrap.wrap(str(text), WIDTH, initial_indent=first, subsequent_indent=rest) or [first.rstrip()]


def _clipped(lines: Iterable[str]) -> list[str]:
    return [line.rstrip()[:WIDTH] for line in lines]
