"""Moves to the points of a KUKA program, and the tool and base that each is done with."""

from collections.abc import Container, Set
from dataclasses import dataclass, field
from typing import NamedTuple

from cellcal.calibration.geometry import Pose
from cellcal.drivers.kuka.program_files.collected import Collected
from cellcal.drivers.kuka.program_files.frame_uses import (
    BARRED,
    RESET,
    UNKNOWN,
    Branches,
    Routine,
    reached_from,
)
from cellcal.drivers.programs.across import COPIED, Held, RoutineSaid, bare_of
from cellcal.drivers.programs.positions import CARTESIAN, Frames

EXTERNAL_TOOL = "the program works with an external tool ($IPO_MODE)"
_MOST_COPIES = 100  # of one point, beyond which copies of copies are not looked for
_MOST_USES = 1000  # of one name that are told apart; with more it is left


class Used(NamedTuple):
    """A move to a point, in a routine."""

    row: int  # of one written into the move, else -1
    routine: int
    place: int
    branches: Branches
    why: str = ""  # why its tool and base are not the routine's


@dataclass
class PointUses:
    """The moves of a program, by its routines."""

    found: Collected
    routines: list[Routine] = field(default_factory=lambda: [Routine(0)])
    rows: list[Used] = field(default_factory=list)  # of points written into moves
    uses: dict[str, dict[tuple[int, Branches, str], Used]] = field(default_factory=dict)  # of named points
    set_frames: dict[str, list[Pose | None]] = field(default_factory=lambda: {"TOOL": [], "BASE": []})
    set_tables: set[str] = field(
        default_factory=set
    )  # "BASE 16": BASE_DATA[16] is set; "BASE *": one of them
    external_tool: bool = False
    copies: dict[str, set[str]] = field(default_factory=dict)  # of named points: the names they are given to
    bases_of: dict[str, Set[Held]] = field(default_factory=dict)  # of moves to a copy
    deciding: dict[str, tuple[Held, ...]] = field(default_factory=dict)  # by name
    known_held: dict[tuple[int, str, bool, bool, bool], Held] = field(default_factory=dict)

    def use(self, key: str, place: int, branches: Branches, why: str) -> None:
        """Note a move to a named point, or why its tool and base are not the routine's."""
        routine = len(self.routines) - 1
        said = self.uses.setdefault(key, {})
        # The first move of a branch is the one that the least is set before.
        if len(said) < _MOST_USES:
            said.setdefault((routine, branches, why), Used(-1, routine, place, branches, why))
        else:
            said.setdefault((-1, (), ""), Used(-1, routine, place, (), BARRED["several"]))

    def finish(self) -> None:
        """Give points their tool and base."""
        reached_from(self.routines)
        for used in self.rows:
            if self.external_tool and self.found.kinds[used.row] == CARTESIAN:
                self.found.forget(used.row, EXTERNAL_TOOL)
                continue
            held = self.held(used, joints=self.found.kinds[used.row] != CARTESIAN)
            self.found.tools[used.row], self.found.user_frames[used.row] = held.tool, held.frame
            if held.why:
                self.found.barred[used.row] = held.why
        for row, name in enumerate(self.found.names):
            if "@" not in name:
                self._settle_named(row, name)

    def _settle_named(self, row: int, name: str) -> None:
        """Give a point that a statement sets the tool and base of the moves to it."""
        key = name.upper()
        helds = {held for one in {key, bare_of(key), f"{bare_of(key)}[]"} for held in self._deciding(one)}
        helds = {held for held in helds if held.why != COPIED} or helds
        if not helds or self.found.kinds[row] != CARTESIAN:
            return
        if self.external_tool:
            self.found.forget(row, EXTERNAL_TOOL)
            return
        why = next((held.why for held in sorted(helds, key=str) if held.why), "")
        if len({held[:2] for held in helds}) > 1:
            why = why or BARRED["several"]
        if why:
            self.found.barred[row] = why
        else:
            self.found.tools[row], self.found.user_frames[row] = next(iter(helds))[:2]

    def _deciding(self, name: str) -> tuple[Held, ...]:
        """Return of all uses of a name those that decide: an array's thousands count for each of its elements."""
        if name not in self.deciding:
            some = {self.held(used, joints=False) for used in self.uses.get(name, {}).values()}
            first: dict[object, Held] = {}
            for held in sorted(some, key=str):
                first.setdefault(held.why == COPIED if held.why else held[:2], held)
            whys = [held for held in first.values() if held.why]
            frames = [held for held in first.values() if not held.why]
            self.deciding[name] = (*whys, *frames[:2])
        return self.deciding[name]

    def held(self, used: Used, *, joints: bool) -> Held:
        """Return the tool and base of a move as far as this file says."""
        routine = self.routines[used.routine]
        tool_said = routine.tool.surely_before(used.place, used.branches, routine.jumps)
        base_said = routine.base.surely_before(used.place, used.branches, routine.jumps)
        key = (used.routine, used.why, tool_said, base_said, joints)
        if key not in self.known_held:
            self.known_held[key] = self._held(
                routine, used.why, tool_said=tool_said, base_said=base_said, joints=joints
            )
        return self.known_held[key]

    def _held(self, routine: Routine, why: str, *, tool_said: bool, base_said: bool, joints: bool) -> Held:
        why = why or routine.tool.barred(said_before=tool_said)
        if not joints:
            why = why or routine.base.barred(said_before=base_said)
        if why:
            return Held(None, None, why, routine.name)
        tool = _resolved(routine.tool.value(said_before=tool_said), self._name_of_set("TOOL"))
        base = _resolved(routine.base.value(said_before=base_said), self._name_of_set("BASE"))
        why = in_set_table(self.set_tables, tool, None if joints else base)
        return Held(None, None, why, routine.name) if why else Held(tool, base, "", routine.name)

    def uses_said(self) -> dict[str, frozenset[Held]]:
        """Return the moves to points that other files declare."""
        said = {}
        for name, all_used in self.uses.items():
            bare = bare_of(name)
            helds = {
                self.held(used, joints=False)
                for used in all_used.values()
                if bare not in self.routines[used.routine].declared
            }
            if self.external_tool:
                helds = {held._replace(why=EXTERNAL_TOOL) for held in helds}
            if helds:
                said[name.removesuffix("[]")] = frozenset(helds | self._of_copies(name))
        return said

    def _of_copies(self, name: str) -> set[Held]:
        """Return the bases that are set where a copy of a point, or a copy of that, is moved to."""
        copies, waiting = set[str](), [name]
        while waiting and len(copies) < _MOST_COPIES:
            more = self.copies.get(waiting.pop(), set()) - copies
            copies |= more
            waiting += more
        return {held for copy in copies for held in self._bases_of(copy)}

    def _bases_of(self, copy: str) -> Set[Held]:
        """Return the bases that are set where a name is moved to; any element of an array may be the one."""
        if copy not in self.bases_of:
            names = {copy, bare_of(copy), f"{bare_of(copy)}[]"}
            routines = {
                used.routine for one in names for used in self.uses.get(one, {}).values() if not used.why
            }
            named = self._name_of_set("BASE") or "$"
            self.bases_of[copy] = {
                Held(None, named if base == "$" else base, COPIED, self.routines[routine].name)
                for routine in routines
                for base in self.routines[routine].base.values
                if base not in (UNKNOWN, RESET)
            }
        return self.bases_of[copy]

    def routines_said(self) -> dict[str, RoutineSaid]:
        """Return what routines set, for the files that call them."""
        return {
            routine.name: RoutineSaid(
                frozenset(routine.tool.values),
                frozenset(routine.base.values),
                frozenset(routine.calls),
                routine.shown,
                routine.resets,
            )
            for routine in self.routines
        }

    def frames(self) -> Frames:
        """Return ``$BASE`` and ``$TOOL`` where the program writes them once, as numbers."""
        poses = {which: {"0": Pose((0.0, 0.0, 0.0))} for which in ("TOOL", "BASE")}
        for which, given in self.set_frames.items():
            if len(given) == 1 and given[0] is not None:
                poses[which][f"${which}"] = given[0]
        return Frames(base_frame=poses["BASE"], flange_tip=poses["TOOL"])

    def _name_of_set(self, which: str) -> str | None:
        given = self.set_frames[which]
        return f"${which}" if len(given) == 1 and given[0] is not None else None


def in_set_table(set_tables: Container[str], tool: str | None, base: str | None, prefix: str = "") -> str:
    """Return why nobody can tell where a tool or base of the tables is that programs set; "" where none does."""
    for which, number in (("TOOL", tool), ("BASE", base)):
        told = number is not None and number.isdigit() and number != "0"
        if told and any(f"{prefix}{which} {one}" in set_tables for one in (number, "*")):
            return BARRED["computed"]
    return ""


def _resolved(value: str | None, name_of_set: str | None) -> str | None:
    return name_of_set if value == "$" else value
