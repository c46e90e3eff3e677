"""Where PDispSet, PDispOn and EOffs hold in a module, and which targets are moved to while they do."""

import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from cellcal.drivers.abb.program_files.literals import NAME, NOT_CODE, NUMBER, W
from cellcal.drivers.programs.shifts import UNREADABLE, Quaternion, Triple

_MOST_DISPLACEMENTS = 16  # of different sizes, of those that nothing ends: further ones are one of any size
WORDS = frozenset(("pdispset", "pdispon", "pdispoff", "eoffsset", "eoffson", "eoffsoff"))
USED = re.compile(r"\b(?:PDisp|EOffs)(?:Set|On)\b", re.IGNORECASE)
_POSE = (
    rf"\[{W}\[{W}"
    + rf"{W},{W}".join([f"({NUMBER})"] * 3)
    + rf"{W}\]{W},{W}\[{W}"
    + (rf"{W},{W}".join([f"({NUMBER})"] * 4) + rf"{W}\]{W}\]")
)
_POSE_VALUE = re.compile(rf"{W}{_POSE}", re.ASCII)
_CONSTANT = re.compile(rf"\bCONST\s+pose\s+({NAME}){W}:={W}{_POSE}", re.ASCII | re.IGNORECASE)
_ARGUMENT = re.compile(rf"{W}({NAME}){W};", re.ASCII)
_NAME_OF_ARGUMENT = re.compile(rf"{NAME}(?:\{{[^{{}}]*\}})?", re.ASCII)
_ROT = re.compile(r"\\\s*Rot\b", re.IGNORECASE)
_EXECUTED = re.compile(rf"\\{W}ExeP{W}:={W}(?:({NAME}){W}(?=[,\\]|\Z))?+", re.ASCII | re.IGNORECASE)
_PLAIN_REFERENCE = re.compile(rf"({NAME}){W},", re.ASCII)
_WORK_OBJECT = re.compile(rf"\\{W}WObj{W}:={W}({NAME}){W}\Z", re.ASCII | re.IGNORECASE)
_CODE = re.compile(rf"{NOT_CODE}|{NAME}|[;\n]", re.ASCII)
_OPENING = frozenset(("then", "for", "while", "test"))
_CLOSING = frozenset(("endif", "endfor", "endwhile", "endtest"))
_BRANCHING = frozenset(("elseif", "else", "case", "default", "goto", "return"))
_OWN = "set reset setdo setgo setao pulsedo invertdo waitdi waitdo waitgi waitai waittime waituntil"
_OWN += " waitrob tpwrite tperase tpreadnum tpreadfk tpshow uimsgbox incr decr add clear velset accset"
_OWN += " confl confj singarea gripload stop exit break if then else elseif endif for from to step do"
_OWN += " endfor while endwhile test case default endtest return goto label clkstart clkstop clkreset"
_OWN += " actunit deactunit tooldata stopmove startmove storepath restopath errwrite open close write not"
_OWN += " and or div mod true false var num bool string const pers local robtarget movel movej movec"
_OWN += " moveabsj isignaldi connect with idelete itimer isleep iwatch speedrefresh motionsup softact"
_OWN += " softdeact trigg triggl triggj triggc triggio triggequip searchl searchj searchc offs reltool"
_OWN += " crobt cjointt pdispset pdispon pdispoff eoffsset eoffson eoffsoff raise error undo endproc proc"
_OWN += " pose pos orient speeddata zonedata"
_OWN_WORDS = frozenset(_OWN.split())  # instructions of the language that go to no target


class TargetMove(NamedTuple):
    """A move to a target: its name, or the row of one that is written into the move."""

    place: int
    scope: str
    name: str
    row: int
    frame: str | None


class DisplacementEvent(NamedTuple):
    """An instruction that sets or ends a displacement."""

    place: int
    word: str
    spelled: str
    scope: str
    translation_m: Triple
    quaternion: Quaternion | None
    references: tuple[
        str, ...
    ] = ()  # of PDispOn: where the robot is, if that is named, and where it was taught
    frame: str | None = None  # of PDispOn: the work object of both, None where it is computed


class ActiveDisplacement(NamedTuple):
    """A displacement, the moves that are done while it holds, and whether others may be, too."""

    event: DisplacementEvent
    moves: tuple[TargetMove, ...]
    others: bool


@dataclass
class Displacements:
    """The displacements of a module, collected while it is read."""

    text: str
    events: list[DisplacementEvent] = field(default_factory=list)
    moves: list[TargetMove] = field(default_factory=list)
    references: list[tuple[str, str]] = field(default_factory=list)  # names in PDispOn, and where
    routines: dict[str, tuple[int, int]] = field(default_factory=dict)  # by scope: from, to

    def take_instruction(self, word: str, spelled: str, end: int, scope: str) -> None:
        """Note an instruction whose arguments begin at a place."""
        stop = self.text.find(";", end)
        stop = len(self.text) if stop < 0 else stop
        translation, quaternion = UNREADABLE, None
        if word == "pdispset":
            translation, quaternion = self._parse_pose(end)
        references: tuple[str, ...] = ()
        frame: str | None = None
        if word == "pdispon":
            names = _NAME_OF_ARGUMENT.findall(self.text[end:stop])
            self.references += [(name, scope) for name in names]
            references, frame = self._read_references(end, stop)
        self.events.append(
            DisplacementEvent(end, word, spelled, scope, translation, quaternion, references, frame)
        )

    def _read_references(self, place: int, end: int) -> tuple[tuple[str, ...], str | None]:
        """Return the targets of PDispOn and its work object; no target where one is no plain name."""
        arguments = self.text[place:end]
        there = _EXECUTED.search(arguments)
        rest = _EXECUTED.sub("", _ROT.sub("", arguments)).lstrip(" \t\r\n,")
        taught = _PLAIN_REFERENCE.match(rest)
        object_named = _WORK_OBJECT.search(rest)
        if taught is None or (there is not None and there[1] is None):
            return (), None
        frame = "wobj0" if "\\" not in rest else object_named[1] if object_named else None
        return (*([there[1]] if there else []), taught[1]), frame

    def move_before(self, event: DisplacementEvent) -> TargetMove | None:
        """Return the move that surely brought the robot to where an instruction is run; None where none did."""
        begin, _ = self.routines.get(event.scope, (0, 0))
        some = [move for move in self._moves_between(begin, event.place) if move.scope == event.scope]
        if not some:
            return None
        words = list(self._iterate_words(some[-1].place, event.place))
        scopes, others = self._called_scopes(some[-1].place, event.place)
        calls = others or any(move.scope in scopes for move in self.moves)
        return None if calls or _is_branching([word for word, _ in words]) else some[-1]

    @cached_property
    def active_displacements(self) -> tuple[ActiveDisplacement, ...]:
        """Every displacement with the moves that it counts for, once the module is read."""
        endless: dict[DisplacementEvent, DisplacementEvent] = {}
        ended: dict[ActiveDisplacement, ActiveDisplacement] = {}
        for event in self.events:
            off = None if event.word.endswith("off") else self._end_of(event)
            if off is not None:
                found = self._displacement_of(event, off)
                ended.setdefault(found._replace(event=event._replace(place=0)), found)
            elif not event.word.endswith("off"):
                many = len(endless) >= _MOST_DISPLACEMENTS
                kept = event._replace(translation_m=UNREADABLE, quaternion=None) if many else event
                effect = kept._replace(place=0, scope="", references=(), frame=None)
                endless.setdefault(effect, kept)
        moves = tuple(self.moves)
        found_all = [ActiveDisplacement(event, moves, others=True) for event in endless.values()]
        return tuple(sorted((*found_all, *ended.values()), key=lambda one: one.event.place))

    @cached_property
    def _places_of_ends(self) -> dict[tuple[str, str], list[int]]:
        found: dict[tuple[str, str], list[int]] = {}
        for event in self.events:
            if event.word.endswith("off"):
                found.setdefault((event.scope, event.word), []).append(event.place)
        return found

    def _end_of(self, event: DisplacementEvent) -> int | None:
        """Return where its routine ends a displacement next; None where it does not."""
        places = self._places_of_ends.get((event.scope, event.word[:5] + "off"), [])
        following = bisect_right(places, event.place)
        return places[following] if following < len(places) else None

    def _parse_pose(self, place: int) -> tuple[Triple, Quaternion | None]:
        found = _POSE_VALUE.match(self.text, place)
        if found is not None:
            return _pose_numbers(found, 1)
        named = _ARGUMENT.match(self.text, place)
        constants = self._constants.get(named[1].lower(), []) if named else []
        return constants[0] if len(constants) == 1 else (UNREADABLE, None)

    @cached_property
    def _constants(self) -> dict[str, list[tuple[Triple, Quaternion | None]]]:
        found: dict[str, list[tuple[Triple, Quaternion | None]]] = {}
        for one in _CONSTANT.finditer(self.text):
            found.setdefault(one[1].lower(), []).append(_pose_numbers(one, 2))
        return found

    def _displacement_of(self, event: DisplacementEvent, off: int) -> ActiveDisplacement:
        begin, end = self.routines.get(event.scope, (0, len(self.text)))
        words = [word for word, _ in self._iterate_words(event.place, off)]
        whole = _is_branching(words)
        span = (begin, end) if whole else (event.place, off)
        scopes, others = self._called_scopes(*span)
        moves = [move for move in self._moves_between(*span) if move.scope == event.scope]
        moves += [move for scope in sorted(scopes) for move in self._moves_by_scope.get(scope, ())]
        return ActiveDisplacement(event, tuple(dict.fromkeys(moves)), others)

    def _moves_between(self, begin: int, end: int) -> Sequence[TargetMove]:
        places = self._places_of_moves
        return self.moves[bisect_right(places, begin) : bisect_right(places, end)]

    @cached_property
    def _places_of_moves(self) -> list[int]:
        return [move.place for move in self.moves]

    @cached_property
    def _moves_by_scope(self) -> dict[str, list[TargetMove]]:
        found: dict[str, list[TargetMove]] = {}
        for move in self.moves:
            found.setdefault(move.scope, []).append(move)
        return found

    @cached_property
    def _scopes_by_name(self) -> dict[str, list[str]]:
        by_name: dict[str, list[str]] = {}
        for scope in self.routines:
            by_name.setdefault(scope.partition("/")[2], []).append(scope)
        return by_name

    def _called_scopes(self, begin: int, end: int) -> tuple[set[str], bool]:
        """Return the scopes that are called from a part of the text, and whether others may be."""
        waiting, scopes, others = [(begin, end)], set[str](), False
        by_name = self._scopes_by_name
        while waiting:
            for word, leads in self._iterate_words(*waiting.pop()):
                some = by_name.get(word, ())
                others |= leads and not some and word not in _OWN_WORDS
                new = [scope for scope in some if scope not in scopes]
                scopes.update(new)
                waiting += [self.routines[scope] for scope in new]
        return scopes, others

    def _iterate_words(self, begin: int, end: int) -> Iterator[tuple[str, bool]]:
        """Yield the words of a part of the text, and whether each begins a statement."""
        leads = False
        for found in _CODE.finditer(self.text, begin, end):
            if found[0][0] in '!"':
                continue
            if found[0] in ";\n":
                leads = True
                continue
            yield found[0].lower(), leads and self.text[found.end() : found.end() + 2].lstrip()[:1] != ":"
            leads = False


def _is_branching(words: Sequence[str]) -> bool:
    """Return whether the way between two instructions is not the only one."""
    depth = 0
    for word in words:
        depth += (word in _OPENING) - (word in _CLOSING)
        if depth < 0 or (not depth and word in _BRANCHING):
            return True
    return depth != 0 or (words.count("if") != words.count("then") - words.count("elseif"))


def _pose_numbers(found: re.Match[str], first: int) -> tuple[Triple, Quaternion | None]:
    values = [float(found[first + k]) for k in range(7)]
    norm = sum(value * value for value in values[3:]) ** 0.5
    if not abs(norm - 1.0) < 1e-2:
        return UNREADABLE, None
    x, y, z = (value * 1e-3 for value in values[:3])
    q1, q2, q3, q4 = (value / norm for value in values[3:])
    return (x, y, z), (q1, q2, q3, q4)
