"""What the routines of a batch do to each other by their calls: tools and frames set, calls of what is missing."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence, Set
from functools import cached_property, partial
from pathlib import PurePath
from typing import TypeAlias

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.call_graph import (
    Marks,
    find_recursive_routines,
    reached_missing,
    reached_settings,
    with_interrupts,
)
from cellcal.drivers.programs.file_declarations import (
    CALLED_LAST,
    NOT_CERTAIN,
    FileDeclarations,
    RoutineEffects,
)
from cellcal.drivers.programs.routines_beside import NOT_GIVEN, RoutinesBeside

Routine: TypeAlias = tuple[str, str]  # its file and name
_CALLED = "{} in {}, which its program calls, sets another tool or frame"
_CALLER = "{} in {} sets the tool or frame before its program is called, or may"
_MISSING_PROGRAM = "{} in {} calls a program that was not given, which may set another tool or frame"
_DEEPEST = 50  # calls that are followed for what is left behind them


class BatchCalls:
    """The calls between the routines of a batch, whose declarations are each by its file."""

    def __init__(self, declarations: Mapping[str, FileDeclarations]) -> None:
        self._by_file = declarations
        self._folders = {file: str(PurePath(file).parent) for file in declarations}
        self._names = [(file, name) for file, one in declarations.items() for name in one.routines]
        self._numbers = {routine: number for number, routine in enumerate(self._names)}
        self._left: dict[tuple[int, int], str | None] = {}  # by routine, and 0 for the tool, 1 for the frame
        self._shown: dict[str, list[str]] = defaultdict(list)  # by routine: the files that show it
        for file, one in declarations.items():
            for name, routine in one.routines.items():
                if routine.shown:
                    self._shown[name].append(file)

    def folder_of(self, file: str) -> str:
        """Return where a file stands."""
        return self._folders[file]

    def nearest_files(self, file: str, others: Sequence[str]) -> list[str]:
        """Return those beside a file, or all where none is."""
        folder = self._folders[file]
        return [other for other in others if self._folders[other] == folder] or list(others)

    def why_reached(self, file: str, name: str, /, *, tool: bool = True, frame: bool = True) -> str:
        """Return why what a routine sets itself is not all: one that it calls, or a caller, sets more; or ""."""
        number = self._numbers.get((file, name)) if name else None
        if number is None:
            return ""
        own = self._by_file[file].routines[name]
        which = [*([0] if tool else ()), *([1] if frame else ())]
        effects = [(self._effects_around[each], (own.tools, own.frames)[each]) for each in which]
        below = [(value, subject) for (marks, _), has in effects for value, subject in marks[number]
                 if value not in has and (has or value != NOT_GIVEN)]  # fmt: skip
        if any(has for _, has in effects):
            below += self._resets_below[number]
            for each, (_, has) in zip(which, effects, strict=True):
                below += self._beside.marks_in(self._folders[file], each, has)
        if below:
            value, subject = below[0]
            return self._name_text(_MISSING_PROGRAM if value == NOT_GIVEN else _CALLED, subject)
        above = [subject for (_, marks), has in effects if not has for value, subject in marks[number]
                 if value != NOT_GIVEN]  # fmt: skip
        sets_all = all(has for _, has in effects)
        if not above and not own.resets and not sets_all:
            above = [subject for _, subject in self._resets_around[1][number]]
        return self._name_text(_CALLER, above[0]) if above else ""

    @cached_property
    def _beside(self) -> RoutinesBeside:
        routines = [self._by_file[file].routines[name] for file, name in self._names]
        found = RoutinesBeside(self._calls, [below for below, _ in self._effects_around], routines)
        for number, (file, _) in enumerate(self._names):
            found.take_routine(number, self._folders[file], partial(self._numbers_of, file))
        return found

    def _numbers_of(self, file: str, name: str) -> list[int]:
        return self._numbers_called(file, [name])

    @cached_property
    def _calls(self) -> Sequence[Collection[int]]:
        """Return by routine the numbers of those that it calls, and of interrupts that may run while it does."""
        routines = [(file, self._by_file[file].routines[own]) for file, own in self._names]
        calls, here, shown = (
            [self._numbers_called(file, sorted(names)) for file, names in some]
            for some in (
                [(file, one.calls.union(*one.likely_calls)) for file, one in routines],
                [(file, one.handlers) for file, one in routines],
                [(file, one.shown_handlers) for file, one in routines],
            )
        )
        return with_interrupts(calls, here, shown)[0] if any(here) or any(shown) else calls

    @cached_property
    def _circles(self) -> list[bool]:
        return find_recursive_routines(self._calls)

    def calls_itself(self, file: str) -> bool:
        """Return whether a routine of a file may be called again while it runs."""
        return any(self._circles[self._numbers[file, name]] for name in self._by_file[file].routines)

    def external_tool_around(self, file: str) -> str:
        """Return a routine of another file that lets moves of a file work with a tool in the cell; "" for none.

        One around the file counts where not each routine of it that others see says that the robot holds the tool. A
        data list is moved to by the program of its name.
        """
        below, above = self._external_tools
        if not any(below):  # as nearly always
            return ""
        stem = PurePath(file).with_suffix("")
        own = [each for each in self._names if PurePath(each[0]).with_suffix("") == stem]
        seen = [one for each, name in own if (one := self._by_file[each].routines[name]).shown]
        says_itself = bool(seen) and all(one.held_tool for one in seen)
        numbers = [self._numbers[each] for each in own]
        marks = [
            mark for number in numbers for mark in (*below[number], *(() if says_itself else above[number]))
        ]
        subjects = {subject for _, subject in marks}.difference(numbers)
        return self._names[min(subjects)][1] if subjects else ""

    @cached_property
    def _external_tools(self) -> "_Around":
        routines = [self._by_file[file].routines[name] for file, name in self._names]
        own = [frozenset([""]) if one.external_tool else frozenset() for one in routines]
        return reached_settings(self._calls, own)

    def _numbers_called(self, file: str, names: Iterable[str]) -> list[int]:
        return [self._numbers[called] for name in names for called in self._called_routines(file, name)]

    @cached_property
    def _resets_below(self) -> list[Marks]:
        """Return by routine those that it calls and that reset."""
        resets = self._resets_around[0]
        return [tuple(mark for called in some for mark in resets[called]) for some in self._calls]

    @cached_property
    def _resets_around(self) -> "_Around":
        """Return by routine those that reset: it and those that it calls, and those around it."""
        routines = [self._by_file[file].routines[name] for file, name in self._names]
        return reached_settings(
            self._calls, [frozenset([""]) if one.resets else frozenset() for one in routines]
        )

    @cached_property
    def _effects_around(self) -> "tuple[_Around, _Around]":
        """Return what is set below and around each routine: the tools, and the frames."""
        routines = [self._by_file[file].routines[name] for file, name in self._numbers]
        more = [
            frozenset([NOT_GIVEN]) if self._has_missing_calls(file, one) else frozenset[str]()
            for (file, _), one in zip(self._numbers, routines, strict=True)
        ]
        return (
            self._settings_around([one.tools | its for one, its in zip(routines, more, strict=True)]),
            self._settings_around([one.frames | its for one, its in zip(routines, more, strict=True)]),
        )

    def _settings_around(self, own: Sequence[Iterable[str]]) -> "_Around":
        """Return what is set below routines, and around them: also by those whose calls may mean them."""
        below, above = reached_settings(self._calls, own)
        if self._open_calls:
            hubs = {folder: len(own) + number for number, folder in enumerate(self._open_calls)}
            calls = [
                [
                    *called,
                    *({hubs[folder]} if self._calls_any(file, self._by_file[file].routines[name]) else ()),
                ]
                for called, (file, name) in zip(self._calls, self._names, strict=True)
                for folder in [self._folders[file]]
            ]
            unnamed = [
                [self._numbers[each] for each in self._names if self._is_unnamed(folder, *each)]
                for folder in hubs
            ]
            _, above = reached_settings([*calls, *unnamed], [*own, *([()] * len(hubs))])
        return below, above[: len(own)]

    def _is_unnamed(self, folder: str, file: str, name: str) -> bool:
        return self._folders[file] == folder and (folder, name) not in self._called_in

    def _calls_any(self, file: str, routine: RoutineEffects) -> bool:
        """Return whether it calls what no file tells, under a name that no routine beside it has."""
        return any(not self._numbers_called(file, names) for names in routine.likely_calls)

    @cached_property
    def _open_calls(self) -> dict[str, bool]:
        """Return the folders in which a call may mean any routine, and whether also one that is no macro."""
        found: dict[str, bool] = {}
        for file, one in self._by_file.items():
            for routine in one.routines.values():
                if self._calls_any(file, routine):
                    folder = self._folders[file]
                    found[folder] = found.get(folder, False) or frozenset() in routine.likely_calls
        return found

    def _has_missing_calls(self, file: str, routine: RoutineEffects) -> bool:
        return self._by_file[file].flat and not all(
            self._called_routines(file, name) for name in routine.calls
        )

    def _called_routines(self, file: str, name: str) -> list[Routine]:
        if name in self._by_file[file].routines:
            return [(file, name)]
        others = self._shown.get(name, ())
        if self._by_file[file].flat:
            return [(other, name) for other in others if self._folders[other] == self._folders[file]]
        return [(other, name) for other in self.nearest_files(file, others)]

    def _name_text(self, text: str, number: int) -> str:
        file, name = self._names[number]
        return make_message(text, name, PurePath(file).name)

    def computed_beside(self, file: str) -> tuple[dict[str, str], frozenset[str]]:
        """Return the global places that other files of a folder compute, and the names of its routines."""
        computing, program_names = self._flat_folders
        folder = self._folders[file]
        computed = {
            place: next(other for other in others if other != file)
            for place, others in computing.get(folder, {}).items()
            if others != [file]
        }
        return computed, frozenset(program_names.get(folder, ()))

    @cached_property
    def _flat_folders(self) -> tuple[dict[str, dict[str, list[str]]], dict[str, set[str]]]:
        """Return by folder the files that compute each global place, and the names of the routines."""
        computing: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
        program_names: dict[str, set[str]] = defaultdict(set)
        for file, one in self._by_file.items():
            for name, routine in one.routines.items() if one.flat else ():
                program_names[self._folders[file]].add(name)
                for place in routine.computes:
                    computing[self._folders[file]][place].append(file)
        return computing, program_names

    def numbers_left(self, file: str) -> "tuple[_NumbersOfRoutines, _NumbersOfRoutines]":
        """Return by routine beside a file the tools that it, or one that it calls, chooses, and the frames."""
        tools, frames = (numbers.get(self._folders[file], {}) for numbers in self._numbers_left)
        return tools, frames

    @cached_property
    def _numbers_left(self) -> "tuple[_NumbersLeft, _NumbersLeft]":
        """Return by folder and routine the tools that it, or a routine that it calls, chooses, and the frames."""
        found: tuple[_NumbersLeft, _NumbersLeft] = (defaultdict(dict), defaultdict(dict))
        for number, (file, name) in enumerate(self._names):
            routine = self._by_file[file].routines[name]
            lefts = (routine.tool_left, routine.frame_left)
            for some, (below, _), left in zip(found, self._effects_around, lefts, strict=True):
                chosen = {value for value, _ in below[number] if value != NOT_GIVEN}
                open_ = left is None or CALLED_LAST in left
                numbers = frozenset(chosen if open_ or left is None else {left} - {""})
                if self._by_file[file].flat and numbers:
                    some[self._folders[file]][name] = numbers
        return found

    def surely_left(self, file: str) -> Mapping[str, tuple[str | None, str | None]]:
        """Return by routine beside a file the tool and the frame in force behind it, as `RoutineEffects` says them.

        One that neither chooses any nor calls others leaves what it began with, too.
        """
        return self._surely_left.get(self._folders[file], {})

    @cached_property
    def _surely_left(self) -> dict[str, dict[str, tuple[str | None, str | None]]]:
        found: dict[str, dict[str, tuple[str | None, str | None]]] = defaultdict(dict)
        for number, (file, name) in enumerate(self._names):
            if not self._by_file[file].flat:
                continue
            tool, frame = (self._left_by(number, which) for which in range(2))
            if tool is not None or frame is not None:
                found[self._folders[file]][name] = tool, frame
        return found

    def _left_by(self, number: int, which: int, depth: int = 0) -> str | None:
        """Return the tool (0) or frame (1) that is surely in force behind a routine, "" for the one before it."""
        file, name = self._names[number]
        routine = self._by_file[file].routines[name]
        left = (routine.tool_left, routine.frame_left)[which]
        if routine.beside:
            return None
        if left is None or CALLED_LAST not in left:
            below = self._effects_around[which][0][number]
            return "" if left is None and not below and not routine.likely_calls else left
        if (number, which) not in self._left:
            self._left[number, which] = None  # also while it is looked for: it may call itself
            self._left[number, which] = self._left_by_called(file, left.split(CALLED_LAST), (which, depth))
        return self._left[number, which]

    def _left_by_called(self, file: str, names: list[str], at: tuple[int, int]) -> str | None:
        """Return what the first of some routines leaves that leaves its own; the last entry where none does."""
        which, depth = at
        *called, own = names
        for each in called if depth < _DEEPEST else ():
            others = self._called_routines(file, each)
            behind = self._left_by(self._numbers[others[0]], which, depth + 1) if len(others) == 1 else None
            if behind != "":
                return behind
        return None if own == NOT_CERTAIN or depth >= _DEEPEST else own

    def numbers_beside(self, file: str) -> tuple[frozenset[str], frozenset[str]]:
        """Return the tools that routines beside all others in a file's folder choose at any time, and the frames."""
        tools, frames = (
            self._beside.marks_in(self._folders[file], which, frozenset([NOT_GIVEN])) for which in range(2)
        )
        return frozenset(value for value, _ in tools), frozenset(value for value, _ in frames)

    def places_beside(self, file: str) -> frozenset[str]:
        """Return the global places that such routines compute."""
        return self._beside.places_in(self._folders[file])

    def numbers_before(self, file: str) -> tuple[frozenset[str], frozenset[str]]:
        """Return the tools that callers of a file's routines, and what these call, choose, and the frames."""
        numbers = [self._numbers[file, name] for name in self._by_file[file].routines]
        tools, frames = (
            frozenset(value for number in numbers for value, _ in above[number] if value != NOT_GIVEN)
            for _, above in self._effects_around
        )
        return tools, frames

    def open_beside(self, file: str) -> tuple[Mapping[str, str], dict[str, str]]:
        """Return which routines of a folder reach one that was not given, and which of those run beside all."""
        reaching, running = self._open_folders
        folder = self._folders[file]
        started = running.get(folder, {})
        return reaching.get(folder, {}), {name: by for name, by in started.items() if by != file}

    @cached_property
    def _open_folders(self) -> tuple[dict[str, dict[str, str]], dict[str, dict[str, str]]]:
        """Return by folder: by routine one not given that it reaches; and those not given that run beside all."""
        program_names = self._flat_folders[1]
        by_folder: dict[str, list[tuple[str, str, RoutineEffects]]] = defaultdict(list)
        for file, one in self._by_file.items():
            if one.flat:
                by_folder[self._folders[file]] += [(file, *each) for each in one.routines.items()]
        reaching = {
            folder: reached_missing(
                {
                    name: one.calls | (frozenset().union(*one.likely_calls) & program_names[folder])
                    for _, name, one in some
                },
                program_names[folder],
            )
            for folder, some in by_folder.items()
        }
        running: dict[str, dict[str, str]] = {}
        for folder, some in by_folder.items():
            reached = reaching[folder]
            running[folder] = {
                reached.get(started, started): file
                for file, _, one in some
                for started in one.beside
                if started in reached or started not in program_names[folder]
            }
        return reaching, running

    @cached_property
    def _called_in(self) -> Set[tuple[str, str]]:
        """Return the folders, and the routines that are called there."""
        return {
            (self._folders[file], name)
            for file, one in self._by_file.items()
            for routine in one.routines.values()
            for name in routine.calls.union(*routine.likely_calls)
        }

    def is_standalone(self, file: str) -> bool:
        """Return whether a program calls none and is called by none: a person runs it, to set up the cell.

        A macro, or where a register names what is called any program, may be called where no file says so.
        """
        folder = self._folders[file]
        in_macros, anywhere = folder in self._open_calls, self._open_calls.get(folder, False)
        return not any(
            anywhere or routine.calls or (folder, name) in self._called_in or (in_macros and routine.by_macro)
            for name, routine in self._by_file[file].routines.items()
        )


_NumbersOfRoutines: TypeAlias = dict[str, frozenset[str]]
_NumbersLeft: TypeAlias = dict[str, _NumbersOfRoutines]
_Around: TypeAlias = tuple[list[Marks], list[Marks]]  # by routine: of those it calls, and around it
