"""What the motions of a program do to its positions: increments, led motions and shifts, row by row."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import nan

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_computed import (
    ANY_PLACE,
    TURNED,
    ComputedRegisters,
    registers_of,
)
from cellcal.drivers.fanuc.program_files.ls_copied_frames import START, copies_in_other_frames
from cellcal.drivers.fanuc.program_files.ls_motion_findings import (
    ANY_REGISTER,
    CAMERA,
    MotionFindings,
    axes_of,
    find_motions,
)
from cellcal.drivers.fanuc.program_files.ls_positions import REMOTE
from cellcal.drivers.fanuc.program_files.ls_registers import frames_in_force
from cellcal.drivers.fanuc.program_files.ls_shared_registers import shifts_by_other_programs
from cellcal.drivers.fanuc.program_files.ls_statements import (
    read_statements,
)
from cellcal.drivers.programs.file_declarations import ExternalUses
from cellcal.drivers.programs.guided_motions import guided_motion
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, Positions
from cellcal.drivers.programs.shifts import NO_TURN, UNREADABLE, ProgramShift, ShiftAxes

_AMOUNT = "the program computes with it and does not go there, so it may be a shift"
_WRITTEN_REMOTE = (
    "it is written with RX to RR, for a tool that stands in the cell; the listing does not say where"
)
_GIVES = re.compile(rb"(?<![A-Z])P\[(?:[^\[\]\n]|\[[^\[\]\n]{0,40}+\]){1,40}+\][ \t]*+=(?!=)")
_WORDS = (
    b"INC",
    b"COORD",
    b"RTCP",
    b"VR[",
    b"OFFSET",
    b"PR[",
    b"PAL_",
    b"SEARCH",
    b"IBGN",
    b"TRACK",
    b"FORCE",
)
_REST = (  # "home", "Home1", "HomePos", "GoHome", "Grundstellung" as words; not "SPARK", "PARKETT" or "HomeBin"
    rb"(?<![a-z\x80-\xff])(?:(?:go|rob|robot)?(?:home|perch|park)|parken|parking|grund|ruhe)"
    rb"(?:pos|posn|position|point|pkt|punkt|platz|st|stlg|stellung|lage)?(?![a-z\x80-\xff])"
)
_HOME = re.compile(  # the robot's own resting posture, which no work moves, where its comment says so
    rb"\bJ[ \t]++PR\[ *+(\d{1,5}+) *+:[^\]\n]*?" + _REST, re.IGNORECASE
)
_STRAIGHT = re.compile(rb"\b[LCAS][ \t]++PR\[ *+(\d{1,5}+)", re.IGNORECASE)
_CARRY = "Carry it with `cellcal program registers`, or teach it there."
_GUIDED = re.compile(  # motion that is streamed, and the path modified by what another device sends
    rb"(?:IBGN[ \t]++START|TRACK[ \t]++DPM)\b", re.IGNORECASE
)
_FORCE = re.compile(
    rb"FORCE[ \t]++CTRL\b", re.IGNORECASE
)  # it presses and searches along the axes of a frame
_TO_PALLET = re.compile(
    rb"[JLCAS][ \t]++(PAL_\d++\[[^\]]{0,20}+\])"
)  # its places are no positions of the listing


def with_motions(positions: Positions, data: bytes, external_uses: ExternalUses | None = None) -> Positions:
    """Return positions with those barred that are no places, and with the shifts of their motions.

    ``external_uses`` is what the controller's other programs do with its registers; None: they are not known.
    """
    upper = data.upper()
    if not (any(word in upper for word in _WORDS) or _GIVES.search(upper, 0, max(upper.rfind(b"/POS"), 0))):
        # as in nearly all
        return positions
    in_joints = _positions_in_joints(positions)
    found = find_motions(
        data,
        in_joints,
        _turned_elsewhere(external_uses),
        _filled_elsewhere(external_uses),
        _computed_beside(external_uses),
    )
    registers = registers_of(found.assigned, in_joints)
    found.amounts |= found.conditions
    for motion in found.by_register:
        if registers.camera & set(motion.shifting or found.conditions):
            why = make_message(CAMERA, "Offset", motion.line)
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
        *_guided_motions(data),
        *_added_registers(found, registers),
        *_absent_places(data, frames, found, registers),
        *_with_rows(shifts, rows, positions),
        *_with_all_rows(found.any_shift, positions),
    ]
    return replace(positions, barred=barred, conditions=conditions, shifts=(*positions.shifts, *all_shifts))


def _turned_elsewhere(external_uses: ExternalUses | None) -> frozenset[int]:
    """Return the registers whose W, P or R other programs of the controller set."""
    computed = {} if external_uses is None else external_uses.computed
    return frozenset(int(each[3:-2]) for each in computed if each.endswith(TURNED))


def _filled_elsewhere(external_uses: ExternalUses | None) -> frozenset[int] | None:
    """Return the registers that other programs of the controller give a value; None where it may be any."""
    return _registers_named({} if external_uses is None else external_uses.computed)


def _computed_beside(external_uses: ExternalUses | None) -> frozenset[int] | None:
    """Return the registers to which what runs beside the program gives a value; None where it may be any."""
    if external_uses is None:
        return frozenset()
    return None if external_uses.running else _registers_named(external_uses.computed_beside)


def _registers_named(places: Collection[str]) -> frozenset[int] | None:
    """Return the registers among global places; None where one is any."""
    if ANY_PLACE in places:
        return None
    return frozenset(int(each[3:].partition("]")[0]) for each in places)


def _pallet_places(data: bytes) -> Iterator[ProgramShift]:
    """Yield the motions to a pallet: its pattern sets the place, and stays as it was taught."""
    visited: set[bytes] = set()
    for statement in read_statements(data):
        found = _TO_PALLET.match(statement.text)
        if found is not None and found[1] not in visited:
            visited.add(found[1])
            place = found[1].decode("cp437")
            yield ProgramShift(
                statement.line, "PALLETIZING", ShiftAxes.USER_FRAME, point=place, quaternion=None, sets=True
            )


def _guided_motions(data: bytes) -> Iterator[ProgramShift]:
    """Yield what moves the robot by sensors and other computers, and by forces."""
    for statement in read_statements(data):
        guided, pressed = _GUIDED.match(statement.text), _FORCE.match(statement.text)
        if guided is not None:
            yield guided_motion(statement.line, guided[0].decode("cp437"))
        elif pressed is not None:
            what = pressed[0].decode("cp437")
            yield ProgramShift(statement.line, what, ShiftAxes.USER_FRAME, point="a computed place")


def _added_registers(found: MotionFindings, registers: ComputedRegisters) -> Iterator[ProgramShift]:
    """Yield the motions by an increment in a register, which stays along the axes of its user frame."""
    for register, line in found.added.items():
        point, axes = _register_name(register), axes_of(registers, register)
        yield ProgramShift(line, "INC", axes, point=point, translation_m=UNREADABLE, quaternion=NO_TURN)


def _register_name(register: int) -> str:
    return f"PR[{register}]" if register != ANY_REGISTER else "PR[R[...]]"


def _absent_places(
    data: bytes, frames: Mapping[int, str | None], found: MotionFindings, registers: ComputedRegisters
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
    frames: Mapping[int, str | None], found: MotionFindings, registers: ComputedRegisters
) -> Iterator[ProgramShift]:
    """Yield what is added to, or set in, registers that got where the robot was before any position."""
    places = [
        (each, frame, line)
        for each, lines in found.reached.items()
        if each in registers.here
        for frame, line in _first_lines(lines, frames).items()
    ]
    for each, frame, line in places:
        point = f"PR[{each}]"
        if each in registers.altered or each in found.shifted:
            yield ProgramShift(
                line,
                point,
                axes_of(registers, each),
                point=point,
                user_frame=frame,
                translation_m=UNREADABLE if each in found.shifted else registers.read_addition(each),
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


def _amount_reason(number: int, found: MotionFindings, registers: ComputedRegisters) -> str:
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
    found: MotionFindings, registers: ComputedRegisters
) -> Iterator[tuple[int, ProgramShift]]:
    """Yield shifts of positions whose copy in a register is computed before a motion goes to the register."""
    for register, line in {**found.goes_to, **found.shifted}.items():
        if register in registers.altered or register in found.shifted or registers.any_altered:
            turn = None if register in registers.turned else NO_TURN
            amount = UNREADABLE if register in found.shifted else registers.read_addition(register)
            axes = axes_of(registers, register)
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
    found: MotionFindings, registers: ComputedRegisters
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
