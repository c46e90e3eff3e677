"""Which tool and work object a target is used with: what the moves of a file say of the names it declares."""

from collections import defaultdict
from collections.abc import Mapping, Set
from dataclasses import dataclass, field

from cellcal.calibration.message import make_message
from cellcal.drivers.abb.program_files.collected_positions import RapidPositions
from cellcal.drivers.abb.program_files.declared_targets import DeclaredTargets
from cellcal.drivers.abb.program_files.frame_facts import BARRED_COMPUTED, AgreedUse, FrameFacts, ToolAndFrame
from cellcal.drivers.abb.program_files.measured_places import is_measured
from cellcal.drivers.abb.program_files.written_frames import NUMBERS
from cellcal.drivers.programs.barred import MOVED_BY_UNIT, ONLY_SEEN_THERE, SEEN_FROM_FLANGE
from cellcal.drivers.programs.conditions import ConditionalBar, ProjectNeed
from cellcal.drivers.programs.file_declarations import COPIED, MoveFrames
from cellcal.drivers.programs.positions import CARTESIAN
from cellcal.drivers.programs.routine_calls import OWN, PARAMETER, ParameterUse, RoutineCall

_DIFFERENT = "{} is used with different tools or work objects; its user frame and tool are not known."
RESULT = "result of "  # before a function's name: what it returns
_MOST_USES = 64  # of one target that are told apart


@dataclass
class TargetUses(DeclaredTargets):
    """The moves that name declared targets: with which tool and work object each target is used."""

    facts: FrameFacts = field(default_factory=FrameFacts)
    copied: set[tuple[str, str, str]] = field(default_factory=set)  # scope, name, and to what
    returned: set[tuple[str, str, str]] = field(
        default_factory=set
    )  # the same, for arguments of a function whose value it is
    passed: dict[tuple[str, str], set[tuple[str, str]]] = field(
        default_factory=lambda: defaultdict(set)
    )  # by where it is declared, and its name: the parameters that get it
    local_frames: set[str] = field(default_factory=set)  # tools and work objects that other files do not see
    external_uses: dict[str, set[MoveFrames]] = field(
        default_factory=dict
    )  # uses of what is not declared here
    used: dict[tuple[str, str], set[ToolAndFrame]] = field(
        default_factory=lambda: defaultdict(set)
    )  # by scope and name
    names_used: dict[tuple[str, str], set[str]] | None = (
        None  # from the first question on: as written, by scope and name
    )
    of_row: dict[int, list[ToolAndFrame]] = field(default_factory=lambda: defaultdict(list))
    tools_of_moves: set[str] = field(default_factory=lambda: {"tool0"})  # in small letters
    spelling: dict[str, str] = field(default_factory=lambda: {"wobj0": "wobj0", "tool0": "tool0"})
    named_in: set[tuple[str, str]] = field(
        default_factory=set
    )  # tools and work objects, and the scopes of moves
    of_routines: set[tuple[str, str]] = field(
        default_factory=set
    )  # those that routines declare, and their scopes
    held_work: set[int] = field(default_factory=set)  # rows seen from the work in the gripper
    conditions: dict[int, ConditionalBar] = field(default_factory=dict)
    user_frames: dict[int, str] = field(default_factory=dict)
    tools: dict[int, str] = field(default_factory=dict)
    barred: dict[int, str] = field(default_factory=dict)  # rows whose tool or frame is not one, and why
    of_parameters: dict[tuple[str, str], set[ToolAndFrame]] = field(
        default_factory=dict
    )  # by scope and parameter: how the routine's moves go to what is passed
    of_copied_parameters: dict[tuple[str, str], set[ToolAndFrame]] = field(
        default_factory=dict
    )  # how moves go to copies of them; nothing where none does
    of_open_places: dict[tuple[str, str], set[ToolAndFrame]] = field(
        default_factory=lambda: defaultdict(set)
    )  # by where a place is declared, and its name
    sources: dict[tuple[str, str], set[tuple[str, str]]] = field(
        default_factory=lambda: defaultdict(set)
    )  # by what they are copied to
    calls_of_other_files: list[RoutineCall] = field(
        default_factory=list
    )  # of routines that other files declare

    def spell_name(self, name: str) -> str:
        """Return a name as it was first written."""
        return self.spelling.setdefault(name.lower(), name)

    def seen_by_other_files(self, tool: str | None, frame: str | None) -> ParameterUse:
        """Return a use for other files, which do not see all tools and work objects of this one."""
        if not (tool and frame):
            return ParameterUse(tool, frame, BARRED_COMPUTED)
        is_local = {tool.lower(), frame.lower()} & self.local_frames or NUMBERS in f"{tool}{frame}"
        return ParameterUse(tool, frame, ONLY_SEEN_THERE if is_local else "")

    def note_use(self, name: str, tool: str | None, frame: str | None) -> None:
        """Note that a move goes to a named target."""
        self.used[self.scope, name].add(self._spell_use(tool, frame))

    def use_row(self, row: int, tool: str | None, frame: str | None) -> None:
        """Note what a target inside a move is used with."""
        self.of_row[row].append(self._spell_use(tool, frame))

    def resolve_uses(self, found: RapidPositions) -> None:
        """Give every row the tool and work object that all its uses agree on."""
        hiding = {name for name, _ in self.of_routines}
        self.facts.several |= {name for name, scope in self.named_in - self.of_routines if name in hiding}
        of_rows: dict[tuple[int, ...], set[ToolAndFrame]] = defaultdict(set)
        for (scope, name), what_all in self.used.items():
            rows = self.rows_of(name, scope)
            if not rows and not self.is_own(name, scope):
                self._note_external_use(name, what_all)
            of_rows[tuple(rows)] |= what_all
        for rows_of_all, what_all in of_rows.items():
            some = sorted(what_all, key=str)[:_MOST_USES]  # of thousands, these tell that there are several
            for row in rows_of_all:
                self.of_row[row] += some
        self._take_uses_of_copies()
        self._bar_copied_targets(found)
        settled: dict[frozenset[ToolAndFrame], AgreedUse] = {}  # nearly all targets have the same
        for row, some in sorted(self.of_row.items()):
            what = frozenset(some)
            if what not in settled:
                settled[what] = self.facts.agree_on(what)
            self._settle_row(found, row, settled[what])

    def _take_uses_of_copies(self) -> None:
        """Count a move to a copy for the target that it was made of, where moves go there as well."""
        if not (self.copied or self.returned):
            return
        of_copies = self._uses_of_places()
        made = self.copied | self.returned
        copies = self._copies_made()
        settled: dict[frozenset[tuple[str, str]], list[ToolAndFrame]] = {}
        reached: dict[tuple[str, str], frozenset[tuple[str, str]]] = {}
        for scope, name in sorted({each[:2] for each in made}):
            place = self.find_declared(name, scope)
            if place not in reached:
                reached[place] = frozenset(_reachable_copies(copies, place))
            its = reached[place]
            if its not in settled:  # many are copied to the same
                uses = {use for copy in its for use in of_copies.get(copy, ())}
                settled[its] = sorted(uses, key=str)[:_MOST_USES]
            some = settled[its]
            counts = name.lower() in self.external_uses or name.startswith(RESULT)
            if some and counts and not self.is_own(name, scope):
                self._note_external_use(name, set(some))
            for row in self.rows_of(name, scope) if some else ():
                if row in self.of_row:
                    self.of_row[row] += some

    def _uses_of_places(self) -> dict[tuple[str, str], set[ToolAndFrame]]:
        """Return the uses by where a place is declared, and its name."""
        found: dict[tuple[str, str], set[ToolAndFrame]] = defaultdict(set)
        for (scope, name), what_all in self.used.items():
            found[self.find_declared(name, scope)] |= what_all
        return found

    def _copies_made(self) -> dict[tuple[str, str], set[tuple[str, str]]]:
        """Return by where a place is declared, and its name, what gets its value, parameters among them."""
        copies: dict[tuple[str, str], set[tuple[str, str]]] = defaultdict(set)
        copies |= {key: set(some) for key, some in self.passed.items()}
        for scope, name, to in self.copied | self.returned:
            copies[self.find_declared(name, scope)].add(self.find_declared(to, scope))
        return copies

    def frames_of_measured(self) -> dict[tuple[str, str], set[str | None]]:
        """Return the work objects in which moves go to places that are measured, by the scope and name of each.

        A parameter that a routine sets so is data of its callers.
        """
        measured = {(scope, name) for scope, name, _ in self.copied if is_measured(name)}
        measured |= {(scope, name) for scope, name in self.used if is_measured(name)}
        if not measured:
            return {}
        uses, copies = self._uses_of_places(), self._copies_made()
        for place, some in self.of_parameters.items():
            uses[place] |= some
        for passed, parameters in self.passed.items():
            for parameter in parameters:
                copies[parameter].add(passed)
        found = {}
        for scope, name in measured:
            place = self.find_declared(name, scope)
            its = {place} | _reachable_copies(copies, place)
            found[scope, name] = {frame for one in its for _, frame in uses.get(one, ())}
        return found

    def copies_for_other_files(self) -> tuple[tuple[str, str], ...]:
        """Return the targets of which copies are made that other files see: their name for others, and the copy's."""
        found: set[tuple[str, str]] = set()
        for scope, name, to in self.copied | self.returned:
            source, copy = self.key_for_other_files(name, scope), self.key_for_other_files(to, scope)
            if source and copy and not source.startswith(PARAMETER) and not copy.startswith((OWN, PARAMETER)):
                found.add((source if source.startswith(OWN) else source.lower(), copy.lower()))
        return tuple(sorted(found))

    def copied_into(self, name: str, scope: str) -> list[str]:
        """Return the targets, by their names for other files, that were copied into a name or an element of it."""
        if not self.sources:
            for where, source, to in self.copied:
                self.sources[self.find_declared(to, where)].add((where, source))
        waiting, found = [self.find_declared(name, scope)], set[tuple[str, str]]()
        while waiting:
            more = self.sources.get(waiting.pop(), set()) - found
            waiting += [self.find_declared(source, where) for where, source in more]
            found |= more
        keys = {self.key_for_other_files(source, where) for where, source in found}
        return sorted(keys - {""})

    def shown_uses(self) -> dict[str, frozenset[MoveFrames]]:
        """Return how moves of this file go to targets that other files see, too, by name."""
        found: dict[str, set[MoveFrames]] = {}
        for bare, rows in self.of_modules.items():
            for row in rows[:1] if len(rows) == 1 else rows[:_MOST_USES]:
                for use in self.of_row.get(row, ())[:_MOST_USES]:
                    found.setdefault(bare, set()).add(MoveFrames(*self.seen_by_other_files(*use)[:3]))
        return {bare: frozenset(some) for bare, some in found.items()}

    def _bar_copied_targets(self, found: RapidPositions) -> None:
        """Leave targets that no move goes to but by a copy."""
        of_copies = {
            place: {MoveFrames(*use, COPIED) for use in sorted(some, key=str)[:_MOST_USES]}
            for place, some in (self._uses_of_places() if self.copied else {}).items()
        }
        for scope, name, to in self.copied:
            if not self.is_own(name, scope):
                its = self.external_uses.setdefault(name.lower(), set())
                its.add(MoveFrames(None, None, COPIED))
                its |= of_copies.get(self.find_declared(to, scope), set())
            for row in self.rows_of(name, scope):
                if row not in self.of_row and found.kinds[row] == CARTESIAN:
                    self.barred[row] = COPIED

    def _note_external_use(self, name: str, uses: set[ToolAndFrame]) -> None:
        seen_uses = [self.seen_by_other_files(tool, frame) for tool, frame in uses]
        self.external_uses.setdefault(name.lower(), set()).update(MoveFrames(*use[:4]) for use in seen_uses)

    def note_external_value(self, name: str, scope: str, why: str) -> None:
        """Note that a place which no declaration of this file means gets a value, or a component of it."""
        if not self.is_own(name, scope):
            self.external_uses.setdefault(name.lower(), set()).add(MoveFrames(None, None, why))

    def _settle_row(self, found: RapidPositions, row: int, settled: AgreedUse) -> None:
        if found.kinds[row] != CARTESIAN:  # axes are in no frame, but a tool is at their end
            open_tools = self.facts.open_tools()
            if settled.tool is not None and settled.tool.lower() not in open_tools:
                self.tools[row] = settled.tool
            return
        self._settle_reason(row, settled.why)
        if settled.different:
            found.add_remark(found.starts[row], "indirect", make_message(_DIFFERENT, found.names[row]))
        if settled.seen_from_flange and not self.facts.is_held_work(settled):
            found.drop_coordinates(row, SEEN_FROM_FLANGE)
            return
        if settled.seen_from_flange:
            self.held_work.add(row)
            self.conditions[row] = ConditionalBar.for_need(ProjectNeed.STANDING_TOOL, SEEN_FROM_FLANGE)
        if settled.tool is not None:
            self.tools[row] = settled.tool
        if settled.frame is not None:
            self.user_frames[row] = settled.frame

    def _settle_reason(self, row: int, why: str) -> None:
        if why == MOVED_BY_UNIT:
            self.conditions[row] = ConditionalBar.for_need(ProjectNeed.MOVED_FRAME, why)
        elif why:
            self.barred[row] = why

    def _spell_use(self, tool: str | None, frame: str | None) -> ToolAndFrame:
        spelled = self.known_here.get((tool, frame))
        if spelled is None:
            spelled = self.known_here[tool, frame] = (self._visible_name(tool), self._visible_name(frame))
            self.named_in |= {(name.lower(), self.scope) for name in spelled if name is not None}
            if spelled[0] is not None and not spelled[0].startswith(PARAMETER):
                self.tools_of_moves.add(spelled[0].lower())
        return spelled

    def _visible_name(self, name: str | None) -> str | None:
        return None if name is None else self.name_seen_from(self.scope, name)

    def name_seen_from(self, scope: str, name: str) -> str:
        """Return a tool or work object as a scope names it: as it was first written, or a parameter's name."""
        if (scope, name.lower()) in self.parameters:
            return PARAMETER + name.lower()
        return self.spell_name(name)

    def uses_in(self, scope: str, name: str) -> set[ToolAndFrame]:
        """Return how the moves of a scope go to a name, or to elements of it."""
        if self.names_used is None:
            self.names_used = defaultdict(set)
            for where, target in self.used:
                self.names_used[where, target.partition("{")[0].lower()].add(target)
        names = self.names_used.get((scope, name), ())
        return {use for target in names for use in self.used[scope, target]}

    def uses_of_open_place(self, name: str, scope: str) -> set[ToolAndFrame]:
        """Return how the moves of a file go to a place that it declares without numbers; nothing for any other."""
        place = self.find_declared(name, scope)
        if place[0] in ("", "?") or self.rows_of(name, scope):
            return set()
        if not self.of_open_places:
            for (where, target), some in self.used.items():
                self.of_open_places[self.find_declared(target, where)] |= some
        return self.of_open_places.get(place, set()) | self.of_parameters.get(place, set())

    def add_uses(self, scope: str, name: str, uses: set[ToolAndFrame]) -> bool:
        """Note more uses of a name; tell whether there are new ones."""
        if uses <= self.used.get((scope, name), set()):
            return False
        if self.names_used is not None:
            self.names_used[scope, name.partition("{")[0].lower()].add(name)
        self.used[scope, name] |= uses
        return True

    def note_passed(self, scope: str, name: str, parameter: tuple[str, str]) -> None:
        """Note that a routine's parameter, by scope and name, gets what stands in a name."""
        self.passed[self.find_declared(name, scope)].add(parameter)

    def note_copied_parameters(self) -> None:
        """Note how moves of this file go to copies of parameters, and to copies of those."""
        copies: dict[tuple[str, str], set[tuple[str, str]]] = defaultdict(set)
        for scope, name, to in self.copied:
            copies[self.find_declared(name, scope)].add(self.find_declared(to, scope))
        if not self.parameters & copies.keys():
            return
        uses = self._uses_of_places()
        for parameter in self.parameters & copies.keys():
            found = _reachable_copies(copies, parameter)
            of_copies = (sorted(uses.get(copy, ()), key=str) for copy in sorted(found))
            self.of_copied_parameters[parameter] = {use for some in of_copies for use in some[:_MOST_USES]}

    def uses_of_parameter(self, scope: str, name: str) -> frozenset[ParameterUse]:
        """Return how moves go to a parameter, and to copies of it, for other files."""
        parameter = scope, name
        found = {self.seen_by_other_files(*use) for use in self.of_parameters.get(parameter, ())}
        if parameter in self.of_copied_parameters:
            copied = {self.seen_by_other_files(*use) for use in self.of_copied_parameters[parameter]}
            found |= {use if use.why else use._replace(why=COPIED) for use in copied}
            found.add(ParameterUse(None, None, COPIED))
        return frozenset(found)

    def forget_parameters(self) -> None:
        """Drop the moves to parameters, which count for what is passed, and tools that only a call could name."""
        for scope, name in list(self.used):
            parameter = scope, name.partition("{")[0].lower()
            if parameter in self.parameters:
                self.of_parameters.setdefault(parameter, set()).update(self.used.pop((scope, name)))
        for key, some in self.used.items():
            self.used[key] = {(_without_mark(tool), _without_mark(frame)) for tool, frame in some}
        for row, uses in self.of_row.items():
            self.of_row[row] = [(_without_mark(tool), _without_mark(frame)) for tool, frame in uses]


def result_of(function: str) -> str:
    """Return the name under which the result of a function is followed."""
    return f"{RESULT}{function.lower()}"


def _reachable_copies(
    copies: Mapping[tuple[str, str], Set[tuple[str, str]]], first: tuple[str, str]
) -> set[tuple[str, str]]:
    """Return what is made of a target, and what of that, without the target itself."""
    found, waiting = {first}, [first]
    while waiting:
        more = copies.get(waiting.pop(), set()) - found
        found |= more
        waiting += more
    return found - {first}


def _without_mark(name: str | None) -> str | None:
    return None if name is not None and name.startswith(PARAMETER) else name
