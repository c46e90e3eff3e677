"""Steps that a URScript program takes from where the robot stands, behind moves to joint angles."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import inf

from cellcal.drivers.programs.shifts import UNKNOWN_FRAME, ProgramShift, ShiftAxes
from cellcal.drivers.universal_robots.program_files.script_calls import MOVES
from cellcal.drivers.universal_robots.program_files.script_positions import BASE, PositionFinder, ScriptPlace
from cellcal.drivers.universal_robots.program_files.script_scopes import GLOBAL, ScriptScopes
from cellcal.drivers.universal_robots.program_files.script_shifts import COMPUTED_PLACE

_B = r"[ \t]*+"
_TAKEN = rf"(?:\b(?P<to>[A-Za-z_]\w*+){_B}=(?!=){_B})?+(?<!def )\b(?P<call>{{}}){_B}\({_B}{{}}{_B}\)"
_HERE = re.compile(
    _TAKEN.format("get_(?:actual|target)_tcp_pose|get_forward_kin", r"(?P<joints>[A-Za-z_]\w*+)?+"), re.ASCII
)
_ARGUMENTS = r"(?P<joints>(?!))?+[^()\r\n]*+"  # of a function of the script that returns such a place
_BEHIND = re.compile(rf"\bpose_trans{_B}\({_B}(?:[A-Za-z_]\w*+|p\[[^\[\]]*+\]){_B},{_B}\Z", re.ASCII)
_STEPS = ("pose_trans", "pose_add", "pose_sub")
_FROM = re.compile(rf"\b(?:{'|'.join(_STEPS)}){_B}\({_B}\Z", re.ASCII)
_CALL = re.compile(r"(?<!def )(?<!thread )\b([A-Za-z_]\w*+)[ \t]*+\(", re.ASCII)
_LONGEST_GAP, _LONGEST_FRAME = 80, 400
Rows = tuple[int, ...]


@dataclass
class ScriptSteps:
    """Where the robot stands when a script takes its place, as far as the moves before that tell."""

    text: str
    finder: PositionFinder
    places: Sequence[ScriptPlace]
    _scopes: ScriptScopes = field(init=False)
    _events: dict[int, list[tuple[int, str]]] = field(
        init=False, default_factory=dict
    )  # by function: where it moves ("") or calls an own one (its name)

    def list_shifts(self) -> Iterator[ProgramShift]:
        """Yield the steps behind moves to joint angles, with the rows of these, and places taken in a frame."""
        taken = self._list_taken()
        if any(map(self._begins_step, taken)):
            self._read_events()
        for found in taken:
            line = self.finder.line_of(found.start("call"))
            if self._begins_step(found) and (rows := self._rows_of(found)):
                yield ProgramShift(line, found["call"], ShiftAxes.USER_FRAME, rows, goes_on=True)
            if self._stands_behind_frame(found):
                yield ProgramShift(
                    line,
                    found["call"],
                    ShiftAxes.USER_FRAME,
                    point=COMPUTED_PLACE,
                    user_frame=BASE,
                    quaternion=None,
                    other_frame=UNKNOWN_FRAME,
                )

    def _list_taken(self) -> list[re.Match[str]]:
        """Return where the place of the robot is taken, at once or by functions of the script that return it."""
        taken = self._matches_of(_HERE)
        returning = self.finder.passed.returning(taken) if taken else set()
        known = set[str]()
        while returning > known:
            known = returning
            by_function = re.compile(_TAKEN.format("|".join(sorted(known)), _ARGUMENTS), re.ASCII)
            taken = [*self._matches_of(_HERE), *self._matches_of(by_function)]
            returning = known | self.finder.passed.returning(taken)
        return taken

    def _matches_of(self, pattern: re.Pattern[str]) -> list[re.Match[str]]:
        return [found for found in pattern.finditer(self.text) if not self._is_comment(found.start())]

    def _rows_of(self, found: re.Match[str]) -> Rows:
        """Return the joint points where the robot stands, or of which the place is computed."""
        if found["joints"] is None:
            return self._rows_before(self._start_of_statement(found.start()), frozenset())
        return tuple(
            row
            for row, place in enumerate(self.places)
            if place.pose is None and place.joints is not None and place.joints.name == found["joints"]
        )

    def _stands_behind_frame(self, found: re.Match[str]) -> bool:
        """Return whether what is taken here, in the base, is brought into a frame, by copies and functions, too."""
        to, passed = found["to"], self.finder.passed
        uses = self.finder.found.uses.get(to, ()) if to else ()
        places = [found.start(), *(at for at, _, _ in uses)]
        if any(_BEHIND.search(self.text, max(0, at - _LONGEST_FRAME), at) for at in places):
            return True
        if to:
            return passed.is_brought_into_a_frame(to, found.start("to"), itself=True)
        return passed.is_passed_into_a_frame(found.start("call"))

    def _start_of_statement(self, offset: int) -> int:
        """Return where the line begins whose brackets are open at an offset."""
        start = self.text.rfind("\n", 0, offset) + 1
        while start and self.text[max(start - _LONGEST_GAP, 0) : start].rstrip()[-1:] in ("(", ","):
            start = self.text.rfind("\n", 0, start - 1) + 1
        return start

    def _begins_step(self, found: re.Match[str]) -> bool:
        """Return whether a step is added to what is taken here, at once or by its name."""
        if found["to"] is None:
            begin = found.start()
            return _FROM.search(self.text, max(0, begin - _LONGEST_GAP), begin) is not None
        return any(where in _STEPS for _, _, where in self.finder.found.uses.get(found["to"], ()))

    def _read_events(self) -> None:
        self._scopes = ScriptScopes(self.text)
        own = {one.name for one in self._scopes.functions}
        for found in _CALL.finditer(self.text):
            at, name = found.start(1), found[1]
            if (name in MOVES or name in own) and not self._is_comment(at):
                events = self._events.setdefault(self._scopes.function_at(at), [])
                events.append((at, "" if name in MOVES else name))

    def _is_comment(self, offset: int) -> bool:
        return "#" in self.text[self.text.rfind("\n", 0, offset) + 1 : offset]

    def _rows_before(self, offset: float, visited: frozenset[int], function: int | None = None) -> Rows:
        """Return the joint points to which the last moves before an offset go; at its callers where none is."""
        function = self._scopes.function_at(int(offset)) if function is None else function
        found = self._last_rows(function, offset, visited)
        if found is not None or function in (GLOBAL, *visited):
            return found or ()
        name = self._scopes.functions[function].name
        sites = [at for events in self._events.values() for at, called in events if called == name]
        rows = {row for at in sites for row in self._rows_before(at, visited | {function})}
        return tuple(sorted(rows))

    def _last_rows(self, function: int, offset: float, visited: frozenset[int]) -> Rows | None:
        """Return the joint points of the last move of a function before an offset; None where it has none."""
        for at, called in reversed(self._events.get(function, ())):
            if at >= offset:
                continue
            if not called:
                return self._rows_of_move(at)
            inside = next((n for n, one in enumerate(self._scopes.functions) if one.name == called), function)
            if inside != function and inside not in visited:
                found = self._last_rows(inside, inf, visited | {function})
                if found is not None:
                    return found
        return None

    def _rows_of_move(self, offset: int) -> Rows:
        """Return the rows of joint angles that a move goes to."""
        later = [
            at for events in self._events.values() for at, called in events if at > offset and not called
        ]
        end = min(later, default=len(self.text))
        return tuple(
            row
            for row, place in enumerate(self.places)
            if place.pose is None and any(offset <= used < end for used in place.used)
        )
