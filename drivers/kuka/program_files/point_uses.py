"""Moves to the points of a KUKA program, and the tool and base that each is done with."""

from collections.abc import Container, Set
from dataclasses import dataclass, field
from typing import NamedTuple, overload

from cellcal.calibration.geometry import Pose
from cellcal.drivers.kuka.program_files.collected_positions import KrlPositions
from cellcal.drivers.kuka.program_files.frame_uses import (
    BARRED,
    RESET,
    TURNED,
    TURNED_BY_AXIS,
    UNKNOWN,
    WRITTEN_OUT,
    Branches,
    KrlRoutine,
    spread_frames_to_called,
)
from cellcal.drivers.kuka.program_files.stretches import Now, Stretches
from cellcal.drivers.programs.barred import OVERWRITTEN, TURNED_BASE
from cellcal.drivers.programs.conditions import ConditionalBar, ProjectNeed
from cellcal.drivers.programs.file_declarations import (
    COPIED,
    OPEN_COPY,
    MoveFrames,
    RoutineEffects,
    array_name_of,
)
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, ProgramFrames
from cellcal.drivers.programs.routine_calls import ParameterUse, RoutineCall

FRAME_DATA = "FDAT "  # before the name of a point's frame data, which stands in the data list
EXTERNAL_TOOL = "the program works with an external tool ($IPO_MODE)"
_ANYWHERE = -1  # in place of a routine
_MOST_COPIES = 100  # of one point, beyond which copies of copies are not looked for
_MOST_USES = 1000  # of one name that are told apart; with more it is left


class PointMove(NamedTuple):
    """A move to a point, in a routine."""

    row: int  # of one written into the move, else -1
    routine: int
    place: int
    branches: Branches
    why: str = ""  # why its tool and base are not the routine's
    data: str = ""  # the frame data of another point that its tool and base are taken from


@dataclass
class PointUses:
    """The moves of a program, by its routines."""

    found: KrlPositions
    routines: list[KrlRoutine] = field(default_factory=lambda: [KrlRoutine(0)])
    rows: list[PointMove] = field(default_factory=list)  # of points written into moves
    uses: dict[str, dict[tuple[int, Branches, str, int, str], PointMove]] = field(
        default_factory=dict
    )  # of named points
    set_frames: dict[str, dict[str, Pose]] = field(
        default_factory=lambda: {"TOOL": {}, "BASE": {}}
    )  # those written out, by their values
    set_tables: set[str] = field(
        default_factory=set
    )  # "BASE 16": BASE_DATA[16] is set; "BASE *": one of them
    measured: dict[str, PointMove] = field(default_factory=dict)  # by the name under which each is copied
    sets_root: bool = False  # it says anew where the robot stands in the world
    set_data: set[str] = field(default_factory=set)  # names that get a value, or a part of frame data
    calls: list[RoutineCall] = field(default_factory=list)  # that pass data with a name
    used_names: dict[str, list[str]] = field(default_factory=dict)  # by array, when all is read
    external_tool: bool = False
    copies: dict[str, set[str]] = field(default_factory=dict)  # of named points: the names they are given to
    bases_of: dict[tuple[str, int], Set[MoveFrames]] = field(
        default_factory=dict
    )  # of moves to a copy, in a routine or anywhere
    given: dict[str, set[tuple[int, str, int]]] = field(
        default_factory=dict
    )  # by name: the calling routine, and the parameter of the called one that gets it
    sources: dict[str, set[str]] = field(default_factory=dict)  # by array name: what is given to it
    moved_as_taught: set[str] = field(default_factory=set)  # names of moves with the frame data of that name
    deciding: dict[str, tuple[MoveFrames, ...]] = field(default_factory=dict)  # by name
    known_held: dict[tuple[int, str, bool, bool, bool, Now], MoveFrames] = field(default_factory=dict)
    stretches: Stretches = field(default_factory=Stretches)
    scopes: dict[int, str] = field(default_factory=dict)  # by row: what is around the moves to it, for files

    def note_use(self, key: str, place: int, branches: Branches, why: str, data: str = "") -> None:
        """Note a move to a named point, and its frame data or why its tool and base are not the routine's."""
        routine = len(self.routines) - 1
        uses_of_key = self.uses.setdefault(key, {})
        # The first move of a branch is the one that the least is set before.
        if len(uses_of_key) < _MOST_USES:
            frames_set = self.routines[routine].passed_until_here()
            uses_of_key.setdefault(
                (routine, branches, why, frames_set, data),
                PointMove(-1, routine, place, branches, why, data),
            )
        else:
            uses_of_key.setdefault((-1, (), "", 0, ""), PointMove(-1, routine, place, (), BARRED["several"]))

    def finish_reading(self) -> None:
        """Give points their tool and base."""
        spread_frames_to_called(self.routines)
        for used in self.rows:
            if self.external_tool and self.found.kinds[used.row] == CARTESIAN:
                self.found.drop_coordinates(used.row, EXTERNAL_TOOL)
                continue
            move_frames = self.frames_of_move(used, joints=self.found.kinds[used.row] != CARTESIAN)
            self.found.tools[used.row], self.found.user_frames[used.row] = move_frames.tool, move_frames.frame
            self.scopes[used.row] = move_frames.routine
            if move_frames.why:
                self._bar_row(used.row, move_frames.why)
        for row, name in enumerate(self.found.names):
            if "@" not in name:
                self._settle_named(row, name)

    def _settle_named(self, row: int, name: str) -> None:
        """Give a point that a statement sets the tool and base of the moves to it."""
        key = name.upper()
        names = {key, array_name_of(key), f"{array_name_of(key)}[]"}
        frames_of_moves = {
            move_frames if data_of(move_frames) == "" else MoveFrames(None, None, BARRED["computed"])
            for one in names
            for move_frames in self._deciding_uses(one)
        }
        frames_of_moves = {
            move_frames for move_frames in frames_of_moves if move_frames.why != COPIED
        } or frames_of_moves
        is_assigned = any(move_frames.why == OVERWRITTEN for move_frames in frames_of_moves)
        if is_assigned and self.found.kinds[row] == JOINTS:
            self.found.barred[row] = OVERWRITTEN
        if not frames_of_moves or self.found.kinds[row] != CARTESIAN:
            return
        if self.external_tool:
            self.found.drop_coordinates(row, EXTERNAL_TOOL)
            return
        why = next(
            (
                move_frames.why
                for move_frames in sorted(frames_of_moves, key=str)
                if move_frames.why and move_frames.why != TURNED_BASE
            ),
            "",
        )
        if len({move_frames[:3] for move_frames in frames_of_moves}) > 1:
            why = why or BARRED["several"]
        if why:
            self.found.barred[row] = why
            return
        move_frames = next(iter(frames_of_moves))
        self.found.tools[row], self.found.user_frames[row] = move_frames[:2]
        stretches = {
            each.routine
            for one in names
            for each in self.frames_of_uses(one)
            if each.routine in self.stretches
        }
        self.scopes |= dict.fromkeys([row] if stretches else (), min(stretches, default=""))
        if len(stretches) > 1 and any(map(self.stretches.calls_others, stretches)):
            self.found.barred[row] = BARRED["called"]
        if move_frames.why:
            self._bar_row(row, move_frames.why)

    def _bar_row(self, row: int, why: str) -> None:
        if why == TURNED_BASE:
            self.found.conditions[row] = ConditionalBar.for_need(ProjectNeed.MOVED_FRAME, why)
        else:
            self.found.barred[row] = why

    def _deciding_uses(self, name: str) -> tuple[MoveFrames, ...]:
        """Return of all uses of a name those that decide: an array's thousands count for each of its elements."""
        if name not in self.deciding:
            some = self.frames_of_uses(name)
            first: dict[object, MoveFrames] = {}
            for move_frames in sorted(some, key=str):
                is_known = move_frames.why in ("", TURNED_BASE)
                first.setdefault(move_frames[:3] if is_known else move_frames.why == COPIED, move_frames)
            whys = [each for each in first.values() if each.why not in ("", TURNED_BASE)]
            frames = [each for each in first.values() if each.why in ("", TURNED_BASE)]
            self.deciding[name] = (*whys, *frames[:2])
        return self.deciding[name]

    def frames_of_uses(self, name: str) -> set[MoveFrames]:
        """Return the tools and bases of all moves to a name."""
        return {self.frames_of_move(used, joints=False) for used in self.uses.get(name, {}).values()}

    def frames_of_move(self, used: PointMove, *, joints: bool) -> MoveFrames:
        """Return the tool and base of a move as far as this file says."""
        routine = self.routines[used.routine]
        if used.data and not routine.interrupted:  # set right before: no other routine comes between
            return MoveFrames(f"{FRAME_DATA}{used.data}", f"{FRAME_DATA}{used.data}")
        tool_said = routine.tool.surely_before(used.place, used.branches, routine.jumps)
        base_said = routine.base.surely_before(used.place, used.branches, routine.jumps)
        tool_now, calls_since_tool = routine.straight(routine.tool, used.place, used.branches)
        base_now, calls_since_base = routine.straight(routine.base, used.place, used.branches)
        now = tool_now, base_now, calls_since_tool or calls_since_base
        key = (used.routine, used.why, tool_said, base_said, joints, now)
        if key not in self.known_held:
            found = self._frames_in_routine(
                routine, used.why, now, tool_said=tool_said, base_said=base_said, joints=joints
            )
            self.known_held[key] = (
                found if found.why else found._replace(routine=self.stretches.name_of(routine, now))
            )
        return self.known_held[key]

    def _frames_in_routine(
        self, routine: KrlRoutine, why: str, now: Now, *, tool_said: bool, base_said: bool, joints: bool
    ) -> MoveFrames:
        tool_now, base_now, _ = now
        why = why or ("" if tool_now else routine.tool.barred_reason(said_before=tool_said))
        if not joints:
            why = why or ("" if base_now else routine.base.barred_reason(said_before=base_said))
        if why:
            return MoveFrames(None, None, why, routine.name)
        tool = self._name_of("TOOL", tool_now or routine.tool.value_in_force(said_before=tool_said))
        value = base_now or routine.base.value_in_force(said_before=base_said)
        base = self._name_of("BASE", value)
        why = explain_set_table(self.set_tables, tool, None if joints else base)
        if why:
            return MoveFrames(None, None, why, routine.name)
        turned = not joints and value is not None and value.startswith(TURNED)
        return MoveFrames(tool, base, TURNED_BASE if turned else "", routine.name)

    def uses_in(self, routine: KrlRoutine, name: str) -> frozenset[ParameterUse]:
        """Return how a routine moves to a parameter, to an element of it, or to copies of it."""
        if not self.used_names:
            for one in self.uses:
                self.used_names.setdefault(array_name_of(one), []).append(one)
        move_frames = {
            self.frames_of_move(used, joints=False)
            for one in self.used_names.get(name, ())
            for used in self.uses[one].values()
            if used.routine == routine.number and used.why != OVERWRITTEN
        }
        if self.external_tool:
            move_frames = {each._replace(why=EXTERNAL_TOOL) for each in move_frames}
        return frozenset(ParameterUse(*each) for each in move_frames | self.frames_of_copies(name))

    def declared_uses(self) -> dict[str, frozenset[MoveFrames]]:
        """Return the moves to points that other files declare."""
        uses_by_name = {}
        for name, all_used in self.uses.items():
            bare = array_name_of(name)
            frames_of_moves = {
                self._with_reset(used, self.frames_of_move(used, joints=False))
                for used in all_used.values()
                if bare not in self.routines[used.routine].declared
            }
            if self.external_tool:
                frames_of_moves = {move_frames._replace(why=EXTERNAL_TOOL) for move_frames in frames_of_moves}
            if frames_of_moves:
                uses_by_name[name.removesuffix("[]")] = frozenset(
                    frames_of_moves | self.frames_of_copies(name)
                )
        return uses_by_name

    def _with_reset(self, used: PointMove, move_frames: MoveFrames) -> MoveFrames:
        """Return the tool and base of a move, marked where the routine reset them before it and set no others.

        A routine of another file that it calls may set others, as may an initialisation of the cell.
        """
        routine = self.routines[used.routine]
        reset, here = routine.reset_from, {one.name for one in self.routines}
        if move_frames.why or used.data or reset is None or used.place < reset or routine.calls - here:
            return move_frames
        return move_frames._replace(tool=move_frames.tool or RESET, frame=move_frames.frame or RESET)

    def frames_of_copies(self, name: str) -> set[MoveFrames]:
        """Return the tools and bases that are set where a copy of a point, or a copy of that, is moved to."""
        waiting: list[tuple[str, int]] = [(name, _ANYWHERE)]
        copies = set[tuple[str, int]]()
        while waiting and len(copies) < _MOST_COPIES:
            at = waiting.pop()
            more = {(copy, _ANYWHERE) for copy in self.copies.get(at[0], ())}
            more |= self._parameters_given(*at) if at != (name, _ANYWHERE) else set()
            waiting += more - copies
            copies |= more
        return {move_frames for copy in copies for move_frames in self._frames_of_name(*copy)}

    def copied_into(self, name: str) -> Set[str]:
        """Return the names whose points a name may hold, given to it directly or by others."""
        if not self.sources:
            for source, copies in self.copies.items():
                for copy in copies:
                    self.sources.setdefault(array_name_of(copy), set()).add(source)
        waiting, found = [name], set[str]()
        while waiting:
            more = self.sources.get(array_name_of(waiting.pop()), set()) - found
            waiting += more
            found |= more
        return found

    def _parameters_given(self, name: str, routine: int) -> set[tuple[str, int]]:
        """Return the parameters of routines of this file, and whose, that a routine gives what stands in a name."""
        if not self.given:
            by_name = {one.name: one for one in self.routines}
            for call in self.calls:
                if (called := by_name.get(call.routine)) is None:
                    continue
                for parameter in called.parameters:
                    passed = call.argument_for(called.parameters, parameter.name)
                    gets = by_name[call.scope].number, parameter.name, called.number
                    self.given.setdefault(passed, set()).add(gets)
        return {
            (parameter, called)
            for caller, parameter, called in self.given.get(name, ())
            if routine in (_ANYWHERE, caller)
        }

    def _frames_of_name(self, copy: str, routine: int) -> Set[MoveFrames]:
        """Return the tools and bases of the moves to a name; any element of an array may be the one."""
        if (copy, routine) not in self.bases_of:
            names = {copy, array_name_of(copy), f"{array_name_of(copy)}[]"}
            moves = {used for one in names for used in self.uses.get(one, {}).values() if not used.why}
            own = f"{FRAME_DATA}F{copy[1:]}"
            taken = {MoveFrames(own, own, COPIED)} if copy in self.moved_as_taught else set()
            self.bases_of[copy, routine] = taken | {
                each
                for used in moves
                if routine in (_ANYWHERE, used.routine)
                for each in self._possible_frames(used)
            }
        return self.bases_of[copy, routine]

    def _possible_frames(self, used: PointMove) -> Set[MoveFrames]:
        """Return the tools and the bases of a move to a copy, all that may be where it is not certain which."""
        certain = self._with_reset(used, self.frames_of_move(used, joints=False))
        routine = self.routines[used.routine]
        callers = [one for one in self.routines if routine.name in one.calls]
        found: list[Set[str]] = []
        for which, now in (("TOOL", certain.tool), ("BASE", certain.frame)):
            some = {now} if now is not None and not certain.why else self._values_around(routine, which)
            some = some or {each for one in callers for each in self._values_in(one, which)}
            some = some or ({RESET} if any(one.resets for one in callers) else set())
            use = routine.tool if which == "TOOL" else routine.base
            found.append(some | {RESET} if certain.why and routine.may_be_reset(use, used.place) else some)
        tools, bases = found
        alone = {MoveFrames(each, None, COPIED, routine.name) for each in tools if FRAME_DATA not in each}
        if not bases:
            alone.add(MoveFrames(None, None, OPEN_COPY, routine.name))
        return alone | {
            MoveFrames(each if FRAME_DATA in each else None, each, COPIED, routine.name) for each in bases
        }

    def _values_around(self, routine: KrlRoutine, which: str) -> Set[str]:
        """Return the tools or bases that a routine sets or takes, and those that are set below and around it."""
        use = routine.tool if which == "TOOL" else routine.base
        marked = {value for value, _ in (*use.below, *use.above)} - {UNKNOWN, TURNED_BY_AXIS, RESET}
        return self._values_in(routine, which) | {self._name_of(which, value) for value in marked}

    def _values_in(self, routine: KrlRoutine, which: str) -> Set[str]:
        """Return the tools or bases that a routine sets, or takes from frame data."""
        use = routine.tool if which == "TOOL" else routine.base
        values = use.values - {UNKNOWN, TURNED_BY_AXIS, RESET}
        taken = {f"{FRAME_DATA}{data}" for data in routine.data_taken}
        return taken | {self._name_of(which, value) for value in values}

    def routine_effects(self) -> dict[str, RoutineEffects]:
        """Return what routines set, for the files that call them."""
        return self.stretches.effects_with(self.routines)

    def to_frames(self) -> ProgramFrames:
        """Return ``$BASE`` and ``$TOOL`` as the program writes them, as numbers."""
        poses = {which: {"0": Pose((0.0, 0.0, 0.0))} for which in ("TOOL", "BASE")}
        for which, set_poses in self.set_frames.items():
            poses[which] |= {self._name_of(which, value): pose for value, pose in set_poses.items()}
        return ProgramFrames(base_frame=poses["BASE"], flange_tip=poses["TOOL"])

    @overload
    def _name_of(self, which: str, value: str) -> str: ...

    @overload
    def _name_of(self, which: str, value: str | None) -> str | None: ...

    def _name_of(self, which: str, value: str | None) -> str | None:
        """Return a tool's or base's name: ``$TOOL`` with its numbers where it is written out."""
        if value is None or not value.startswith(WRITTEN_OUT):
            return None if value is None else value.removeprefix(TURNED)
        return f"${which}={value[1:]}"

    def frames_written_out(self, which: str) -> dict[str, Pose | None]:
        """Return the tools or bases that are written out, by the names under which files find them."""
        return {self._name_of(which, value).lower(): pose for value, pose in self.set_frames[which].items()}


def data_of(move_frames: MoveFrames) -> str:
    """Return the name of the frame data that a move takes its tool and base from; "" where it is none."""
    tool = move_frames.tool or ""
    return tool.removeprefix(FRAME_DATA) if tool.startswith(FRAME_DATA) else ""


def explain_set_table(tables: Container[str], tool: str | None, base: str | None, prefix: str = "") -> str:
    """Return why a table's tool or base that programs set is unknown; "" where none is set."""
    for which, number in (("TOOL", tool), ("BASE", base)):
        is_table_entry = number is not None and number.isdigit() and number != "0"
        if is_table_entry and any(f"{prefix}{which} {one}" in tables for one in (number, "*")):
            return BARRED["computed"]
    return ""
