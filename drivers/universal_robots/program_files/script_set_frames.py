"""Frames that a URScript sets to numbers one after the other: ``ref_frame = p[…]``, as RoboDK writes them.

A pose behind such a variable stands in the numbers that each way to its move goes through.
"""

import re
from bisect import bisect_right
from collections import defaultdict
from operator import attrgetter

from cellcal.drivers.universal_robots.program_files.script_scopes import ScriptScopes
from cellcal.drivers.universal_robots.program_files.script_text import ScriptLiteral, ScriptStatements

_BESIDE = re.compile(r"^[ \t]*+thread\b", re.MULTILINE)  # it may set a variable at any time


def settle_set_frames(found: ScriptStatements, text: str, changed: frozenset[str]) -> None:
    """Give poses in a frame that is set several times the name of its numbers, where these are certain.

    ``changed`` are names that get a value which is no literal, or may.
    """
    settings: dict[str, list[ScriptLiteral]] = defaultdict(list)
    for literal in found.literals:
        if literal.role == "value":
            settings[literal.name].append(literal)
    names = {literal.name for literal in found.literals if literal.role == "in_frame"}
    several = {name for name in names if len(settings[name]) > 1 and _is_frame(found, name, settings[name])}
    several -= changed
    if not several or _BESIDE.search(text):
        return
    scopes = ScriptScopes(text)
    for name in sorted(several):
        some = settings[name]
        if len({scopes.function_at(each.start) for each in some}) == 1:
            _settle_frame(found, text, scopes, (name, some))


def _is_frame(found: ScriptStatements, name: str, settings: list[ScriptLiteral]) -> bool:
    """Return whether a variable holds poses, and is a frame wherever it is used."""
    return all(each.is_pose for each in settings) and all(
        role == "frame" for _, role, _ in found.uses.get(name, ())
    )


def _settle_frame(
    found: ScriptStatements, text: str, scopes: ScriptScopes, frame: tuple[str, list[ScriptLiteral]]
) -> None:
    name, settings = frame
    named = set[str]()
    for row, literal in enumerate(found.literals):
        if literal.role != "in_frame" or literal.name != name:
            continue
        at = bisect_right(settings, literal.start, key=attrgetter("start")) - 1
        after = float(settings[at + 1].start) if at + 1 < len(settings) else float("inf")
        if at >= 0 and scopes.surely_passes(settings[at].start, literal.start, after):
            numbers = _name_of(name, text, settings[at])
            found.literals[row] = literal._replace(name=numbers)
            found.note_use(numbers, literal.start, "frame", "pose_trans")
            named.add(numbers)
    for row, literal in enumerate(found.literals):
        if literal.role == "value" and literal.name == name:
            numbers = _name_of(name, text, literal)
            is_first = numbers in named
            named.discard(numbers)
            found.literals[row] = (
                literal._replace(name=numbers) if is_first else literal._replace(role="frame")
            )


def _name_of(name: str, text: str, literal: ScriptLiteral) -> str:
    """Return the name of a frame with its numbers."""
    numbers = ("".join(each.split()) for each in text[literal.start : literal.end].split(","))
    return f"{name}={{{','.join(numbers)}}}"
