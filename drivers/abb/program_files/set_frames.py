"""Tools and work objects that one module sets to numbers, and another may set between, too."""

import re
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, field, replace

from cellcal.drivers.abb.program_files.frame_facts import BARRED_SET, FrameFacts
from cellcal.drivers.abb.program_files.literal_frames import ANY_NAME, LiteralFrames
from cellcal.drivers.abb.program_files.literals import NAME
from cellcal.drivers.abb.program_files.rapid_called import called_procedures
from cellcal.drivers.abb.program_files.written_frames import NUMBERS
from cellcal.drivers.programs.file_declarations import ExternalUses
from cellcal.drivers.programs.positions import Positions

_SETS = "sets"  # before a name and the file that sets it
_SETS_ANY = "sets-any"  # before a file that sets data by a name which is computed
_TRAP_NAMES = "trap names"  # before a word in a trap, which may call it at any time, and the file
_HAS = "has routine"  # before a routine and its file
_CALLS = "may call"  # before what is called in a file, or may be, and the file
_BY_NAME = re.compile(r"\bSetAllDataVal\b|\bSetDataVal\b(?!\s*+\"\w)", re.ASCII | re.IGNORECASE)
_TRAP = re.compile(r"\bTRAP\s(.*?)\bENDTRAP\b", re.ASCII | re.IGNORECASE | re.DOTALL)
_WORD = re.compile(NAME, re.ASCII)
_ROUTINE = re.compile(rf"\b(?:PROC|FUNC\s++\w++)\s++({NAME})", re.ASCII | re.IGNORECASE)
_TEXT = re.compile(r'![^\n]*+|"(?:[^"\n]++|"")*+"')
_WITH_ROUTINE = re.compile(rf'\bMove[LJC]Sync\b[^;"\n]*+"(?:{NAME}:)?+({NAME})"', re.ASCII | re.IGNORECASE)
_LAST_OR_OPENED = re.compile(rf"(?<![\w.\\,=])({NAME})[ \t\r]*+[(;]", re.ASCII)
_LEADING = re.compile(rf"(?:^|[;\n])[ \t]*+({NAME})(?=[ \t]++[\w\[\\+-]|\\)", re.ASCII)
_COMPACT = re.compile(r"\bIF\b((?:(?!\bTHEN\b)[^;\n])*+);", re.ASCII | re.IGNORECASE)
_BY_VARIABLE = re.compile(r"\bCallByVar\b", re.IGNORECASE)


@dataclass(frozen=True)
class SetFrames:
    """The tools and work objects that a file sets to numbers, as far as other files count for them."""

    shown: Set[str] = frozenset()  # that other files see
    varied: Set[str] = frozenset()  # with different numbers at different places
    routines: Set[str] = frozenset()  # of this file, which may set any
    calls_outside: Mapping[str, Set[str]] = field(default_factory=dict)  # by routine, as `LiteralFrames` says

    @classmethod
    def of_literal(cls, literal: LiteralFrames) -> "SetFrames":
        """Return those of a module."""
        return cls(
            literal.shown_names(), literal.varied_names(), literal.routine_names(), literal.calls_outside()
        )


def marks_of_set_frames(facts: FrameFacts, file: str, text: str) -> dict[str, str]:
    """Return what a file says to others of the tools and work objects that it sets, or lets be set at any time."""
    in_traps = {word.lower() for trap in _TRAP.findall(text) for word in _WORD.findall(trap)}
    return {
        **{f"{_SETS} {name} {file}": BARRED_SET for name in sorted(facts.set_while_running)},
        **{f"{_TRAP_NAMES} {name} {file}": BARRED_SET for name in sorted(in_traps)},
        **({f"{_SETS_ANY} {file}": BARRED_SET} if _BY_NAME.search(text) else {}),
        **{f"{_HAS} {name.lower()} {file}": BARRED_SET for name in sorted(set(_ROUTINE.findall(text)))},
        **{f"{_CALLS} {name} {file}": BARRED_SET for name in sorted(_possible_calls(text))},
    }


def _possible_calls(text: str) -> set[str]:
    """Return the names, in small letters, that a file may call, or any name where one is computed.

    Names of data are among them: a routine of another file has none of these.
    """
    silent = _ROUTINE.sub("", _TEXT.sub("", text))
    names = {*_LAST_OR_OPENED.findall(silent), *_LEADING.findall(silent), *_WITH_ROUTINE.findall(text)}
    names |= {word for one in _COMPACT.findall(silent) for word in _WORD.findall(one)}
    if "%" in silent or _BY_VARIABLE.search(silent):
        calls = called_procedures(text.encode("latin-1", "replace"))
        names |= {ANY_NAME if each.pattern.endswith("*") else each.pattern for each in calls if each.pattern}
    return {name.lower() for name in names}


def without_frames_of_others(
    positions: Positions, external_uses: ExternalUses, set_frames: SetFrames
) -> Positions:
    """Return positions of which those are left whose tool or work object another file sets, or lets be set, too."""
    if not set_frames.routines:  # as in most
        return positions

    def of_others(words: str) -> bool:
        return any(file != external_uses.file for file in external_uses.doubtful.rests_behind(words))

    others = {name for name in set_frames.shown if of_others(f"{_SETS} {name}")}
    any_ = of_others(_SETS_ANY) or any(of_others(f"{_TRAP_NAMES} {name}") for name in set_frames.routines)
    if set_frames.varied and _is_called_back(set_frames.calls_outside, of_others):
        others |= set_frames.varied
    if not others and not any_:
        return positions
    rows = [
        row
        for row, names in enumerate(zip(positions.tools, positions.user_frames, strict=True))
        for parts in [[name.lower().partition(NUMBERS) for name in names if name is not None]]
        if any((any_ and numbers) or name in others for name, numbers, _ in parts)
    ]
    return replace(positions, barred={**dict.fromkeys(rows, BARRED_SET), **positions.barred})


def _is_called_back(calls_outside: Mapping[str, Set[str]], of_others: Callable[[str], bool]) -> bool:
    """Return whether a routine calls into another file while one of the file may be called from there."""
    named = of_others(f"{_CALLS} {ANY_NAME}")
    return any(
        (named or of_others(f"{_CALLS} {routine}"))
        and any(name == ANY_NAME or of_others(f"{_HAS} {name}") for name in names)
        for routine, names in calls_outside.items()
    )
