"""Places and frames that the files of a batch pass to each other's routines, and what these do with them."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence

from cellcal.drivers.programs.barred import COMPUTED, ONLY_SEEN_THERE, OVERWRITTEN
from cellcal.drivers.programs.file_declarations import (
    COPIED,
    OPEN_COPY,
    FileDeclarations,
    MoveFrames,
    lower_name,
)
from cellcal.drivers.programs.routine_calls import (
    OWN,
    PARAMETER,
    UNCERTAIN,
    ParameterUse,
    RoutineCall,
    RoutineTargets,
)

_MOST_ROUNDS = 20


class PassedPlaces:
    """The calls of a batch that pass something to routines that get places."""

    def __init__(
        self,
        declarations: Mapping[str, FileDeclarations],
        nearest: Callable[[str, Sequence[str]], Sequence[str]],
    ) -> None:
        self._by_file = declarations
        self._nearest = nearest
        self._getting: dict[str, list[str]] = defaultdict(list)  # by routine: the files that have it
        self._targets: dict[tuple[str, str], RoutineTargets] = {}  # by file and routine
        self._tools = frozenset[str]().union(*(one.named_tools for one in declarations.values()))
        self._given = frozenset[str]().union(*(one.routine_names for one in declarations.values()))
        for file, one in declarations.items():
            for routine, its in one.routine_targets.items():
                self._getting[routine].append(file)
                self._targets[file, routine] = its
        for _ in range(_MOST_ROUNDS):  # what one passes on, the next may pass on, too
            changes = [self._take_passed_on(file) | self._take_passed_out(file) for file in declarations]
            if not any(changes):
                break

    def _take_passed_on(self, file: str) -> bool:
        """Count what is done to the parameters that a file's routines pass on; tell whether that is more."""
        more = False
        for call, routine, other in self._answered_calls(file):
            own = self._targets.get((file, call.caller)) if call.passes_on else None
            if own is None:
                continue
            uses = {name: set(some) for name, some in own.uses.items()}
            for name, use in _passed_uses(call, routine):
                if name.startswith(PARAMETER):
                    further = use._replace(file=use.file or other)
                    uses.setdefault(name.removeprefix(PARAMETER), set()).add(further)
            by_reference = {one.name for one in own.parameters if not one.by_value}
            passed = {name.removeprefix(PARAMETER) for name in routine.passed_values(call)}
            new = own._replace(
                uses={name: frozenset(some) for name, some in uses.items()},
                written=own.written | (passed & by_reference),
            )
            more |= new != own
            self._targets[file, call.caller] = new
        return more

    def _take_passed_out(self, file: str) -> bool:
        """Count what a routine passes on to one that was not given as set; tell whether that is more."""
        more = False
        for call, name in self._passed_out(file):
            own = self._targets.get((file, call.caller)) if name.startswith(PARAMETER) else None
            if own is None:
                continue
            bare = name.removeprefix(PARAMETER)
            its = {one.name for one in own.parameters if not (one.by_value or one.is_target)}
            new = own._replace(written=own.written | ({bare} & its))
            more |= new != own
            self._targets[file, call.caller] = new
        return more

    def _passed_out(self, file: str) -> Iterator[tuple[RoutineCall, str]]:
        """Yield calls of routines that no file has, with each of the data that these may set."""
        for call in self._by_file[file].calls:
            if call.references and call.routine not in self._given:
                yield from ((call, name) for name in call.references)

    def frames_open_to(self, file: str) -> Iterator[str]:
        """Yield names of tools and frames that a file passes to routines which were not given."""
        for _, name in self._passed_out(file):
            if not name.startswith((OWN, PARAMETER)):
                yield name.lower()

    def uses_by(self, file: str) -> Iterator[tuple[str, MoveFrames, str]]:
        """Yield the places that a file's calls pass, what routines do to them, and the file that does."""
        for call, routine, other in self._answered_calls(file):
            for name, use in _passed_uses(call, routine):
                why = use.why or ("" if use.tool and use.frame else COMPUTED)
                if not name.startswith(PARAMETER):
                    there = use.file or other
                    if not why and self._is_local(file, use):
                        why, there = ONLY_SEEN_THERE, file
                    yield self._key(file, name), MoveFrames(use.tool, use.frame, why, use.routine), there
            for name in routine.passed_values(call):
                if not name.startswith(PARAMETER):
                    yield self._key(file, name), MoveFrames(None, None, OVERWRITTEN), other

    def uses_stated_by(self, file: str) -> Iterator[tuple[str, MoveFrames]]:
        """Yield data beside which a call names a frame, and maybe a tool, of a routine that no file has."""
        for call in self._by_file[file].calls:
            if call.stated is None or call.routine in self._getting:
                continue
            for name in call.arguments:
                if name and not name.startswith(PARAMETER):
                    yield self._key(file, name), MoveFrames(*self._with_known_tool(call.stated)[:4])

    def _with_known_tool(self, use: ParameterUse) -> ParameterUse:
        """Return a use with its tool where a file of the batch knows what may be one."""
        name = (use.tool or "").removeprefix(UNCERTAIN)
        return use._replace(tool=name) if name.lower() in self._tools else use

    def _is_local(self, file: str, use: ParameterUse) -> bool:
        """Return whether a call passes a tool or frame that only its file sees."""
        one = self._by_file[file]
        return lower_name(use.tool) in one.local_tools or lower_name(use.frame) in one.local_bases

    def frames_set_by(self, file: str) -> Iterator[str]:
        """Yield names of tools and frames that routines give a value which a file's calls pass."""
        for call, routine, _ in self._answered_calls(file):
            for name in routine.passed_values(call):
                if not name.startswith((OWN, PARAMETER)):
                    yield name.lower()

    def _answered_calls(self, file: str) -> Iterator[tuple[RoutineCall, RoutineTargets, str]]:
        """Yield the calls of a file, the routine that each means, and its file: the own one goes first."""
        for call in self._by_file[file].calls if self._getting else ():
            having = self._getting.get(call.routine, ())
            shown = [other for other in having if self._targets[other, call.routine].shown]
            for other in [file] if file in having else self._nearest(file, shown):
                yield call, self._targets[other, call.routine], other

    def _key(self, file: str, name: str) -> str:
        if name.startswith(OWN):
            return name
        return name.upper() if self._by_file[file].capitals else name.lower()


def _passed_uses(call: RoutineCall, routine: RoutineTargets) -> Iterator[tuple[str, ParameterUse]]:
    """Yield the names that a call passes, and how the routine goes there, or to a copy that the call passes."""
    for name, use in routine.passed_uses(call):
        if call.of_copy and not use.why:
            use = use._replace(why=COPIED if use.frame else OPEN_COPY)  # noqa: PLW2901
        yield name, use
