"""Tools and work objects that one module sets to numbers, and another may set between, too."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

from cellcal.drivers.abb.program_files.data_set_by_name import sets_any_place
from cellcal.drivers.abb.program_files.frame_facts import BARRED_SET, FrameFacts
from cellcal.drivers.abb.program_files.literal_frames import ANY_NAME, LiteralFrames
from cellcal.drivers.abb.program_files.literals import NAME
from cellcal.drivers.abb.program_files.passed_frames import HAS_ROUTINE, marks_of_passed, rows_of_passed
from cellcal.drivers.abb.program_files.rapid_called import called_procedures
from cellcal.drivers.abb.program_files.written_frames import NUMBERS
from cellcal.drivers.programs.file_declarations import ExternalUses
from cellcal.drivers.programs.positions import CARTESIAN, Positions

_SETS = "sets"  # before a name and the file that sets it
_SETS_ANY = "sets-any"  # before a file that sets data by a name which is computed
_TRAP_NAMES = "trap names"  # before a word in a trap, or in what it calls in its file, and the file
_CALLS = "may call"  # before what is called in a file, or may be, and the file
_TRAP = re.compile(r"\bTRAP\s", re.ASCII | re.IGNORECASE)
_WORD = re.compile(NAME, re.ASCII)
_ROUTINE = re.compile(rf"\b(?:PROC|FUNC\s++\w++)\s++({NAME})", re.ASCII | re.IGNORECASE)
_BOUND = re.compile(
    rf"\b(?:(TRAP|PROC|FUNC\s++\w++)\s++({NAME})|END(?:TRAP|PROC|FUNC)\b)", re.ASCII | re.IGNORECASE
)
_TEXT = re.compile(r'![^\n]*+|"(?:[^"\n]++|"")*+"')
_WITH_ROUTINE = re.compile(r"\bMove[LJC]Sync\b([^;]*+)", re.IGNORECASE)
_IN_QUOTES = re.compile(rf'"(?:{NAME}:)?+({NAME})"\s*+\Z', re.ASCII)
_LAST_OR_OPENED = re.compile(rf"(?<![\w.\\,=])({NAME})\s*+[(;]", re.ASCII)
_BEFORE_ARGUMENT = re.compile(rf'(?<![\w.\\])({NAME})(?=\s++["\w\[+-]|\s*+\\)', re.ASCII)
_BY_VARIABLE = re.compile(r"\bCallByVar\b", re.IGNORECASE)


@dataclass(frozen=True)
class SetFrames:
    """The tools and work objects that a file sets to numbers, as far as other files count for them."""

    shown: Set[str] = frozenset()  # that other files see
    varied: Set[str] = frozenset()  # with different numbers at different places
    routines: Set[str] = frozenset()  # of this file, which may set any
    calls_outside: Mapping[str, Set[str]] = field(default_factory=dict)  # by routine, as `LiteralFrames` says
    called_by_traps: Set[str] = frozenset()  # outside of this file

    @classmethod
    def of_literal(cls, literal: LiteralFrames) -> "SetFrames":
        """Return those of a module."""
        return cls(
            literal.shown_names(),
            literal.varied_names(),
            literal.routine_names(),
            literal.calls_outside(),
            literal.called_by_traps(),
        )


def marks_of_set_frames(facts: FrameFacts, file: str, text: str) -> dict[str, str]:
    """Return what a file says to others of the tools and work objects that it sets, or lets be set at any time."""
    in_traps = _words_of_traps(text)
    return {
        **{f"{_SETS} {name} {file}": BARRED_SET for name in sorted(facts.set_while_running)},
        **{f"{_TRAP_NAMES} {name} {file}": BARRED_SET for name in sorted(in_traps)},
        **({f"{_SETS_ANY} {file}": BARRED_SET} if sets_any_place(text) else {}),
        **marks_of_passed(text, file),
        **{
            f"{HAS_ROUTINE} {name.lower()} {file}": BARRED_SET for name in sorted(set(_ROUTINE.findall(text)))
        },
        **{f"{_CALLS} {name} {file}": BARRED_SET for name in sorted(_possible_calls(text))},
    }


def _words_of_traps(text: str) -> set[str]:
    """Return the words, in small letters, in traps and in routines of the file that these may call."""
    if _TRAP.search(text) is None:  # as in most
        return set()
    traps, bodies = _bodies(text)
    found, pieces = set[str](), traps
    while pieces:
        words = {word.lower() for piece in pieces for word in _WORD.findall(piece)} - found
        found |= words | {ANY_NAME for piece in pieces if ANY_NAME in _possible_calls(piece)}
        pieces = [bodies[word] for word in words if word in bodies]
    return found


def _bodies(text: str) -> tuple[list[str], dict[str, str]]:
    """Return the texts of the traps, and those of the other routines by their names in small letters."""
    traps, others = list[str](), dict[str, str]()
    begun: re.Match[str] | None = None
    for found in _BOUND.finditer(_TEXT.sub(lambda each: " " * len(each[0]), text)):
        if begun is not None and begun[1].upper() == "TRAP":
            traps.append(text[begun.end() : found.start()])
        elif begun is not None:
            others[begun[2].lower()] = text[begun.end() : found.start()]
        begun = found if found[1] else None
    return traps, others


def _possible_calls(text: str) -> set[str]:
    """Return the names, in small letters, that a file may call, or any name where one is computed.

    Words of the language and names of data are among them: a routine of another file has none of these.
    """
    silent = _ROUTINE.sub("", _TEXT.sub(lambda found: '""' if found[0][0] == '"' else "", text))
    names = {*_LAST_OR_OPENED.findall(silent), *_BEFORE_ARGUMENT.findall(silent)}
    spoken = _TEXT.sub(lambda found: found[0] if found[0][0] == '"' else "", text)
    for arguments in _WITH_ROUTINE.findall(spoken):
        named = _IN_QUOTES.search(arguments)
        names.add(ANY_NAME if named is None else named[1])
    if "%" in silent or _BY_VARIABLE.search(silent):
        calls = called_procedures(text.encode("latin-1", "replace"))
        names |= {ANY_NAME if each.pattern.endswith("*") else each.pattern for each in calls if each.pattern}
    return {name.lower() for name in names}


def without_frames_of_others(
    positions: Positions, external_uses: ExternalUses, set_frames: SetFrames, keys: Sequence[str]
) -> Positions:
    """Return positions of which those are left whose tool or work object another file sets, or lets be set, too."""
    marks = external_uses.doubtful
    barred = rows_of_passed(positions, keys, marks)
    if set_frames.routines:
        barred |= dict.fromkeys(_rows_of_others(positions, external_uses, set_frames), BARRED_SET)
    return replace(positions, barred={**barred, **positions.barred}) if barred else positions


def _rows_of_others(positions: Positions, external_uses: ExternalUses, set_frames: SetFrames) -> list[int]:
    """Return the positions with numbers for a tool or a work object that other files may set."""

    def of_others(words: str) -> bool:
        return any(file != external_uses.file for file in external_uses.doubtful.rests_behind(words))

    others = {name for name in set_frames.shown if of_others(f"{_SETS} {name}")}
    others |= set_frames.shown & external_uses.frames_set
    any_ = any(of_others(f"{_TRAP_NAMES} {name}") for name in set_frames.routines)
    if set_frames.varied and (
        _is_called_back(set_frames.calls_outside, of_others) or _is_called_by_traps(set_frames, external_uses)
    ):
        others |= set_frames.varied
    if not others and not any_:
        return []
    return [
        row
        for row, names in enumerate(zip(positions.tools, positions.user_frames, strict=True))
        for parts in [[name.lower().partition(NUMBERS) for name in names if name is not None]]
        if any((any_ and numbers) or name in others for name, numbers, _ in parts)
    ]


def without_data_set_by_name(positions: Positions, external_uses: ExternalUses) -> Positions:
    """Return positions that are all left where a file may set any target, tool or work object by its name."""
    if not external_uses.doubtful.rests_behind(_SETS_ANY):
        return positions
    rows = [row for row, kind in enumerate(positions.kinds) if kind == CARTESIAN]
    return replace(positions, barred={**dict.fromkeys(rows, BARRED_SET), **positions.barred})


def _is_called_back(calls_outside: Mapping[str, Set[str]], of_others: Callable[[str], bool]) -> bool:
    """Return whether a routine calls into another file while one of the file may be called from there."""
    named = of_others(f"{_CALLS} {ANY_NAME}")
    return any(
        (named or of_others(f"{_CALLS} {routine}"))
        and any(name == ANY_NAME or of_others(f"{HAS_ROUTINE} {name}") for name in names)
        for routine, names in calls_outside.items()
    )


def _is_called_by_traps(set_frames: SetFrames, external_uses: ExternalUses) -> bool:
    """Return whether a trap may call a routine of the file by way of other files.

    Between these it is not followed which routine calls which.
    """
    marks, own = external_uses.doubtful, external_uses.file
    words = [(name, own) for name in set_frames.called_by_traps]
    words += [(name, file) for name, _, file in _split(marks.rests_behind(_TRAP_NAMES)) if file != own]
    calls = marks.derive_once(_CALLS, lambda: _names_by_file(marks.rests_behind(_CALLS)))
    passed = {own}
    while words:
        name, caller = words.pop()
        if name == ANY_NAME or (name in set_frames.routines and caller != own):
            return True
        for file in marks.rests_behind(f"{HAS_ROUTINE} {name}"):
            if file != caller and file not in passed:
                passed.add(file)
                words += [(each, file) for each in calls.get(file, ())]
    return False


def _split(rests: Iterable[str]) -> list[tuple[str, str, str]]:
    """Return names with the files that stand behind them."""
    return [rest.partition(" ") for rest in rests]


def _names_by_file(rests: Iterable[str]) -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for name, _, file in _split(rests):
        found.setdefault(file, set()).add(name)
    return found
