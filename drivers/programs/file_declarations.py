"""What a file of a robot's programs declares and does that counts for the other files of its batch."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

from cellcal.drivers.programs.barred import COMPUTED, OVERWRITTEN
from cellcal.drivers.programs.declared_poses import Poses
from cellcal.drivers.programs.routine_calls import UNCERTAIN, RoutineCall, RoutineTargets

# By its name here: the module that declares a position, and its name there.
Imports: TypeAlias = Mapping[str, tuple[str, str]]
Derived = TypeVar("Derived")
COPIED = "the program copies it, and only the copy is moved to"
COMPONENT_SET = "the program sets a component of it while it runs"
VALUES_GIVEN = frozenset((OVERWRITTEN, COMPONENT_SET))
OPEN_COPY = "the program moves to a copy of it, in the frame that holds where its routine is called"
CALLED_LAST, NOT_CERTAIN = ">", "?"  # in `RoutineEffects.frame_left`
NO_MOTION = VALUES_GIVEN | {COPIED, OPEN_COPY}  # what is done to a position without going there


class MoveFrames(NamedTuple):
    """The tool and frame of a move to a position, None where its file does not say."""

    tool: str | None
    frame: str | None
    why: str = ""  # why they cannot be determined; "" where they can
    routine: str = ""  # whose callers and called routines may set others


@dataclass(frozen=True, slots=True)
class RoutineEffects:
    """The variables that a routine sets which other files may call, and the routines that it calls."""

    tools: frozenset[str] = frozenset()
    frames: frozenset[str] = frozenset()
    calls: frozenset[str] = frozenset()
    shown: bool = True  # other files may call it
    resets: bool = False  # it sets tool and frame to what the controller begins with
    handlers: frozenset[str] = frozenset()  # routines that interrupt it and those that it calls
    shown_handlers: frozenset[str] = frozenset()  # routines that interrupt its callers, too
    computes: frozenset[str] = frozenset()  # global places that it computes, as the brand names them
    # Chosen when it ends, "" for the one that it began with; None: not certain. Before it, each with CALLED_LAST, the
    # routines that are called behind it, the last first: each leaves its own, or what it began with.
    frame_left: str | None = None
    tool_left: str | None = None  # the same of the tool
    beside: frozenset[str] = frozenset()  # routines of its calls that go on while it and its callers run
    likely_calls: frozenset[frozenset[str]] = (
        frozenset()
    )  # of each call whose routine no file tells: the names that it may have, none for any name
    by_macro: bool = False  # the controller's table of macros has it
    external_tool: bool = False  # it lets moves work with a tool that stands in the cell
    held_tool: bool = False  # it surely lets all its moves work with the tool that the robot holds


class BatchReasons(dict[str, str]):
    """Reasons by name, of all files of a batch; what a brand derives from them is derived once."""

    @cached_property
    def _rests(self) -> dict[str, list[str]]:
        rests: dict[str, list[str]] = defaultdict(list)
        for name in self:
            at = name.find(" ")
            while at >= 0:
                rests[name[: at + 1]].append(name[at + 1 :])
                at = name.find(" ", at + 1)
        return dict(rests)

    @cached_property
    def _derived(self) -> dict[str, Any]:
        return {}

    def rests_behind(self, words: str) -> Sequence[str]:
        """Return what stands in the names behind words with which they begin, and a space."""
        return self._rests.get(f"{words} ", ())

    def derive_once(self, what: str, derive: Callable[[], Derived]) -> Derived:
        """Return what was derived under a name, or derive it."""
        if what not in self._derived:
            self._derived[what] = derive()
        found: Derived = self._derived[what]
        return found


@dataclass(frozen=True, slots=True)
class FileDeclarations:
    """The declarations of one file that count for others; all names in the language's one case."""

    module: str
    declares: Mapping[str, bool] = field(default_factory=dict)  # names, and whether other modules see them
    uses: Mapping[str, frozenset[MoveFrames]] = field(default_factory=dict)  # of names declared elsewhere
    routines: Mapping[str, RoutineEffects] = field(default_factory=dict)
    doubtful: Mapping[str, str] = field(
        default_factory=dict
    )  # tools and frames no point may be carried in, and why
    made_alone: Mapping[str, str] = field(default_factory=dict)  # the same of a program that a person runs
    public: bool = False  # all that is declared here is seen everywhere
    tools: Poses = field(default_factory=dict)  # declared here for all
    bases: Poses = field(default_factory=dict)
    local_tools: Poses = field(default_factory=dict)  # of which other files know no more than the name
    local_bases: Poses = field(default_factory=dict)
    imports: Imports = field(default_factory=dict)  # for all files of its module
    routine_targets: Mapping[str, RoutineTargets] = field(default_factory=dict)  # routines that get places
    calls: tuple[RoutineCall, ...] = ()  # of routines that other files declare
    routine_names: frozenset[str] = frozenset()  # all that it has, where its calls tell `references`
    copies: tuple[tuple[str, str], ...] = ()  # names, and to what other files may move in their place
    own_uses: Mapping[str, frozenset[MoveFrames]] = field(default_factory=dict)  # of names declared here
    named_tools: frozenset[str] = frozenset()  # what others see and this file declares, or moves, as a tool
    capitals: bool = False  # the one case of its names
    other_data: frozenset[str] = frozenset()  # names of declared data that are no positions and may hold some
    moves: bool = False  # its routines move a robot
    flat: bool = False  # a call means a program of this folder, and one that is not there may set anything

    def of_machine(self) -> "FileDeclarations":
        """Return what a list says of the machine alone, of whose names none is an ordinary one."""
        bases = {name: pose for name, pose in self.bases.items() if name.startswith("$")}
        return FileDeclarations(self.module, doubtful=self.doubtful, bases=bases, capitals=self.capitals)


class FindOpenReason(Protocol):
    """Of a file's routine: why its callers or called routines leave its tool or frame open, or ""."""

    def __call__(self, file: str, name: str, /, *, tool: bool = True, frame: bool = True) -> str:
        """Return the reason, of the tool or frame only where the other is not asked for."""
        ...


class FindDeclarations(Protocol):
    """Finds the declaration that a name means in a file."""

    def __call__(self, file: str, name: str, /) -> tuple[Sequence[str], str]:
        """Return the files that declare it, and its name there; no file where none of the batch does."""
        ...


@dataclass(frozen=True, slots=True)
class ExternalUses:
    """The declarations and actions of a batch's files that count for one of them."""

    uses: Mapping[str, Sequence[tuple[MoveFrames, str]]]  # by declared name; the file that uses it
    doubtful: BatchReasons
    reached: FindOpenReason
    find_declarations: FindDeclarations
    file: str
    visible: frozenset[str]  # names that programs not given may use, too
    tools: Poses  # what files declare for all; the nearest one's for each name
    bases: Poses
    frames_set: frozenset[str] = frozenset()  # tools and frames that a routine may set which gets them
    absent: Mapping[str, frozenset[MoveFrames]] = field(default_factory=dict)  # gone to, and declared by none
    computed: Mapping[str, str] = field(
        default_factory=dict
    )  # global places, and the file that computes them
    given: frozenset[str] = frozenset()  # names of the routines beside it, its own among them
    open_calls: Mapping[str, str] = field(
        default_factory=dict
    )  # routines beside it that reach one that was not given, and which
    frames_left: Mapping[str, frozenset[str]] = field(
        default_factory=dict
    )  # by routine beside it: the frames that it, or one that it calls, chooses
    tools_left: Mapping[str, frozenset[str]] = field(default_factory=dict)  # and the tools
    surely_left: Mapping[str, tuple[str | None, str | None]] = field(
        default_factory=dict
    )  # by routine beside it: the tool and the frame in force behind it, "" for those before it; None: not certain
    frames_before: frozenset[str] = frozenset()  # that callers of its routines choose, or may
    tools_before: frozenset[str] = frozenset()
    frames_beside: frozenset[str] = frozenset()  # that what others let run beside it chooses at any time
    tools_beside: frozenset[str] = frozenset()
    computed_beside: frozenset[str] = frozenset()  # global places that it computes at any time
    running: Mapping[str, str] = field(
        default_factory=dict
    )  # routines not given that other files start to run beside all others, and the file

    calls_itself: bool = False  # a routine of the file may be called again while it runs
    external_tool: str = ""  # a routine that lets the file's moves work with a tool which stands in the cell
    other_task: str = ""  # of the same controller, whose files move, too

    def doubt_reason(self, tool: str | None, frame: str | None) -> str:
        """Return why nothing is carried in a tool or frame, or ""."""
        return self.doubtful.get(lower_name(tool), "") or self.doubtful.get(lower_name(frame), "")

    def uses_of_name(self, name: str) -> Sequence[tuple[MoveFrames, str]]:
        """Return the uses of a declared name, those of its whole array with those of an element."""
        bare = array_name_of(name)
        some = self.uses.get(name, ())
        return some if bare == name else [*some, *self.uses.get(bare, ())]


def without_uncertain_tools(uses: Sequence[tuple[MoveFrames, str]]) -> Sequence[tuple[MoveFrames, str]]:
    """Return uses without those of which it is not certain that they name a tool."""
    return [each for each in uses if not (each[0].tool or "").startswith(UNCERTAIN)]


def settle_uncertain_tools(uses: Sequence[tuple[MoveFrames, str]]) -> Sequence[tuple[MoveFrames, str]]:
    """Return uses without those that tell of no more than a frame which another use has.

    The others are taken at their word: what may be the name of a tool is one.
    """
    found = list(without_uncertain_tools(uses))
    if len(found) == len(uses):
        return uses
    frames = {lower_name(move_frames.frame) for move_frames, _ in found if move_frames.why not in NO_MOTION}
    for move_frames, file in uses:
        tool = move_frames.tool or ""
        if tool.startswith(UNCERTAIN) and lower_name(move_frames.frame) not in frames:
            named = tool.removeprefix(UNCERTAIN) or None
            why = move_frames.why or ("" if named else COMPUTED)
            found.append((move_frames._replace(tool=named, why=why), file))
    return found


def lower_name(name: str | None) -> str:
    """Return a tool's or a frame's name in small letters; "" for none."""
    return "" if name is None else name.lower()


def array_name_of(name: str) -> str:
    """Return an array's name for an element of it."""
    return name.partition("[")[0].partition("{")[0]
