"""Shifts of RAPID that do not turn with the targets: what was found while reading, and the rows it counts for."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import nan

from cellcal.drivers.abb.program_files.collected_positions import RapidPositions
from cellcal.drivers.abb.program_files.displacements import WORDS, ActiveDisplacement, Displacements
from cellcal.drivers.abb.program_files.instructions import COMPUTED, FORCE_REFERENCES, MoveTarget, offset_of
from cellcal.drivers.abb.program_files.literals import NAME, NUMBER, W, after_blanks, decode_name
from cellcal.drivers.abb.program_files.measured_places import measured_shifts
from cellcal.drivers.abb.program_files.target_uses import TargetUses
from cellcal.drivers.programs.barred import OVERWRITTEN
from cellcal.drivers.programs.file_declarations import COMPONENT_SET
from cellcal.drivers.programs.guided_motions import guided_motion
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, UNTAUGHT
from cellcal.drivers.programs.shifts import NO_TURN, UNREADABLE, ProgramShift, Quaternion, ShiftAxes, Triple

EXTERNAL_OFFSET = "an external axis is offset here, and the project does not know what it moves"
REFERENCE = "a displacement is taken from it (PDispOn), and no move of this file goes to it"
_OTHERS = "what other routines go to while it holds"
_COMPUTED = "a computed place"
_NAME = re.compile(rf"{W}({NAME})", re.ASCII)
_MEASURED = re.compile(  # where the robot is, or the joints of a target: they go along
    rf"{W}(?:CRobT|CJointT|CalcJointT)\b", re.ASCII | re.IGNORECASE
)
_SUM = re.compile(r"([^;+\-]*+)([+-])([^;]*+);", re.ASCII)
_TERM = re.compile(rf"{W}({NUMBER}){W}", re.ASCII)
_AXIS = re.compile(r"\.trans\.([xyz])$", re.IGNORECASE)
_PLACE = re.compile(r"\.(?:trans|rot)\b", re.IGNORECASE)
_AXES = re.compile(r"\.robax\b", re.IGNORECASE)
_BESIDE = re.compile(r"\.(?:robconf|extax)\b", re.IGNORECASE)  # another posture or axis is meant then


@dataclass(frozen=True, slots=True)
class FoundShift:
    """One shift as it stands in the text."""

    place: int
    what: str
    scope: str
    name: str  # of the target
    user_frame: str | None
    translation_m: Triple
    quaternion: Quaternion | None = NO_TURN
    row: int = -1  # of a target that is written into the move
    each_time: bool = False
    sets: bool = False


@dataclass
class FoundShifts:
    """The shifts of a module."""

    displacements: Displacements
    found: list[FoundShift] = field(default_factory=list)
    guided: list[ProgramShift] = field(default_factory=list)  # motions that another device guides
    set_components: list[tuple[str, str]] = field(default_factory=list)  # name, scope: not by adding to it
    overwritten: list[tuple[str, str]] = field(default_factory=list)  # by what is neither read nor a copy
    computed_values: list[tuple[int, str, str]] = field(
        default_factory=list
    )  # where that stands, name, scope

    def take_word(self, word: str, span: tuple[int, int], scope: str) -> None:
        """Note a displacement, or a target that a function shifts."""
        text, (start, end) = self.displacements.text, span
        if word in WORDS:
            self.displacements.take_instruction(word, text[start:end], end, scope)
            return
        opened = after_blanks(text, end)
        if word not in ("offs", "mirpos") or text[opened : opened + 1] != "(":
            return
        named = _NAME.match(text, opened + 1)
        size = offset_of(text, opened + 1, len(text)) if word == "offs" else UNREADABLE
        turn = NO_TURN if word == "offs" else None
        name = decode_name(named[1]) if named else ""
        self.found.append(FoundShift(start, text[start:end], scope, name, None, size, turn))

    def take_guided(self, word: str, span: tuple[int, int], line: int, scope: str) -> None:
        """Note a motion that a sensor guides, or a force or a search pattern along the axes of a frame."""
        what = self.displacements.text[span[0] : span[1]]
        if word in FORCE_REFERENCES:
            self.found.append(FoundShift(span[0], what, scope, "", None, UNREADABLE))
        else:
            self.guided.append(guided_motion(line, what))

    def take_target(self, target: MoveTarget, move: tuple[str, int], scope: str, frame: str | None) -> None:
        """Note a target that its move itself, by name and row, shifts or computes."""
        if target.offset_m is None and target.remark != COMPUTED:
            return
        name, row = move
        what, size, turn = ("Offs", target.offset_m, NO_TURN) if target.offset_m else (name, UNREADABLE, None)
        self.found.append(FoundShift(target.place, what, scope, target.name, frame, size, turn, row))

    def take_component(self, place: int, target: tuple[str, str], path: str, value_place: int) -> None:
        """Note that a component of a target, a name in a scope, is assigned."""
        name, scope = target
        if _AXES.search(path) is not None or _BESIDE.search(path) is not None:
            self.set_components.append((name, scope))
        if _PLACE.search(path) is None:
            return
        text = self.displacements.text
        translation: Triple = UNREADABLE
        axis, added = _AXIS.search(path), _SUM.match(text, value_place)
        itself = "".join(text[place:value_place].split()).removesuffix(":=").lower()
        if axis is not None and added is not None and "".join(added[1].split()).lower() == itself:
            term = _TERM.fullmatch(added[3])
            size = float(term[1]) * (1e-3 if added[2] == "+" else -1e-3) if term else nan
            translation = _along_axis(axis[1].lower(), size)
            self._add_shift(place, name, scope, translation, NO_TURN)
            return
        self.set_component(place, name, scope)

    def overwrite(self, place: int, target: tuple[str, str], value_place: int) -> None:
        """Note that data, a name in a scope, get a value as a whole that is neither read nor a copy."""
        self.overwritten.append(target)
        if _MEASURED.match(self.displacements.text, value_place) is None:
            self.computed_values.append((place, *target))

    def set_component(self, place: int, name: str, scope: str, path: str = "") -> None:
        """Note that a component of a target, a name in a scope, gets a value."""
        self.set_components.append((name, scope))
        if _AXES.search(path) is None:
            self.found.append(self._set_value(place, name, scope, None))

    def _set_value(self, place: int, name: str, scope: str, frame: str | None) -> FoundShift:
        what = self._statement_at(place)
        return FoundShift(place, what, scope, name, frame, UNREADABLE, None, sets=True)

    def _statement_at(self, place: int) -> str:
        text = self.displacements.text
        end = text.find(";", place)
        return " ".join(text[place : end if end >= 0 else place].split())[:80]

    def _add_shift(
        self, place: int, name: str, scope: str, translation: Triple, quaternion: Quaternion | None
    ) -> None:
        what = self._statement_at(place)
        self.found.append(FoundShift(place, what, scope, name, None, translation, quaternion, each_time=True))

    def to_shifts(self, collected: RapidPositions, uses: TargetUses) -> tuple[ProgramShift, ...]:
        """Return the shifts with the rows of their targets, counted as they were read."""
        found = [*self.found, *self._values_of_places(uses)]
        named = [self._make_shift(one, collected, uses) for one in found]
        return (
            *named,
            *self.guided,
            *(
                shift
                for (scope, name), frames in sorted(uses.frames_of_measured().items())
                for shift in measured_shifts(collected.source, name, frames, uses.parameters_of(scope))
            ),
            *(
                shift
                for displacement in self.displacements.active_displacements
                if not self._goes_along(displacement, collected, uses)
                for shift in _shifts_of_displacement(displacement, collected, uses)
            ),
        )

    def _values_of_places(self, uses: TargetUses) -> Iterator[FoundShift]:
        """Yield the values that places without numbers in the file get: elements and parameters that moves go to."""
        for place, name, scope in self.computed_values:
            frames = {frame for _, frame in uses.uses_of_open_place(name, scope)}
            if frames:
                yield self._set_value(place, name, scope, frames.pop() if len(frames) == 1 else None)

    def bar_targets(self, collected: RapidPositions, uses: TargetUses) -> None:
        """Leave targets whose place is no longer what stands in the file when they are moved to."""
        for targets, why in ((self.set_components, COMPONENT_SET), (self.overwritten, OVERWRITTEN)):
            for name, scope in targets:
                uses.note_external_value(name, scope, why)
                for row in uses.rows_of(name, scope):
                    if collected.kinds[row] in (CARTESIAN, JOINTS):
                        uses.barred.setdefault(row, why)
        self._bar_references(collected, uses)
        for displacement in self.displacements.active_displacements:
            if displacement.event.word.startswith("eoffs"):
                for row in _rows_of(displacement, collected, uses):
                    uses.barred.setdefault(row, EXTERNAL_OFFSET)

    def _goes_along(
        self, displacement: ActiveDisplacement, collected: RapidPositions, uses: TargetUses
    ) -> bool:
        """Return whether a displacement turns and moves with the work: both places it is taken from go along.

        With F the change in the work object, PDispOn makes F D F^-1 of D, and F D p is where F p is displaced to.
        """
        event, frame = displacement.event, (displacement.event.frame or "").lower()
        if displacement.others:  # what other routines go to may stand in another work object
            return False
        places = [(name, event.scope, -1) for name in event.references]
        if len(places) == 1 and (before := self.displacements.move_before(event)) is not None:
            places.append((before.name, before.scope, before.row))
        if len(places) < 2:
            return False
        changed_names = {name.lower() for name, _ in (*self.set_components, *self.overwritten)}
        rows = [[row] if row >= 0 else uses.rows_of(name, scope) for name, scope, row in places]
        return (
            all((move.frame or "").lower() == frame for move in displacement.moves)
            and all(rows)
            and all(name.lower() not in changed_names for name, _, _ in places)
            and all(_is_used_in(row, collected, uses, frame) for its in rows for row in its)
        )

    def _bar_references(self, collected: RapidPositions, uses: TargetUses) -> None:
        """Leave targets that displacements are taken from and no move goes to: nothing tells their work object."""
        for name, scope in self.displacements.references:
            for row in _cartesian_rows(uses.rows_of(name, scope), collected):
                if row not in uses.of_row:
                    uses.barred.setdefault(row, REFERENCE)

    @staticmethod
    def _make_shift(one: FoundShift, collected: RapidPositions, uses: TargetUses) -> ProgramShift:
        rows = (one.row,) if one.row >= 0 else _cartesian_rows(uses.rows_of(one.name, one.scope), collected)
        return ProgramShift(
            collected.source.line_of(one.place),
            one.what,
            ShiftAxes.USER_FRAME,
            rows,
            point=one.name or _COMPUTED,
            user_frame=one.user_frame,
            translation_m=one.translation_m,
            quaternion=one.quaternion,
            each_time=one.each_time,
            sets=one.sets,
        )


def _shifts_of_displacement(
    displacement: ActiveDisplacement, collected: RapidPositions, uses: TargetUses
) -> Iterator[ProgramShift]:
    """Yield what a displacement shifts: rows of this file, targets of other files, and what may follow."""
    event = displacement.event
    if event.word.startswith("eoffs"):
        return
    line = collected.source.line_of(event.place)

    def make_shift(rows: tuple[int, ...], point: str, frame: str | None) -> ProgramShift:
        return ProgramShift(
            line,
            event.spelled,
            ShiftAxes.USER_FRAME,
            rows,
            point,
            frame,
            event.translation_m,
            event.quaternion,
        )

    rows = _rows_of(displacement, collected, uses)
    if rows:
        yield make_shift(rows, "", None)
    elsewhere = {
        (move.name, move.frame)
        for move in displacement.moves
        if move.name and not _cartesian_rows(uses.rows_of(move.name, move.scope), collected)
    }
    for name, frame in sorted(elsewhere, key=str):
        yield make_shift((), name, frame)
    if displacement.others:
        yield make_shift((), _OTHERS, None)


def _rows_of(
    displacement: ActiveDisplacement, collected: RapidPositions, uses: TargetUses
) -> tuple[int, ...]:
    rows = {move.row for move in displacement.moves if move.row >= 0}
    for name, scope in {(move.name, move.scope) for move in displacement.moves if move.name}:
        rows |= set(uses.rows_of(name, scope))
    return _cartesian_rows(sorted(rows), collected)


def _is_used_in(row: int, collected: RapidPositions, uses: TargetUses, frame: str) -> bool:
    """Return whether a target is moved to, and in one work object only."""
    of_row = uses.of_row.get(row, ())
    return (
        collected.kinds[row] in (CARTESIAN, UNTAUGHT)
        and row not in uses.barred
        and bool(of_row)
        and all((used or "").lower() == frame for _, used in of_row)
    )


def _along_axis(axis: str, size_m: float) -> Triple:
    x, y, z = (size_m if axis == one else 0.0 for one in "xyz")
    return x, y, z


def _cartesian_rows(rows: Sequence[int], collected: RapidPositions) -> tuple[int, ...]:
    return tuple(row for row in rows if collected.kinds[row] == CARTESIAN)
