"""What the motions of a program do to its positions: increments, led motions and shifts, row by row."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import nan

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_computed import (
    ComputedRegisters,
    RegisterContents,
    is_computing,
    registers_of,
)
from cellcal.drivers.fanuc.program_files.ls_copied_frames import START, copies_in_other_frames
from cellcal.drivers.fanuc.program_files.ls_positions import REMOTE
from cellcal.drivers.fanuc.program_files.ls_registers import frames_in_force
from cellcal.drivers.fanuc.program_files.ls_shared_registers import shifts_by_other_programs
from cellcal.drivers.fanuc.program_files.ls_statements import (
    MotionStatement,
    Statement,
    condition_of,
    motion_of,
    read_statements,
)
from cellcal.drivers.programs.conditions import ConditionalBar, ProjectNeed
from cellcal.drivers.programs.file_declarations import ExternalUses
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, Positions
from cellcal.drivers.programs.shifts import NO_TURN, UNREADABLE, ProgramShift, ShiftAxes

_INCREMENT = "it is an increment: {} in line {} adds it to where the robot is"
_LED_MOTION = "another motion group leads the motion there ({} in line {})"
_STANDING_TOOL = "the tool of its motion stands in the cell ({} in line {})"
_CAMERA = "a camera shifts the motion there while the program runs ({} in line {})"
_ANY_INCREMENT = "a register chooses the positions of the motion in line {}, and {} makes them no places"
_AMOUNT = "the program computes with it and does not go there, so it may be a shift"
_WRITTEN_REMOTE = (
    "it is written with RX to RR, for a tool that stands in the cell; the listing does not say where"
)
_GIVEN_HERE = "line {} gives it a value while the program runs"
_GIVEN = re.compile(  # behind the condition of an IF, too
    rb"(?:(?:IF|WENN)\b[^=;]*+[^;,]*+,[ \t]*+)?+P(?<![A-Za-z]P)\[ *+(\d{1,5}+) *+(?:,[^\]]*+)?+\][ \t]*+=(?!=)"
)
_GIVES = re.compile(rb"(?<![A-Z])P\[[^\]\n]{1,40}+\][ \t]*+=(?!=)")
_WORDS = (b"INC", b"COORD", b"RTCP", b"VR[", b"OFFSET", b"PR[", b"PAL_", b"SEARCH")
_REST = (  # "home", "Home1", "HomePos", "GoHome", "Grundstellung" as words; not "SPARK", "PARKETT" or "HomeBin"
    rb"(?<![a-z\x80-\xff])(?:(?:go|rob|robot)?(?:home|perch|park)|parken|parking|grund|ruhe)"
    rb"(?:pos|posn|position|point|pkt|punkt|platz|st|stlg|stellung|lage)?(?![a-z\x80-\xff])"
)
_HOME = re.compile(  # the robot's own resting posture, which no work moves, where its comment says so
    rb"\bJ[ \t]++PR\[ *+(\d{1,5}+) *+:[^\]\n]*?" + _REST, re.IGNORECASE
)
_STRAIGHT = re.compile(rb"\b[LCAS][ \t]++PR\[ *+(\d{1,5}+)", re.IGNORECASE)
_ANY_REGISTER = -1  # in place of a register: a number chooses it
_CARRY = "Carry it with `cellcal program registers`, or teach it there."
_TO_PALLET = re.compile(
    rb"[JLCAS][ \t]++(PAL_\d++\[[^\]]{0,20}+\])"
)  # its places are no positions of the listing


@dataclass
class _MotionFindings:
    """What was found so far."""

    increments: dict[int, str] = field(default_factory=dict)  # positions that are no places, and why
    needs: dict[int, ConditionalBar] = field(default_factory=dict)  # of positions, by number
    any_increment: str = ""
    places: set[int] = field(default_factory=set)  # positions that a motion goes to as they stand
    goes_to: dict[int, int] = field(default_factory=dict)  # registers that are gone to, and in which line
    reached: dict[int, list[int]] = field(
        default_factory=dict
    )  # registers gone to, shifted or not: all lines
    added: dict[int, int] = field(
        default_factory=dict
    )  # registers by which a motion goes on, and in which line
    shifted: dict[int, int] = field(default_factory=dict)  # registers that are gone to with a shift
    amounts: set[int] = field(default_factory=set)  # registers that shift a motion, or that it adds
    shifts: list[tuple[int, ProgramShift]] = field(default_factory=list)  # by position
    any_shift: list[ProgramShift] = field(default_factory=list)  # of positions that a register chooses
    conditions: set[int] = field(default_factory=set)  # registers that shift by OFFSET CONDITION
    by_register: list[MotionStatement] = field(default_factory=list)  # motions that registers shift or add to
    assigned: list[tuple[Statement, int | None]] = field(default_factory=list)


def with_motions(positions: Positions, data: bytes, external_uses: ExternalUses | None = None) -> Positions:
    """Return positions with those barred that are no places, and with the shifts of their motions.

    ``external_uses`` is what the controller's other programs do with its registers; None: they are not known.
    """
    upper = data.upper()
    if not (any(word in upper for word in _WORDS) or _GIVES.search(upper, 0, max(upper.rfind(b"/POS"), 0))):
        # as in nearly all
        return positions
    in_joints = _positions_in_joints(positions)
    found = _find_motions(data, in_joints)
    registers = registers_of(found.assigned, in_joints)
    found.amounts |= found.conditions
    for motion in found.by_register:
        if registers.camera & set(motion.shifting or found.conditions):
            why = make_message(_CAMERA, "Offset", motion.line)
            found.increments = {**dict.fromkeys(motion.targets, why), **found.increments}
    elsewhere = list(copies_in_other_frames(positions, data, external_uses))
    shifts = [
        *found.shifts,
        *_shifts_by_registers(found, registers),
        *_shifts_by_places(found, registers),
        *shifts_by_other_programs(data, registers, external_uses),
        *elsewhere,
    ]
    barred, conditions = dict(positions.barred), dict(positions.conditions)
    rows: dict[int, list[int]] = {}
    for row, name in enumerate(positions.names):
        number = int(name[2:-1])
        rows.setdefault(number, []).append(row)
        if (
            why := found.increments.get(number)
            or found.any_increment
            or _amount_reason(number, found, registers)
        ):
            barred.setdefault(row, why)
        elif number in found.needs:
            conditions[row] = found.needs[number]
    if registers.any_position:  # whichever position it is, something may be computed from it
        found.any_shift.append(
            ProgramShift(registers.any_position, "PR[...]=P[R[...]]", ShiftAxes.USER_FRAME, quaternion=None)
        )
    frames = frames_in_force(data, positions, external_uses) if found.reached else {}
    here = list(_shifts_of_places_here(frames, found, registers))
    all_shifts = [
        *here,
        *(shift for position, shift in elsewhere if position == START),
        *_pallet_places(data),
        *_added_registers(found, registers),
        *_absent_places(data, frames, found, registers),
        *_with_rows(shifts, rows, positions),
        *_with_all_rows(found.any_shift, positions),
    ]
    return replace(positions, barred=barred, conditions=conditions, shifts=(*positions.shifts, *all_shifts))


def _pallet_places(data: bytes) -> Iterator[ProgramShift]:
    """Yield the motions to a pallet: its pattern sets the place, and stays as it was taught."""
    seen: set[bytes] = set()
    for statement in read_statements(data):
        found = _TO_PALLET.match(statement.text)
        if found is not None and found[1] not in seen:
            seen.add(found[1])
            place = found[1].decode("cp437")
            yield ProgramShift(
                statement.line, "PALLETIZING", ShiftAxes.USER_FRAME, point=place, quaternion=None, sets=True
            )


def _added_registers(found: _MotionFindings, registers: ComputedRegisters) -> Iterator[ProgramShift]:
    """Yield the motions by an increment in a register, which stays along the axes of its user frame."""
    for register, line in found.added.items():
        point, axes = _register_name(register), _axes_of(registers, register)
        yield ProgramShift(line, "INC", axes, point=point, translation_m=UNREADABLE, quaternion=NO_TURN)


def _register_name(register: int) -> str:
    return f"PR[{register}]" if register != _ANY_REGISTER else "PR[R[...]]"


def _absent_places(
    data: bytes, frames: Mapping[int, str | None], found: _MotionFindings, registers: ComputedRegisters
) -> Iterator[ProgramShift]:
    """Yield the motions to registers that this program fills from none of its positions, home aside."""
    homes = {int(each) for each in _HOME.findall(data)} - {int(each) for each in _STRAIGHT.findall(data)}
    for number, lines in found.reached.items():
        if registers.origins.get(number) or number in registers.here or number in homes:
            continue
        point = _register_name(number)
        for frame, line in _first_lines(lines, frames).items():
            yield ProgramShift(
                line, "PR[...]", ShiftAxes.USER_FRAME, point=point, user_frame=frame, absent=_CARRY
            )


def _first_lines(lines: Sequence[int], frames: Mapping[int, str | None]) -> dict[str | None, int]:
    """Return the user frames that may be in force in some lines, None for any, and the first line of each."""
    found: dict[str | None, int] = {}
    for line in lines:
        found.setdefault(frames[line], line)
    return found


def _shifts_of_places_here(
    frames: Mapping[int, str | None], found: _MotionFindings, registers: ComputedRegisters
) -> Iterator[ProgramShift]:
    """Yield what is added to, or set in, registers that got where the robot was before any position."""
    places = [
        (each, frame, line)
        for each, lines in found.reached.items()
        if each in registers.here and each in found.goes_to
        for frame, line in _first_lines(lines, frames).items()
    ]
    for each, frame, line in places:
        point = f"PR[{each}]"
        if each in registers.altered or each in found.shifted:
            yield ProgramShift(
                line,
                point,
                _axes_of(registers, each),
                point=point,
                user_frame=frame,
                translation_m=UNREADABLE if each in found.shifted else registers.added_to(each),
                quaternion=None if each in registers.turned else NO_TURN,
            )
        yield from (replace(shift, point=point, user_frame=frame) for shift in _set_elements(each, registers))


def bar_standing_tools(positions: Positions) -> Positions:
    """Return positions with those barred that are written for a tool that stands in the cell."""
    if REMOTE not in positions.kinds:
        return positions
    barred = {row: _WRITTEN_REMOTE for row, kind in enumerate(positions.kinds) if kind == REMOTE}
    return replace(positions, barred={**barred, **positions.barred})


def _positions_in_joints(positions: Positions) -> frozenset[int]:
    """Return the numbers of positions that are held in joint angles."""
    return frozenset(
        int(name[2:-1]) for name, kind in zip(positions.names, positions.kinds, strict=True) if kind == JOINTS
    )


def _find_motions(data: bytes, in_joints: frozenset[int]) -> _MotionFindings:
    found, contents, region = _MotionFindings(), RegisterContents(), False
    last: int | None = None
    computing = [(each, None) for each in read_statements(data) if is_computing(each)]
    registers = registers_of(computing, in_joints)
    for statement in read_statements(data):
        if not statement.is_motion:
            contents.follow_statement(statement)
            region = _touch_offset(statement, region)
            found.conditions.update(condition_of(statement))
            _take_given(found, statement)
            if is_computing(statement):
                found.assigned.append((statement, last))
            continue
        motion = motion_of(statement)
        contents.follow_statement(statement)
        _take_targets(found, motion)
        _take_reached(found, motion, region)
        if motion.search:  # it goes along an axis of the touch sensor's frame, as far as it finds something
            _add_shift(found, motion, ProgramShift(motion.line, motion.search, ShiftAxes.USER_FRAME))
        if motion.offset or region:
            amount, quaternion = (
                contents.shift_of_motion(motion, registers.turned | registers.joints)
                if not region
                else (UNREADABLE, None)
            )
            option = "Offset" if motion.offset else "Touch Offset"
            axes = _axes_of(registers, *motion.offset_registers)
            shift = ProgramShift(motion.line, option, axes, translation_m=amount, quaternion=quaternion)
            _add_shift(found, motion, shift)
            found.shifted |= dict.fromkeys(motion.register_targets, motion.line)
        last = motion.targets[-1] if motion.targets else last
        if motion.stored:
            found.assigned.append((Statement(motion.stored, motion.line), last))
    return found


def _take_reached(found: _MotionFindings, motion: MotionStatement, region: bool) -> None:
    """Take up which registers a motion goes to, shifted or not."""
    some = (*motion.register_targets, *((_ANY_REGISTER,) if motion.any_register else ()))
    if motion.relative:
        found.added |= dict.fromkeys(some, motion.line)
    elif motion.is_place or motion.offset or region:
        for register in some:
            found.reached.setdefault(register, []).append(motion.line)


def _take_given(found: _MotionFindings, statement: Statement) -> None:
    """Take up that a statement gives a position a value, behind the condition of an IF or not."""
    if (given := _GIVEN.match(statement.text)) is not None:
        found.increments.setdefault(int(given[1]), make_message(_GIVEN_HERE, statement.line))


def _add_shift(found: _MotionFindings, motion: MotionStatement, shift: ProgramShift) -> None:
    found.shifts += [(number, shift) for number in motion.targets]
    found.any_shift += [shift] if motion.any_target else []


def _axes_of(registers: ComputedRegisters, *shifting: int) -> ShiftAxes:
    """Return the axes of a shift by registers: no user frame changes what joints do."""
    return ShiftAxes.BASE if registers.joints.intersection(shifting) else ShiftAxes.USER_FRAME


def _touch_offset(statement: Statement, region: bool) -> bool:
    text = b" ".join(statement.text.split()).upper()
    if text.startswith(b"TOUCH OFFSET"):
        return not text.startswith(b"TOUCH OFFSET END")
    return region


def _take_targets(found: _MotionFindings, motion: MotionStatement) -> None:
    why, condition = _why_no_place(motion), _condition_of_motion(motion)
    for number in motion.targets:
        if condition is not None:
            found.needs[number] = condition.joined_with(found.needs.get(number))
        elif why:
            found.increments.setdefault(number, why)
        else:
            found.places.add(number)
    if motion.any_target and why:
        word = motion.relative or motion.led or motion.standing_tool or motion.camera
        found.any_increment = found.any_increment or make_message(_ANY_INCREMENT, motion.line, word)
    found.amounts.update(motion.shifting)
    if motion.offset or motion.tool_offset or (why and motion.register_targets):
        found.by_register.append(motion)
    for number in motion.register_targets:
        if why:
            found.amounts.add(number)
        else:
            found.goes_to.setdefault(number, motion.line)


def _why_no_place(motion: MotionStatement) -> str:
    for word, text in (
        (motion.relative, _INCREMENT),
        (motion.led, _LED_MOTION),
        (motion.standing_tool, _STANDING_TOOL),
        (motion.camera, _CAMERA),
    ):
        if word:
            return make_message(text, word, motion.line)
    return ""


def _condition_of_motion(motion: MotionStatement) -> ConditionalBar | None:
    """Return what a project must state of a led motion or one at a standing tool; None where that does not help."""
    if motion.relative or motion.camera or motion.offset or motion.tool_offset:
        return None
    needs = {
        need
        for need, word in (
            (ProjectNeed.LEADER, motion.led),
            (ProjectNeed.STANDING_TOOL, motion.standing_tool),
        )
        if word
    }
    return ConditionalBar(frozenset(needs), _why_no_place(motion)) if needs else None


def _amount_reason(number: int, found: _MotionFindings, registers: ComputedRegisters) -> str:
    """Return why a position is left that no motion goes to as it stands, and that the program uses otherwise."""
    if number in found.places or number in found.needs:
        return ""
    if registers.any_position:
        return _AMOUNT
    copies = registers.copied.get(number, set())
    if number in registers.computed:
        return _AMOUNT
    last = copies - registers.passed_on
    if copies and (copies & found.amounts or copies & registers.used or not last <= found.goes_to.keys()):
        return _AMOUNT
    return ""


def _shifts_by_registers(
    found: _MotionFindings, registers: ComputedRegisters
) -> Iterator[tuple[int, ProgramShift]]:
    """Yield shifts of positions whose copy in a register is computed before a motion goes to the register."""
    for register, line in {**found.goes_to, **found.shifted}.items():
        if register in registers.altered or register in found.shifted or registers.any_altered:
            turn = None if register in registers.turned else NO_TURN
            amount = UNREADABLE if register in found.shifted else registers.added_to(register)
            axes = _axes_of(registers, register)
            for number in sorted(registers.origins.get(register, ())):
                yield (
                    number,
                    ProgramShift(line, f"PR[{register}]", axes, (), "", None, amount, turn),
                )
                yield from ((number, each) for each in _set_elements(register, registers))


def _set_elements(register: int, registers: ComputedRegisters) -> Iterator[ProgramShift]:
    """Yield the elements of a register that get a value of their own: they stay where the position changes."""
    elements = registers.set_to.get(register, set())
    if not elements:
        return
    x, y, z = (nan if each in elements else 0.0 for each in (1, 2, 3))
    turn = None if elements & {4, 5, 6} else NO_TURN
    what = ", ".join(f"PR[{register},{each}]" for each in sorted(elements))
    yield ProgramShift(
        registers.altered[register],
        what,
        ShiftAxes.USER_FRAME,
        translation_m=(x, y, z),
        quaternion=turn,
        sets=True,
    )


def _shifts_by_places(
    found: _MotionFindings, registers: ComputedRegisters
) -> Iterator[tuple[int, ProgramShift]]:
    """Yield what a motion adds or is shifted by where that is computed from positions, which themselves change."""
    for motion in found.by_register:
        added = () if motion.is_place or motion.offset else motion.register_targets
        for register in {*added, *(motion.shifting or found.conditions)}:
            origins = registers.origins.get(register, set())
            targets = set(motion.targets)
            targets |= {n for each in motion.register_targets for n in registers.origins.get(each, ())}
            for number in sorted(targets | origins) if origins else ():
                yield (
                    number,
                    ProgramShift(motion.line, f"PR[{register}]", ShiftAxes.USER_FRAME, quaternion=None),
                )


def _with_rows(
    shifts: Iterable[tuple[int, ProgramShift]], rows: dict[int, list[int]], positions: Positions
) -> Iterator[ProgramShift]:
    for number, shift in shifts:
        its = tuple(row for row in rows.get(number, ()) if _is_point(positions, row))
        if its:
            yield replace(shift, rows=its)


def _with_all_rows(shifts: Iterable[ProgramShift], positions: Positions) -> Iterator[ProgramShift]:
    every = tuple(row for row in range(len(positions)) if _is_point(positions, row))
    return (replace(shift, rows=every) for shift in shifts if every)


def _is_point(positions: Positions, row: int) -> bool:
    return positions.groups[row] == 1 and positions.kinds[row] in (CARTESIAN, JOINTS)
