"""What the files of one robot say of each other's positions: declared in one, moved to in another.

A file that is read alone gives what it declares and how it uses names of others (`FileDeclarations`). Those of all
files together (`BatchDeclarations`) give for each file how the others use its positions (`ExternalUses`).
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import cached_property

from cellcal.drivers.programs.barred import COMPUTED, MOVED_FRAMES, PASSED_TO_NOT_GIVEN, SEEN_FROM_FLANGE
from cellcal.drivers.programs.batch_calls import BatchCalls
from cellcal.drivers.programs.controller_tasks import ControllerTask, find_task, other_moving_task
from cellcal.drivers.programs.declared_poses import DeclaredPoses
from cellcal.drivers.programs.file_declarations import (
    COPIED,
    NO_MOTION,
    OPEN_COPY,
    VALUES_GIVEN,
    BatchReasons,
    ExternalUses,
    FileDeclarations,
    Imports,
    MoveFrames,
    array_name_of,
    lower_name,
)
from cellcal.drivers.programs.local_frames import LocalFrames
from cellcal.drivers.programs.passed_places import PassedPlaces
from cellcal.drivers.programs.routine_calls import OWN

_MANY_USES = 64
_LIFTED = MOVED_FRAMES | {SEEN_FROM_FLANGE}  # what a project may lift; any other reason goes before


class BatchDeclarations:
    """The declarations of a batch, each by its file; a folder's module goes before one of its name elsewhere."""

    def __init__(self, declarations: Mapping[str, FileDeclarations]) -> None:
        self._by_file = declarations
        self._calls = BatchCalls(declarations)
        self._uses: dict[str, dict[str, list[tuple[MoveFrames, str]]]] = defaultdict(
            lambda: defaultdict(list)
        )
        self._absent: dict[str, dict[str, frozenset[MoveFrames]]] = defaultdict(dict)  # by file and name
        self._doubtful = BatchReasons()
        self._frames_set = frozenset[str]()  # tools and frames that routines set, or may set, which get them
        self._found_declarations: dict[tuple[str, str], tuple[Sequence[str], str]] = {}
        self._own: dict[str, tuple[list[str], Imports]] = {}  # by file: those of its module, their imports
        self._tools = DeclaredPoses({file: one.tools for file, one in declarations.items() if one.tools})
        self._bases = DeclaredPoses({file: one.bases for file, one in declarations.items() if one.bases})
        self._local = LocalFrames(declarations)
        self._other_data = frozenset[str]().union(*(one.other_data for one in declarations.values()))
        for file, one in declarations.items():
            is_standalone = one.flat and bool(one.doubtful) and self._calls.is_standalone(file)
            if is_standalone:
                self._doubtful |= one.made_alone
            elif one.doubtful:
                self._doubtful |= {
                    name: why
                    for name, why in one.doubtful.items()
                    if why not in _LIFTED or name not in self._doubtful
                }
        self._give_uses()

    def uses_of_file(self, file: str) -> ExternalUses | None:
        """Return what counts for a file; None for one without declarations."""
        if file not in self._by_file:
            return None
        one = self._by_file[file]
        uses = {name: self._deciding_uses(move_uses) for name, move_uses in self._uses.get(file, {}).items()}
        visible = frozenset(name for name, is_visible in one.declares.items() if is_visible or one.public)
        folder = self._calls.folder_of(file)
        tools, bases = (every.poses_visible_from(folder) for every in (self._tools, self._bases))
        tools, bases = self._local.with_local(file, tools, bases)
        computed, program_names = self._calls.computed_beside(file) if one.flat else ({}, frozenset[str]())
        open_calls, running = self._calls.open_beside(file) if one.flat else ({}, {})
        tools_left, frames_left = self._calls.numbers_left(file)
        tools_before, frames_before = (
            self._calls.numbers_before(file) if one.flat else (frozenset(), frozenset())
        )
        beside = self._calls.numbers_beside(file) if one.flat else (frozenset[str](), frozenset[str]())
        return ExternalUses(
            uses,
            self._doubtful,
            self._calls.why_reached,
            self.find_declarations,
            file,
            visible,
            tools,
            bases,
            frames_set=self._frames_set,
            absent=self._absent.get(file, {}),
            computed=computed,
            given=program_names,
            open_calls=open_calls,
            frames_left=frames_left if one.flat else {},
            tools_left=tools_left if one.flat else {},
            surely_left=self._calls.surely_left(file) if one.flat else {},
            frames_before=frames_before,
            tools_before=tools_before,
            frames_beside=beside[1],
            tools_beside=beside[0],
            computed_beside=self._calls.places_beside(file) if one.flat else frozenset(),
            running=running,
            calls_itself=one.flat and self._calls.calls_itself(file),
            external_tool=self._calls.external_tool_around(file),
            other_task=other_moving_task(file, self._moving_tasks),
        )

    def find_declarations(self, file: str, name: str, /) -> tuple[Sequence[str], str]:
        """Return the files whose declaration a name means in a file, and its name there."""
        if (file, name) not in self._found_declarations:
            own, visible = self._declaring_files
            mine, imports = self._own_files(file)
            owners, there = self._files_declaring(name, mine), name
            if not owners:
                module, there = imports.get(name, ("", name))
                others = self._files_declaring(there, own[module]) if module else visible.get(name, ())
                owners = self._calls.nearest_files(file, others)
            self._found_declarations[file, name] = (owners, there)
        return self._found_declarations[file, name]

    @cached_property
    def _moving_tasks(self) -> frozenset[ControllerTask]:
        tasks = [find_task(file) for file, one in self._by_file.items() if one.moves]
        return frozenset(task for task in tasks if task is not None)

    def _deciding_uses(self, uses: list[tuple[MoveFrames, str]]) -> list[tuple[MoveFrames, str]]:
        """Return of very many uses those that decide: an array has thousands, for each of its elements."""
        if len(uses) <= _MANY_USES:
            return uses
        reasons: dict[str | None, tuple[MoveFrames, str]] = {}
        frames: dict[tuple[str, str], tuple[MoveFrames, str]] = {}
        for move_frames, file in uses:
            why = move_frames.why or self._calls.why_reached(file, move_frames.routine)
            if why:
                decisive = (move_frames._replace(why=why), file)
                if why != COPIED or len(reasons) < _MANY_USES:
                    reasons.setdefault(lower_name(move_frames.frame) if why == COPIED else None, decisive)
            elif len(frames) < _MANY_USES:
                frames.setdefault(
                    (lower_name(move_frames.tool), lower_name(move_frames.frame)), (move_frames, file)
                )
        return [*reasons.values(), *frames.values()]

    def _give_uses(self) -> None:
        """Find for every name that is used whose declaration it means."""
        passed = PassedPlaces(self._by_file, self._calls.nearest_files)
        for file, one in self._by_file.items():
            for name, frames_of_moves in one.uses.items():
                self._give_use(file, name, [(each, file) for each in frames_of_moves])
            self._give_passed_uses(file, passed)
            its = frozenset(passed.frames_set_by(file))
            self._doubtful |= dict.fromkeys(its, COMPUTED)
            self._frames_set |= its
        passed_out = {name for file in self._by_file for name in passed.frames_open_to(file)}
        self._frames_set |= passed_out
        for name in passed_out:
            if self._doubtful.get(name) in (None, *_LIFTED):
                self._doubtful[name] = PASSED_TO_NOT_GIVEN
        if any(one.copies for one in self._by_file.values()):
            self._give_uses_of_copies()

    def _give_passed_uses(self, file: str, passed: PassedPlaces) -> None:
        """Give what routines do to the places that a file's calls pass."""
        for name, move_frames, there in passed.uses_by(file):
            if name.startswith(OWN):
                self._add_uses(file, name.removeprefix(OWN), [(move_frames, there)])
            else:
                self._give_use(file, name, [(move_frames, there)])
        for name, use in passed.uses_stated_by(file):
            if name.startswith(OWN):
                self._add_uses(file, name.removeprefix(OWN), [(use, file)])
                continue
            for owner in self.find_declarations(file, array_name_of(name))[0]:
                self._add_uses(owner, name, [(use, file)])

    def _give_uses_of_copies(self) -> None:
        """Give the moves to copies that several files see to what they are copies of."""
        arrays: dict[tuple[str, str], list[tuple[MoveFrames, str]]] = defaultdict(list)
        for owner, its_uses in self._uses.items():
            for name, some in its_uses.items():
                arrays[owner, array_name_of(name)] += some
        for file, one in self._by_file.items():
            for name, own in one.own_uses.items():
                arrays[file, name] += [(use, file) for use in own]
        deciding = {array: self._deciding_uses(some) for array, some in arrays.items()}
        for file, one in self._by_file.items():
            for name, copy in one.copies:
                self._give_copied_uses(file, name, array_name_of(copy), deciding)

    def _give_copied_uses(
        self,
        file: str,
        name: str,
        copy: str,
        arrays: Mapping[tuple[str, str], Sequence[tuple[MoveFrames, str]]],
    ) -> None:
        """Give the uses that other files make of a copy to the position that it is made of."""
        owners, there = self.find_declarations(file, copy)
        for owner in owners:
            uses = [
                (use._replace(why=use.why or (COPIED if use.frame else OPEN_COPY)), by)
                for use, by in arrays.get((owner, there), ())
                if use.why not in VALUES_GIVEN and by != file
            ]
            if name.startswith(OWN):
                self._add_uses(file, name.removeprefix(OWN), uses)
            elif uses:
                self._give_use(file, name, uses)

    def _give_use(self, file: str, name: str, uses: list[tuple[MoveFrames, str]]) -> None:
        """Give uses of a name that a file sees to whose declaration it means."""
        bare = array_name_of(name)
        owners, declared = self.find_declarations(file, bare)
        motion_uses = frozenset(each for each, _ in uses if each.why not in NO_MOTION)
        if not owners and motion_uses and bare not in self._other_data:
            self._absent[file][name] = self._absent[file].get(name, frozenset()) | motion_uses
        for owner in owners:
            self._add_uses(owner, declared + name[len(bare) :], uses)

    def _add_uses(self, owner: str, name: str, uses: list[tuple[MoveFrames, str]]) -> None:
        self._uses[owner][name] += [
            (self._local.seen_from(owner, self._settle_open_copy(each, file), file), file)
            for each, file in uses
        ]

    def _settle_open_copy(self, use: MoveFrames, file: str) -> MoveFrames:
        """Return a move to a copy with why the position is left, where callers of its routine set a frame."""
        if use.why != OPEN_COPY:
            return use
        return use._replace(why=self._calls.why_reached(file, use.routine) or COPIED)

    def _own_files(self, file: str) -> tuple[list[str], Imports]:
        """Return the other files that declare for a file's module, and what all of them import."""
        if file not in self._own:
            own, _ = self._declaring_files
            mine = self._calls.nearest_files(
                file, [each for each in own[self._by_file[file].module] if each != file]
            )
            imports = {
                name: there for each in (*mine, file) for name, there in self._by_file[each].imports.items()
            }
            self._own[file] = mine, imports
        return self._own[file]

    @cached_property
    def _declaring_files(self) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
        """Return by module the files that declare for it, and by name those that show it to other modules."""
        own: dict[str, list[str]] = defaultdict(list)
        visible: dict[str, list[str]] = defaultdict(list)
        for file, one in self._by_file.items():
            if one.declares or one.imports:
                own[one.module].append(file)
            for name, shown in one.declares.items():
                if shown or one.public:
                    visible[name].append(file)
        return own, visible

    def _files_declaring(self, name: str, files: Sequence[str]) -> list[str]:
        return [file for file in files if name in self._by_file[file].declares]
