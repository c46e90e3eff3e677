"""Tools and work objects that a RAPID module sets to numbers: which ones hold at each move.

RoboDK and other post-processors declare one of each and write ``Frame.uframe := [[…],[…]];`` before the moves. Where
each way to a move goes through the same assignment, the moves name it by its numbers, as the controller computes.
"""

import re
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field
from operator import attrgetter

from cellcal.calibration.geometry import Pose
from cellcal.drivers.abb.program_files.instructions import MOVES
from cellcal.drivers.abb.program_files.literals import (
    AGGREGATES,
    NAME,
    NOT_CODE,
    POSE,
    RapidAggregate,
    decode_name,
)
from cellcal.drivers.abb.program_files.written_frames import (
    PARTS,
    name_of_numbers,
    poses_of_numbers,
    standing_numbers,
)
from cellcal.drivers.programs.call_graph import called_outside, find_recursive_routines
from cellcal.drivers.programs.text_flow import TextFlow

ANY_NAME = "*"  # of a routine whose name is computed, or stands in quotes
_KINDS = ("tooldata", "wobjdata")
_LENGTHS, _TURN = RapidAggregate.from_shape("[nnn]"), RapidAggregate.from_shape("[nnnn]")
_POSE = RapidAggregate.from_shape(f"[{POSE}]")
_SILENT = re.compile(NOT_CODE, re.ASCII)
_DECLARED = re.compile(
    rf"\b(?:PERS|VAR|CONST)\s++(\w++)\s++({NAME})\s*+(\{{[^{{}}]*+\}})?+\s*+(:=)?+\s*+",
    re.ASCII | re.IGNORECASE,
)
_LOCAL = re.compile(r"\bLOCAL\s++\Z", re.IGNORECASE)  # other modules of a task see what is TASK
_LONGEST_BLANK = 100
_ASSIGNED = re.compile(  # not where it is declared
    rf"(?:^|[;\n]|\b(?:THEN|ELSE|DO)\b)\s*+({NAME})(?:\s*+\.\s*+\w++)*+\s*+:=", re.ASCII | re.IGNORECASE
)
_ROUTINE = re.compile(rf"\b(?:PROC|TRAP|FUNC\s++\w++)\s++({NAME})", re.ASCII | re.IGNORECASE)
_WORD = re.compile(
    rf"(?<![\w.\\])(?P<begin>(?:PROC|TRAP|FUNC\s++\w++)\s++(?P<routine>{NAME})\s*+(?:\([^()]*+\))?+)"
    rf"|(?<![\w.\\])(?P<module>MODULE\s++{NAME}\s*+(?:\([^()]*+\))?+)"
    rf"|(?<![\w.\\])(?:(?P<end>END(?:PROC|FUNC|TRAP))|(?P<handler>ERROR|UNDO|BACKWARD)"
    rf"|(?P<loop>WHILE|FOR)|(?P<branch>IF|TEST)|(?P<other>ELSEIF|ELSE|CASE|DEFAULT)"
    rf"|(?P<close>END(?:WHILE|FOR|IF|TEST)))\b"
    rf"|(?:^|(?<=[;\n]))[ \t\r]*+(?!DEFAULT\b)(?P<label>{NAME})[ \t]*+:(?!=)|(?P<late>%)|(?P<stop>;)"
    rf"|(?<![\w.\\])(?P<name>{NAME})(?:\s*+\{{[^{{}}]*+\}})?+(?P<path>(?:\s*+\.\s*+\w++)*+)\s*+:=\s*+"
    rf"|(?<![\w.\\])(?P<word>{NAME})",
    re.ASCII | re.IGNORECASE,
)
_INSIDE = re.compile(rf"(?<![\w.\\]){NAME}", re.ASCII)
_THEN = re.compile(r"\bTHEN\b", re.IGNORECASE)
_OPENED, _ENDED = re.compile(r"\s*+\("), re.compile(r"\s*+;")
_LEADS_ON = frozenset(("then", "do"))  # a statement follows
_DECLARING = frozenset(("pers", "var", "const", "local", "task"))
_HARMLESS = ("tload",)  # a tool's load
_BY_NAME = frozenset(("setdataval", "setalldataval"))  # any data, whose name is in quotes
_WITH_ROUTINE = frozenset(("movelsync", "movejsync", "movecsync", "callbyvar"))  # whose name is in quotes
_STILL_TEXT = (
    "setdo setgo setao set reset waittime waitdi waitdo waituntil pulsedo confj confl singarea accset velset tpwrite "
    "tperase gripload raise retry trynext then do to step from not and or true false return stop exit break goto if "
    "while for until"
)
_CALLS_NOTHING = frozenset(_STILL_TEXT.split())
_PURE_TEXT = (
    "crobt cjointt calcrobt calcjointt posemult poseinv posevect offs reltool orobt abs round orientzyx"
)
_PURE = frozenset(_PURE_TEXT.split())  # functions that give none of their arguments a value


@dataclass(frozen=True, slots=True)
class _Setting:
    """An assignment: which parts it gives a value, and the numbers; None where they are computed."""

    place: int
    routine: int
    values: Mapping[str, tuple[str, ...] | None]


@dataclass
class _Data:
    """A tool or work object of the module."""

    name: str
    kind: str
    declared: Mapping[str, tuple[str, ...]] | None  # None: not fixed in the cell, or not read
    shown: bool  # other modules see it
    settings: list[_Setting] = field(default_factory=list)

    def numbers_at(self, place: int, routine: "_Routine") -> Mapping[str, tuple[str, ...]] | None:
        """Return the numbers that hold at a place; None where that is not certain."""
        found: dict[str, tuple[str, ...]] = {}
        for part in PARTS[self.kind]:
            those = [one for one in self.settings if part in one.values]
            numbers = self._only_numbers(part, those) or (
                routine.last_of(those, part, place) if those else None
            )
            if numbers is None:
                return None
            found[part] = numbers
        return found

    def varies(self) -> bool:
        """Return whether a part of it may have different numbers."""
        return any(
            not all(_alike(some[0].values[part], one.values[part]) for one in some)
            for part in PARTS[self.kind]
            if (some := [one for one in self.settings if part in one.values])
        )

    def _only_numbers(self, part: str, settings: list[_Setting]) -> tuple[str, ...] | None:
        """Return the numbers of a part that is declared with them, and never set to others."""
        own = None if self.declared is None else self.declared[part]
        if own is None or any(not _alike(own, one.values[part]) for one in settings):
            return None
        return own


@dataclass
class _Routine:
    """A routine: its blocks, and where it calls others."""

    number: int
    name: str  # in small letters
    begin: int
    end: int = 0
    flow: TextFlow = field(default_factory=TextFlow)
    calls: list[int] = field(default_factory=list)
    handler: int | None = None  # where what runs after errors begins
    called: set[str] = field(default_factory=set)  # routines of the file, in small letters
    called_outside: set[str] = field(default_factory=set)  # what may be routines of other files
    recurs: bool = False  # it may be called again while it runs
    is_trap: bool = False  # it may run at any time

    def last_of(self, settings: list[_Setting], part: str, place: int) -> tuple[str, ...] | None:
        """Return what a part is surely set to at a place."""
        own = [one for one in settings if one.routine == self.number]
        at = bisect_right(own, place, key=attrgetter("place")) - 1
        if at < 0 or (self.handler is not None and place > self.handler):
            return None
        after = float(own[at + 1].place) if at + 1 < len(own) else float("inf")
        if not self.flow.surely_passes(own[at].place, place, after):
            return None
        others = [one for one in settings if self.recurs or one.routine != self.number]
        elsewhere = any(not _alike(own[at].values[part], one.values[part]) for one in others)
        if elsewhere and (self._handles_by_calls() or self.flow.may_meet(self.calls, own[at].place, place)):
            return None
        return own[at].values[part]

    def _handles_by_calls(self) -> bool:
        """Return whether an error anywhere in it may call another before the routine goes on."""
        return self.handler is not None and self.handler < (self.calls or [0])[-1]


@dataclass
class LiteralFrames:
    """The tools and work objects of a file that its routines set to numbers."""

    _data: dict[str, _Data] = field(default_factory=dict)  # by name in small letters
    _routines: list[_Routine] = field(default_factory=list)
    tools: dict[str, Pose] = field(default_factory=dict)  # that were asked for, by name and numbers
    bases: dict[str, Pose] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """Return whether there is any."""
        return bool(self._data)

    def shown_names(self) -> frozenset[str]:
        """Return the names, in small letters, that other modules may set, too."""
        return frozenset(name for name, one in self._data.items() if one.shown)

    def routine_names(self) -> frozenset[str]:
        """Return the names of its routines, in small letters; none where they set no tool and no work object."""
        return frozenset(one.name for one in self._routines) if self._data else frozenset()

    def varied_names(self) -> frozenset[str]:
        """Return the tools and work objects, in small letters, that are not set to the same numbers everywhere."""
        return frozenset(name for name, one in self._data.items() if one.varies())

    def calls_outside(self) -> dict[str, frozenset[str]]:
        """Return by routine what it, or one of the file that it calls, calls outside the file."""
        return called_outside({one.name: (one.called, one.called_outside) for one in self._routines})

    def called_by_traps(self) -> frozenset[str]:
        """Return what its traps, and routines that these call, call outside the file."""
        called, traps = self.calls_outside(), [one.name for one in self._routines if one.is_trap]
        return frozenset().union(*(called[name] for name in traps))

    def name_at(self, place: int, name: str | None) -> str | None:
        """Return a tool or work object of a move with its numbers, where these surely hold, or its name."""
        one = self._data.get(name.lower()) if name is not None else None
        routine = self._routine_at(place)
        if one is None or routine is None:
            return name
        numbers = one.numbers_at(place, routine)
        poses = [] if numbers is None else poses_of_numbers(numbers, PARTS[one.kind])
        if not poses or None in poses:
            return name
        pose, *more = [each for each in poses if each is not None]
        for each in more:
            pose = pose @ each
        named = f"{one.name}={name_of_numbers(numbers or {})}"
        (self.tools if one.kind == "tooldata" else self.bases)[named] = pose
        return named

    def _routine_at(self, place: int) -> _Routine | None:
        at = bisect_right(self._routines, place, key=attrgetter("begin")) - 1
        return self._routines[at] if at >= 0 and place < self._routines[at].end else None


def _alike(own: tuple[str, ...] | None, other: tuple[str, ...] | None) -> bool:
    return (
        own is not None
        and other is not None
        and [float(text) for text in own] == [float(text) for text in other]
    )


def find_literal_frames(text: str) -> LiteralFrames:
    """Return the tools and work objects that a file declares once and sets."""
    declared: dict[str, list[re.Match[str]]] = {}
    for one in _DECLARED.finditer(text):
        if one[1].lower() in _KINDS:
            declared.setdefault(decode_name(one[2]).lower(), []).append(one)
    names = [name for name, some in declared.items() if len(some) == 1 and not some[0][3]]
    if not names:
        return LiteralFrames()
    data = {name: _data_of(declared[name][0], text) for name in names}
    silent = _SILENT.sub(lambda found: " " * len(found[0]), text)
    assigned = {decode_name(name).lower() for name in _ASSIGNED.findall(silent)}
    if not any(name in assigned for name in names):
        return LiteralFrames()
    own = {decode_name(name).lower() for name in _ROUTINE.findall(silent)}
    return _Reader(text, silent, data, own).read()


def _data_of(declared: re.Match[str], text: str) -> _Data:
    kind = declared[1].lower()
    found = AGGREGATES[kind].pattern.match(text, declared.end()) if declared[4] else None
    shown = _LOCAL.search(text[max(0, declared.start() - _LONGEST_BLANK) : declared.start()]) is None
    return _Data(
        decode_name(declared[2]), kind, None if found is None else standing_numbers(kind, found), shown
    )


@dataclass
class _Reader:
    """Reads a file for what sets its tools and work objects."""

    text: str
    silent: str  # without comments and strings
    data: dict[str, _Data]
    own: set[str]  # its routines, in small letters
    routines: list[_Routine] = field(default_factory=list)
    statement: str | None = ""  # the word that leads it, "" for an assignment; None before its first word
    declares: bool = False  # the statement declares data
    calls: bool = False  # it calls what may set anything
    compact: bool = False  # it is an IF without THEN
    trap: bool = False
    inside: _Routine | None = None

    def read(self) -> LiteralFrames:
        """Take the whole text."""
        for found in _WORD.finditer(self.silent):
            kind = found.lastgroup or ""
            if kind == "word":
                self._take_word(found["word"].lower(), found)
            elif kind in ("name", "path"):
                if "{" in found[0]:
                    self._take_index(found)
                if not self.declares:
                    self._take_setting(found)
                    self.statement = ""
            else:
                self._take_flow(kind, found)
                heads = kind in ("loop", "branch") and not self.compact
                self.statement, self.calls, self.declares = "if" if heads else None, False, False
        for routine, is_circular in zip(self.routines, self._circles(), strict=True):
            routine.recurs = is_circular
        return LiteralFrames({name: one for name, one in self.data.items() if one.settings}, self.routines)

    def _take_index(self, found: re.Match[str]) -> None:
        """Take the words in the index of what is assigned, which may be functions."""
        begin, end = self.silent.find("{", found.start()), self.silent.rfind("}", 0, found.end())
        self.statement = ""
        for inside in _INSIDE.finditer(self.silent, begin, end):
            self._take_word(inside[0].lower(), inside)

    def _circles(self) -> list[bool]:
        """Return of each routine whether it, or one that it calls, calls it."""
        by_name = {decode_name(one.name).lower(): one.number for one in self.routines}
        return find_recursive_routines(
            [[by_name[name] for name in one.called if name in by_name] for one in self.routines]
        )

    def _take_flow(self, kind: str, found: re.Match[str]) -> None:
        place = found.start()
        if kind == "begin":
            self.inside = _Routine(len(self.routines), found["routine"].lower(), found.end())
            self.trap = self.inside.is_trap = found[0][:4].upper() == "TRAP"
            self.routines.append(self.inside)
        elif self.inside is not None:
            self._take_flow_inside(self.inside, kind, place)

    def _take_flow_inside(self, routine: _Routine, kind: str, place: int) -> None:
        flow = routine.flow
        if kind == "end":
            routine.end, self.inside = place, None
        elif kind == "handler":
            routine.handler = place if routine.handler is None else routine.handler
        elif kind == "label":
            flow.labels.append(place)
        elif kind == "late":
            routine.calls.append(place)
            routine.called_outside.add(ANY_NAME)
        else:
            self._take_block(flow, kind, place)

    def _take_block(self, flow: TextFlow, kind: str, place: int) -> None:
        if kind in ("close", "other") or (kind == "stop" and self.compact):
            flow.end_block(place)
        if kind in ("loop", "branch", "other"):
            flow.begin_block(place, repeats=kind == "loop")
        if kind == "branch" and self.silent[place : place + 2].upper() == "IF":
            stop = self.silent.find(";", place)
            self.compact = _THEN.search(self.silent, place, stop if stop >= 0 else len(self.silent)) is None
        elif kind == "stop":
            self.compact = False

    def _take_word(self, word: str, found: re.Match[str]) -> None:
        if word in _LEADS_ON:
            self.statement, self.calls = None, False
            return
        leads, self.statement = self.statement is None, word if self.statement is None else self.statement
        opens = word not in _PURE and _OPENED.match(self.silent, found.end()) is not None
        still = word in MOVES or word in _CALLS_NOTHING or word in _DECLARING or word in self.data
        may_set = leads and not still
        self.calls |= word in self.own or may_set or (opens and word not in _CALLS_NOTHING)
        if self.inside is not None:
            self.inside.calls += [found.start()] if self.calls or word in _WITH_ROUTINE else []
            self.inside.called |= {word} & self.own
            leaves = word not in self.own and (may_set or (opens and word not in _CALLS_NOTHING))
            self.inside.called_outside |= {word} if leaves else set()
            self.inside.called_outside |= {ANY_NAME} if word in _WITH_ROUTINE else set()
        if word in _BY_NAME or (self.trap and word in self.own):  # at any time, whatever it sets
            self.data.clear()
        self.declares |= word in _DECLARING
        if word in self.data and self.calls and not self.declares:  # it is passed on
            del self.data[word]

    def _take_setting(self, found: re.Match[str]) -> None:
        name = decode_name(found["name"]).lower()
        one = self.data.get(name)
        path = "".join(found["path"].split()).lower().removeprefix(".")
        if one is None or path.partition(".")[0] in _HARMLESS:
            return
        routine, values = self.inside, _values_set(one.kind, path, self.text, found.end())
        if values is None or routine is None or routine.handler is not None or self.trap:
            del self.data[name]
        else:
            one.settings.append(_Setting(found.start(), routine.number, values))


def _values_set(kind: str, path: str, text: str, place: int) -> Mapping[str, tuple[str, ...] | None] | None:
    """Return the parts that an assignment sets, with their numbers; None for what decides more than a place."""
    if not path:
        found = AGGREGATES[kind].pattern.match(text, place)
        return None if found is None or not _ENDED.match(text, found.end()) else standing_numbers(kind, found)
    parts = [part for part in PARTS[kind] if f"{part}.".startswith(f"{path}.")]
    if not parts:
        whole = next((part for part in PARTS[kind] if path.startswith(f"{part}.")), None)
        return None if whole is None else {whole: None}  # a coordinate
    shape = _POSE if len(parts) > 1 else _LENGTHS if path.endswith("trans") else _TURN
    found = shape.pattern.match(text, place)
    if found is None or not _ENDED.match(text, found.end()):
        return dict.fromkeys(parts)
    numbers = found.groups()
    return dict(zip(parts, (numbers[:3], numbers[3:]) if len(parts) > 1 else (numbers,), strict=True))
