"""What the files of one robot say of each other's positions: declared in one, moved to in another.

A file that is read alone tells what it declares and what it does to names of others (`Said`). All files' sayings
together (`Across`) tell of each file how the others use its positions.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import PurePath
from typing import NamedTuple, Protocol, TypeAlias

from cellcal.drivers.programs.call_graph import Marks, reached
from cellcal.drivers.programs.declared_poses import DeclaredPoses, Poses
from cellcal.drivers.programs.positions import CARTESIAN, Positions, Remark

Routine: TypeAlias = tuple[str, str]  # its file and name
# By its name here: the module that declares a position, and its name there.
Imports: TypeAlias = Mapping[str, tuple[str, str]]
COPIED = "the program copies it, and only the copy is moved to"
_MANY_USES = 64
_DIFFERENT = "it is used with different tools or frames, in {}"
_OTHERWISE = "it was taught with another tool or frame than {} moves there with"
_COPY_OTHERWISE = "it was taught in another frame than {} sets where it moves to a copy of it"
_CALLED = "{} in {}, which its program calls, sets another tool or frame"
_CALLER = "{} in {} sets the tool or frame before its program is called, or may"
_UNGIVEN = "{} in {} calls a program that was not given, which may set another tool or frame"
_NOT_GIVEN = "~"  # what a program sets that was not given; behind all numbers and names
_UNUSED = "{} and {} more may be used by programs that were not given, with another tool or frame than is taken here."
_UNUSED_ALONE = (
    "{} may be used by a program that was not given, with another tool or frame than is taken here."
)


class Held(NamedTuple):
    """How a move goes to a position: its tool and frame, None where its file does not say."""

    tool: str | None
    frame: str | None
    why: str = ""  # why nobody can tell them; "" where nothing is in the way
    routine: str = ""  # whose callers and called routines may set others


@dataclass(frozen=True, slots=True)
class RoutineSaid:
    """What a routine that other files may call sets, and what it calls."""

    tools: frozenset[str] = frozenset()
    frames: frozenset[str] = frozenset()
    calls: frozenset[str] = frozenset()
    shown: bool = True  # other files may call it
    resets: bool = False  # it sets tool and frame to what the controller begins with


@dataclass(frozen=True, slots=True)
class Said:
    """What one file says that counts for others; all names in the language's one case."""

    module: str
    declares: Mapping[str, bool] = field(default_factory=dict)  # names, and whether other modules see them
    uses: Mapping[str, frozenset[Held]] = field(default_factory=dict)  # of names declared elsewhere
    routines: Mapping[str, RoutineSaid] = field(default_factory=dict)
    doubtful: Mapping[str, str] = field(
        default_factory=dict
    )  # tools and frames no point may be carried in, and why
    public: bool = False  # all that is declared here is seen everywhere
    tools: Poses = field(default_factory=dict)  # declared here for all
    bases: Poses = field(default_factory=dict)
    imports: Imports = field(default_factory=dict)  # for all files of its module
    flat: bool = False  # a call means a program of this folder, and one that is not there may set anything


class Reached(Protocol):
    """Of a file's routine: why its callers or called routines leave its tool or frame open, or ""."""

    def __call__(self, file: str, name: str, /, *, tool: bool = True, frame: bool = True) -> str:
        """Return the reason, of the tool or frame only where the other is not asked for."""
        ...


@dataclass(frozen=True, slots=True)
class Abroad:
    """What the files of a batch say of one of them."""

    uses: Mapping[str, Sequence[tuple[Held, str]]]  # by declared name; the file that uses it
    doubtful: Mapping[str, str]
    reached: Reached
    file: str
    visible: frozenset[str]  # names that programs not given may use, too
    tools: Poses  # what files declare for all; the nearest one's for each name
    bases: Poses

    def doubt(self, tool: str | None, frame: str | None) -> str:
        """Return why nothing is carried in a tool or frame, or ""."""
        return self.doubtful.get(_key(tool), "") or self.doubtful.get(_key(frame), "")

    def of(self, name: str) -> Sequence[tuple[Held, str]]:
        """Return the uses of a declared name, those of its whole array with those of an element."""
        bare = bare_of(name)
        some = self.uses.get(name, ())
        return some if bare == name else [*some, *self.uses.get(bare, ())]


class Across:
    """All sayings of a batch, each by its file; a folder's own module goes before one of the same name elsewhere."""

    def __init__(self, said: Mapping[str, Said]) -> None:
        self._said = said
        self._uses: dict[str, dict[str, list[tuple[Held, str]]]] = defaultdict(lambda: defaultdict(list))
        self._doubtful: dict[str, str] = {}
        self._shown: dict[str, list[str]] = defaultdict(list)  # by routine: the files that show it
        self._folders = {file: str(PurePath(file).parent) for file in said}
        self._names = [(file, name) for file, one in said.items() for name in one.routines]
        self._numbers = {routine: number for number, routine in enumerate(self._names)}
        self._marks: tuple[_Around, _Around] | None = None
        self._resets_below: list[Marks] = []  # by routine: those that it calls and that reset
        self._tools = DeclaredPoses({file: one.tools for file, one in said.items() if one.tools})
        self._bases = DeclaredPoses({file: one.bases for file, one in said.items() if one.bases})
        for file, one in said.items():
            if one.doubtful and not (one.flat and self._stands_alone(file, one)):
                self._doubtful |= one.doubtful
            for name, routine in one.routines.items():
                if routine.shown:
                    self._shown[name].append(file)
        self._give_uses()

    def of(self, file: str) -> Abroad | None:
        """Return what counts for a file; None for one that said nothing."""
        if file not in self._said:
            return None
        one = self._said[file]
        uses = {name: self._short(helds) for name, helds in self._uses.get(file, {}).items()}
        visible = frozenset(name for name, seen in one.declares.items() if seen or one.public)
        tools, bases = (every.seen_from(self._folders[file]) for every in (self._tools, self._bases))
        return Abroad(uses, self._doubtful, self._why_reached, file, visible, tools, bases)

    @cached_property
    def _called_in(self) -> Set[tuple[str, str]]:
        """Return the folders, and the routines that are called there."""
        return {
            (self._folders[file], name)
            for file, one in self._said.items()
            for routine in one.routines.values()
            for name in routine.calls
        }

    def _stands_alone(self, file: str, one: Said) -> bool:
        """Tell whether a program calls none and is called by none: a person runs it, to set up the cell."""
        folder = self._folders[file]
        return not any(
            routine.calls or (folder, name) in self._called_in for name, routine in one.routines.items()
        )

    def _short(self, helds: list[tuple[Held, str]]) -> list[tuple[Held, str]]:
        """Return of very many uses those that decide: an array has thousands, for each of its elements."""
        if len(helds) <= _MANY_USES:
            return helds
        whys: dict[str | None, tuple[Held, str]] = {}
        frames: dict[tuple[str, str], tuple[Held, str]] = {}
        for held, file in helds:
            why = held.why or self._why_reached(file, held.routine)
            if why:
                kept = (held._replace(why=why), file)
                if why != COPIED or len(whys) < _MANY_USES:
                    whys.setdefault(_key(held.frame) if why == COPIED else None, kept)
            elif len(frames) < _MANY_USES:
                frames.setdefault((_key(held.tool), _key(held.frame)), (held, file))
        return [*whys.values(), *frames.values()]

    def _give_uses(self) -> None:
        """Find for every name that is used whose declaration it means."""
        own, seen = self._declarations()
        for file, one in self._said.items():
            mine = self._nearest(file, [other for other in own[one.module] if other != file])
            imports = {
                name: there for each in (*mine, file) for name, there in self._said[each].imports.items()
            }
            for name, helds in one.uses.items():
                bare = bare_of(name)
                owners, there = self._declaring(bare, mine), bare
                if not owners:
                    module, there = imports.get(bare, ("", bare))
                    others = self._declaring(there, own[module]) if module else seen.get(bare, ())
                    owners = self._nearest(file, others)
                for owner in owners:
                    self._uses[owner][there + name[len(bare) :]] += [(held, file) for held in helds]

    def _declarations(self) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
        """Return by module the files that declare for it, and by name those that show it to other modules."""
        own: dict[str, list[str]] = defaultdict(list)
        seen: dict[str, list[str]] = defaultdict(list)
        for file, one in self._said.items():
            if one.declares or one.imports:
                own[one.module].append(file)
            for name, shown in one.declares.items():
                if shown or one.public:
                    seen[name].append(file)
        return own, seen

    def _declaring(self, name: str, files: Sequence[str]) -> list[str]:
        return [file for file in files if name in self._said[file].declares]

    def _why_reached(self, file: str, name: str, /, *, tool: bool = True, frame: bool = True) -> str:
        """Return why what a routine sets itself is not all: one that it calls, or a caller, sets more; or ""."""
        number = self._numbers.get((file, name)) if name else None
        if number is None:
            return ""
        own = self._said[file].routines[name]
        if self._marks is None:
            self._marks = self._reached()
        tools, frames = self._marks
        asked = [*([(tools, own.tools)] if tool else ()), *([(frames, own.frames)] if frame else ())]
        below = [(value, who) for (marks, _), has in asked for value, who in marks[number]
                 if value not in has and (has or value != _NOT_GIVEN)]  # fmt: skip
        if any(has for _, has in asked):
            below += self._resets_below[number]
        if below:
            value, who = below[0]
            return self._named(_UNGIVEN if value == _NOT_GIVEN else _CALLED, who)
        above = [who for (_, marks), has in asked if not has for value, who in marks[number]
                 if value != _NOT_GIVEN]  # fmt: skip
        return self._named(_CALLER, above[0]) if above else ""

    def _reached(self) -> "tuple[_Around, _Around]":
        routines = [self._said[file].routines[name] for file, name in self._numbers]
        calls = [
            [self._numbers[called] for name in sorted(one.calls) for called in self._called(file, name)]
            for (file, _), one in zip(self._numbers, routines, strict=True)
        ]
        more = [
            frozenset([_NOT_GIVEN]) if self._lacks_some(file, one) else frozenset[str]()
            for (file, _), one in zip(self._numbers, routines, strict=True)
        ]
        resets, _ = reached(calls, [frozenset([""]) if one.resets else frozenset() for one in routines])
        self._resets_below = [tuple(mark for called in some for mark in resets[called]) for some in calls]
        return (
            reached(calls, [one.tools | its for one, its in zip(routines, more, strict=True)]),
            reached(calls, [one.frames | its for one, its in zip(routines, more, strict=True)]),
        )

    def _lacks_some(self, file: str, routine: RoutineSaid) -> bool:
        return self._said[file].flat and not all(self._called(file, name) for name in routine.calls)

    def _called(self, file: str, name: str) -> list[Routine]:
        if name in self._said[file].routines:
            return [(file, name)]
        others = self._shown.get(name, ())
        if self._said[file].flat:
            return [(other, name) for other in others if self._folders[other] == self._folders[file]]
        return [(other, name) for other in self._nearest(file, others)]

    def _named(self, text: str, number: int) -> str:
        file, name = self._names[number]
        return text.format(name, PurePath(file).name)

    def _nearest(self, file: str, others: Sequence[str]) -> list[str]:
        """Return those beside a file, or all where none is."""
        folder = self._folders[file]
        return [other for other in others if self._folders[other] == folder] or list(others)


_Around: TypeAlias = tuple[list[Marks], list[Marks]]  # by routine: of those it calls, and around it


def settled(
    positions: Positions,
    abroad: Abroad,
    keys: Sequence[str],
    *,
    used: Set[int],
    taught: Set[int],
    routines: Mapping[int, str],
) -> tuple[Positions, tuple[Remark, ...]]:
    """Return a file's positions with what other files say of them, and what must be told of the others.

    ``keys`` names every row as other files do; rows ``used`` are moved to in this file, in ``routines`` where their
    tool or frame depends on it; rows ``taught`` hold their own tool and frame.
    """
    tools, frames, barred = list(positions.tools), list(positions.user_frames), dict(positions.barred)
    unused: list[int] = []
    for row, kind in enumerate(positions.kinds):
        if kind != CARTESIAN or row in barred:
            continue
        helds = abroad.of(keys[row])
        why = ""
        if row in taught:
            why = _taught_otherwise(Held(tools[row], frames[row]), helds, abroad)
        elif helds:
            own = [(Held(tools[row], frames[row], routine=routines.get(row, "")), abroad.file)]
            tools[row], frames[row], why = _together([*(own if row in used else ()), *helds], abroad)
        elif row in used:
            why = abroad.reached(abroad.file, routines.get(row, ""))
        elif bare_of(keys[row]) in abroad.visible:
            unused.append(row)
        if why := why or abroad.doubt(tools[row], frames[row]):
            barred[row] = why
    remarks = _of_unused(positions, unused)
    return replace(positions, tools=tuple(tools), user_frames=tuple(frames), barred=barred), remarks


def _of_unused(positions: Positions, unused: Sequence[int]) -> tuple[Remark, ...]:
    if not unused:
        return ()
    first = positions.names[unused[0]]
    text = _UNUSED.format(first, len(unused) - 1) if len(unused) > 1 else _UNUSED_ALONE.format(first)
    return (Remark(int(positions.lines[unused[0]]), "indirect", text),)


def _taught_otherwise(taught: Held, helds: Sequence[tuple[Held, str]], abroad: Abroad) -> str:
    """Return why a position is left that holds a tool and frame, and is moved to with others; or ""."""
    copied = [(held, file) for held, file in helds if held.why == COPIED]
    helds = [(held, file) for held, file in helds if held.why != COPIED]
    tool, frame, why = _together(helds, abroad) if helds else (None, None, "")
    if why:
        return why
    if (tool or taught.tool, frame or taught.frame) != (taught.tool, taught.frame):
        return _OTHERWISE.format(PurePath(helds[0][1]).name)
    others = (file for held, file in copied if held.frame and _key(held.frame) != _key(taught.frame))
    other = next(others, None)
    return "" if other is None else _COPY_OTHERWISE.format(PurePath(other).name)


def _together(helds: Sequence[tuple[Held, str]], abroad: Abroad) -> tuple[str | None, str | None, str]:
    """Return the tool and frame that all uses of a position agree on, or why they do not."""
    some = [(held, file) for held, file in helds if held.why != COPIED]
    if not some:
        return None, None, COPIED
    whys = (held.why or abroad.reached(file, held.routine) for held, file in some)
    why = next(filter(None, whys), "")
    if len({(_key(held.tool), _key(held.frame)) for held, _ in some}) > 1:
        files = sorted({PurePath(file).name for _, file in some if file})
        why = why or _DIFFERENT.format(", ".join(files[:3]) + (" and others" if len(files) > 3 else ""))
    held = some[0][0]
    return (None, None, why) if why else (held.tool, held.frame, "")


def _key(name: str | None) -> str:
    return "" if name is None else name.lower()


def bare_of(name: str) -> str:
    """Return an array's name for an element of it."""
    return name.partition("[")[0].partition("{")[0]
