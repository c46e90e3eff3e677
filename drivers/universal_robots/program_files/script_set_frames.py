"""Frames that a URScript sets to numbers one after the other: ``ref_frame = p[…]``, as RoboDK writes them.

A pose behind such a variable stands in the numbers that each way to its move goes through.
"""

import re
from bisect import bisect_right
from collections import defaultdict
from operator import attrgetter

from cellcal.drivers.universal_robots.program_files.script_scopes import ScriptScopes
from cellcal.drivers.universal_robots.program_files.script_text import ScriptLiteral, ScriptStatements

_NAMED = re.compile(r"(?<![\w.])(?<!def )([A-Za-z_]\w*+)", re.ASCII)
# It may set a variable at any time, or lets programs from outside do so.
_BESIDE = re.compile(r"^[ \t]*+thread\b|\binterpreter_mode\b", re.MULTILINE)


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
        _settle_frame(found, text, scopes, (name, settings[name]))


def _is_frame(found: ScriptStatements, name: str, settings: list[ScriptLiteral]) -> bool:
    """Return whether a variable holds poses, and is a frame wherever it is used."""
    return all(each.is_pose for each in settings) and all(
        role == "frame" for _, role, _ in found.uses.get(name, ())
    )


def _settle_frame(
    found: ScriptStatements, text: str, scopes: ScriptScopes, frame: tuple[str, list[ScriptLiteral]]
) -> None:
    name, settings = frame
    calls = _calls_that_set(text, scopes, {scopes.function_at(each.start) for each in settings})
    named = set[str]()
    for row, literal in enumerate(found.literals):
        if literal.role != "in_frame" or literal.name != name:
            continue
        function = scopes.function_at(literal.start)
        own = [each for each in settings if scopes.function_at(each.start) == function]
        at = bisect_right(own, literal.start, key=attrgetter("start")) - 1
        after = float(own[at + 1].start) if at + 1 < len(own) else float("inf")
        if (
            at >= 0
            and scopes.surely_passes(own[at].start, literal.start, after)
            and not scopes.may_meet(calls, own[at].start, literal.start)
        ):
            numbers = _name_of(name, text, own[at])
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


def _calls_that_set(text: str, scopes: ScriptScopes, setting: set[int]) -> list[int]:
    """Return where functions are called that set the frame, or lead to one that does."""
    numbers: dict[str, list[int]] = defaultdict(list)
    for number, function in enumerate(scopes.functions):
        numbers[function.name].append(number)
    calls = [
        (one.start(), scopes.function_at(one.start()), numbers[one[1]])
        for one in _NAMED.finditer(text)
        if one[1] in numbers
    ]
    reaching, grows = set(setting), True
    while grows:
        more = {caller for _, caller, called in calls if not reaching.isdisjoint(called)} - reaching
        reaching, grows = reaching | more, bool(more)
    return [place for place, _, called in calls if not reaching.isdisjoint(called)]


def _name_of(name: str, text: str, literal: ScriptLiteral) -> str:
    """Return the name of a frame with its numbers."""
    numbers = ("".join(each.split()) for each in text[literal.start : literal.end].split(","))
    return f"{name}={{{','.join(numbers)}}}"
