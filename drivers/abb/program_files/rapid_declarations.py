"""Declarations of RAPID: targets, arrays of targets, tools and work objects, and targets that get another's value."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from cellcal.calibration.message import make_message
from cellcal.drivers.abb.program_files.collected_positions import RapidPositions
from cellcal.drivers.abb.program_files.declared_frames import DeclaredFrames
from cellcal.drivers.abb.program_files.literals import (
    AGGREGATES,
    NAME,
    TARGETS,
    AggregateError,
    W,
    after_blanks,
    decode_name,
    end_of_element,
)
from cellcal.drivers.abb.program_files.measured_places import measured_inside, measured_name
from cellcal.drivers.abb.program_files.target_uses import TargetUses, result_of
from cellcal.drivers.abb.program_files.unread import INSIDE
from cellcal.drivers.programs.positions import NO_NUMBER

_DECLARED = re.compile(rf"{W}([A-Za-z]\w*+){W}({NAME}){W}(?:\{{([^{{}};]*+)\}})?+{W}(:=)?+{W}", re.ASCII)
_COPIED = re.compile(
    rf"(?:(?:Offs|RelTool){W}\({W}){{0,4}}+({NAME}){W}(?:\{{[^{{}};]*+\}}{W})?+[,;\]]",
    re.ASCII | re.IGNORECASE,
)
_ELEMENT = re.compile(rf"[\[,]{W}({NAME}){W}(?:\{{[^{{}};]*+\}}{W})?+(?=[,\]])", re.ASCII)  # a whole target
_LONGEST_LIST = 100_000
_CALLED = re.compile(rf"({NAME}){W}\(([^();]*+)\){W};", re.ASCII)
_ARGUMENT = re.compile(rf"(?<![\w.\\])({NAME})(?=[ \t]*+(?:\{{[^{{}}]*+\}})?+[ \t]*+(?:,|\Z))", re.ASCII)
_SIZES = re.compile(r"\s*\d+\s*")
_MOST_DIGITS = 9  # of an array's size
_FILLED_TEXT = "{} is an array without values: it is filled while the program runs."
_COMPUTED_TEXT = "{} is computed; it is not read."
_BROKEN_TEXT = "A coordinate of {} is no number; it is not read."


@dataclass
class RapidDeclarations:
    """The declarations of a file while it is read."""

    found: RapidPositions
    uses: TargetUses
    frames: DeclaredFrames
    declared_local: bool = field(default=False, kw_only=True)
    local: bool = field(default=False, kw_only=True)  # the declaration that follows is its module's only

    def take_declaration(self, word: str, end: int) -> int:
        """Take what follows VAR, PERS or CONST; return where to go on."""
        text = self.found.source.text
        declared = _DECLARED.match(text, end)
        if declared is None:
            return end
        kind, name, sizes = declared[1].lower(), decode_name(declared[2]), declared[3]
        self.local, local = False, self.local
        self.declared_local = local
        if kind in ("tooldata", "wobjdata"):
            self.frames.declare_name(kind, name, shown=not local and self.uses.scope.endswith("/"))
            if not self.uses.scope.endswith("/"):
                self.uses.of_routines.add((name.lower(), self.uses.scope))
        if kind not in AGGREGATES:
            return declared.end()
        if sizes is not None:
            return self._take_array(kind, name, sizes, declared)
        if kind not in TARGETS:
            return self.frames.take_declaration(kind, name, declared)
        if not declared[4]:
            self._declare_target(name, lambda: self.found.add_untaught(name, declared.start(2)))
            return declared.end()
        return self._take_target(kind, name, declared.end())

    def _take_array(self, kind: str, name: str, sizes: str, declared: re.Match[str]) -> int:
        if not declared[4] or kind not in TARGETS:
            if kind in TARGETS:
                self.found.add_remark(declared.start(2), "computed", make_message(_FILLED_TEXT, name))
                self.uses.declare_without_row(name)
            return declared.end()
        counts = [size.strip() if _SIZES.fullmatch(size) else None for size in sizes.split(",")]
        if any(count is not None and len(count) > _MOST_DIGITS for count in counts):
            raise self.found.source.error_at(
                declared.start(3),
                make_message("{name} has more elements than any array.", name=name),
                remedy="Correct its size.",
            )
        dimensions = [None if count is None else int(count) for count in counts]
        return self._take_elements(kind, name, dimensions, declared.end())

    def _take_elements(self, kind: str, name: str, sizes: list[int | None], place: int) -> int:
        """Take the elements of an array of any dimension, in the order in which they are written.

        A size is None where a constant or an expression says it.
        """
        text, source = self.found.source.text, self.found.source
        index: list[int] = []
        while True:
            sign = text[place : place + 1]
            if sign == "[" and len(index) < len(sizes):
                index.append(1)
                place = after_blanks(text, place + 1)
                continue
            if not index:
                return self._take_computed(name, place)
            place = self._take_element(kind, f"{name}{{{','.join(map(str, index))}}}", place)
            while text[place : place + 1] == "]" and index:
                if index[-1] != (sizes[len(index) - 1] or index[-1]):
                    raise source.error_at(
                        place, make_message("{name} does not have the elements that it declares.", name=name)
                    )
                index.pop()
                place = after_blanks(text, place + 1)
            if not index:
                return place
            if text[place : place + 1] != ",":
                raise source.error_at(place, make_message("here should be ',' or ']' of {name}.", name=name))
            index[-1] += 1
            place = after_blanks(text, place + 1)

    def _take_element(self, kind: str, name: str, place: int) -> int:
        """Take one element of an array; return where the sign behind it stands."""
        text = self.found.source.text
        literal = AGGREGATES[kind].pattern.match(text, place)
        if literal is None and (end := end_of_element(text, place)) > place:
            if text[place] == "[":
                self._refuse_or_bar(name, place, AGGREGATES[kind].error_at(text, place))
            else:
                self._take_computed(name, place)
            return end
        return after_blanks(text, self._take_target(kind, name, place))

    def _take_target(self, kind: str, name: str, place: int) -> int:
        """Take a target's value; return where it ends."""
        try:
            found = AGGREGATES[kind].match_at(self.found.source.text, place)
        except AggregateError as error:
            return self._refuse_or_bar(name, place, error)
        add = self.found.add_robtarget if kind == "robtarget" else self.found.add_jointtarget
        self._declare_target(name, lambda: add(name, found))
        return found.end()

    def _refuse_or_bar(self, name: str, place: int, error: AggregateError) -> int:
        if not (error.computed or error.broken):
            raise self.found.source.error_at(
                error.place, str(error), remedy="Correct it on the controller, or leave this program out."
            ) from None
        if self.found.source.text.startswith("[", place):  # what other data hold does not move with the work
            why = NO_NUMBER if error.broken else INSIDE
            self._declare_target(name, lambda: self.found.add_unread(name, place, why))
        text = _BROKEN_TEXT if error.broken else _COMPUTED_TEXT
        return max(self._take_computed(name, place, text), error.place)

    def _take_computed(self, name: str, place: int, text: str = _COMPUTED_TEXT) -> int:
        """Take a target whose value only the controller knows, or another target has."""
        self.found.add_remark(place, "computed", make_message(text, name))
        self.uses.declare_without_row(name)
        self.note_copy(self.found.source.text, place, name)
        return place

    def _declare_target(self, name: str, add: Callable[[], None]) -> None:
        row = len(self.found.names)
        add()
        self.uses.declare_target(name, row, local=self.declared_local)

    def note_copy(self, text: str, place: int, to: str) -> bool:
        """Note a target that is assigned to another, which moves go to in its place; tell whether it is one."""
        if text.startswith("[", place):  # an array or a record of targets
            end = text.find(";", place, place + _LONGEST_LIST)
            elements = (decode_name(one[1]) for one in _ELEMENT.finditer(text, place, max(end, place)))
            inside = measured_inside(text, place, max(end, place))
            self.uses.copied |= {(self.uses.scope, name, to) for name in (*elements, *inside)}
            return False
        copied = _COPIED.match(text, place)
        if copied is not None:
            self.uses.copied.add((self.uses.scope, decode_name(copied[1]), to))
        elif measured := measured_name(text, place):
            self.uses.copied.add((self.uses.scope, measured, to))
        elif (called := _CALLED.match(text, place)) is not None:
            arguments = (decode_name(name) for name in _ARGUMENT.findall(called[2]))
            result = result_of(decode_name(called[1]))
            self.uses.returned |= {(self.uses.scope, name, to) for name in (*arguments, result)}
        return copied is not None
