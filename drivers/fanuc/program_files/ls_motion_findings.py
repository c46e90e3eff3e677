"""What the motions of a listing do: where they go as it stands, what they add, and what shifts them."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.ls_computed import (
    ComputedRegisters,
    RegisterContents,
    is_computing,
    match_assignment,
    registers_of,
)
from cellcal.drivers.fanuc.program_files.ls_statements import (
    MotionStatement,
    Statement,
    condition_of,
    motion_of,
    read_statements,
)
from cellcal.drivers.programs.conditions import ConditionalBar, ProjectNeed
from cellcal.drivers.programs.shifts import NO_TURN, UNREADABLE, ProgramShift, Quaternion, ShiftAxes, Triple

_INCREMENT = "it is an increment: {} in line {} adds it to where the robot is"
_LED_MOTION = "another motion group leads the motion there ({} in line {})"
_STANDING_TOOL = "the tool of its motion stands in the cell ({} in line {})"
CAMERA = "a camera shifts the motion there while the program runs ({} in line {})"
_ANY_INCREMENT = "a register chooses the positions of the motion in line {}, and {} makes them no places"
_GIVEN_HERE = "line {} gives it a value while the program runs"
_GIVEN_TO_ANY = "a register chooses a position that line {line} gives a value while the program runs"
_GIVEN = re.compile(  # behind the condition of an IF, too
    rb"(?:(?:IF|WENN)\b[^=;]*+[^;,]*+,[ \t]*+)?+P(?<![A-Za-z]P)\["
    rb" *+(?:(\d{1,5}+)|[A-Za-z]{1,3}+\[[^\]]*+\]) *+(?:,[^\]]*+)?+\][ \t]*+=(?!=)"
)
ANY_REGISTER = -1  # in place of a register: a number chooses it

_REGIONS: Mapping[str, tuple[Triple, Quaternion | None]] = {  # shifts of all motions until their END
    "Touch Offset": (UNREADABLE, None),
    "MP OFFSET": (UNREADABLE, NO_TURN),  # of multi-pass welding: it turns the torch, and not the place
}


@dataclass
class MotionFindings:
    """The findings so far about a listing's motions."""

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


def find_motions(
    data: bytes,
    in_joints: frozenset[int],
    turned: frozenset[int] = frozenset(),
    filled_elsewhere: frozenset[int] | None = frozenset(),
    computed_beside: frozenset[int] | None = frozenset(),
) -> MotionFindings:
    """Return what the motions of a listing do; ``in_joints`` are the positions that are held in joint angles.

    ``turned`` are the registers of which other programs set W, P or R, ``filled_elsewhere`` those that other programs
    give any value, None for any. What no file fills holds what a person or a camera entered, which may turn, too.
    ``computed_beside`` are those that programs which run beside this one may give a value at any time, None for any.
    """
    found, region, statements = MotionFindings(), "", list(read_statements(data))
    last: int | None = None
    registers = registers_of([(each, None) for each in statements if is_computing(each)], in_joints)
    not_filled = _registers_not_filled(statements, registers, filled_elsewhere)
    may_turn = registers.turned | registers.joints | turned | not_filled
    contents = RegisterContents(
        frozenset(n for each in statements for n in condition_of(each, tool=False)),
        computed_beside or frozenset(),
        certain=computed_beside is not None,
    )
    for statement in statements:
        contents.follow_statement(statement)
        if not statement.is_motion:
            region = _region_after(statement, region)
            found.conditions.update(condition_of(statement))
            _take_given(found, statement)
            if is_computing(statement):
                found.assigned.append((statement, last))
            continue
        motion = motion_of(statement)
        _take_targets(found, motion)
        _take_reached(found, motion)
        if motion.search:  # it goes along an axis of the touch sensor's frame, as far as it finds something
            _add_shift(found, motion, ProgramShift(motion.line, motion.search, ShiftAxes.USER_FRAME))
        if motion.offset or region:
            amount, quaternion = _REGIONS.get(region) or contents.shift_of_motion(motion, may_turn)
            option = "Offset" if motion.offset else region
            axes = axes_of(registers, *motion.offset_registers)
            shift = ProgramShift(motion.line, option, axes, translation_m=amount, quaternion=quaternion)
            _add_shift(found, motion, shift)
            found.shifted |= dict.fromkeys(motion.register_targets, motion.line)
        last = motion.targets[-1] if motion.targets else last
        if motion.stored:
            found.assigned.append((Statement(motion.stored, motion.line), last))
    return found


def _registers_not_filled(
    statements: Sequence[Statement], registers: ComputedRegisters, filled_elsewhere: frozenset[int] | None
) -> set[int]:
    """Return the registers that shift motions, and that neither this program nor another one fills."""
    if registers.any_altered or filled_elsewhere is None:
        return set()
    shifting = {
        register
        for statement in statements
        for register in (
            motion_of(statement).offset_registers
            if statement.is_motion
            else condition_of(statement, tool=False)
        )
    }
    filled = {int(found[1]) for each in statements if (found := match_assignment(each)) is not None}
    return shifting - filled - filled_elsewhere


def _take_reached(found: MotionFindings, motion: MotionStatement) -> None:
    """Take up which registers a motion goes to: shifted, led, by a camera, with a standing tool, or none of these."""
    some = (*motion.register_targets, *((ANY_REGISTER,) if motion.any_register else ()))
    if motion.relative:
        found.added |= dict.fromkeys(some, motion.line)
    else:
        for register in some:
            found.reached.setdefault(register, []).append(motion.line)


def _take_given(found: MotionFindings, statement: Statement) -> None:
    """Take up that a statement gives a position a value, behind the condition of an IF or not."""
    if (value_match := _GIVEN.match(statement.text)) is not None:
        if value_match[1]:
            found.increments.setdefault(int(value_match[1]), make_message(_GIVEN_HERE, statement.line))
        else:
            found.any_increment = found.any_increment or make_message(_GIVEN_TO_ANY, line=statement.line)


def _add_shift(found: MotionFindings, motion: MotionStatement, shift: ProgramShift) -> None:
    found.shifts += [(number, shift) for number in motion.targets]
    found.any_shift += [shift] if motion.any_target else []


def axes_of(registers: ComputedRegisters, *shifting: int) -> ShiftAxes:
    """Return the axes of a shift by registers: no user frame changes what joints do."""
    return ShiftAxes.BASE if registers.joints.intersection(shifting) else ShiftAxes.USER_FRAME


def _region_after(statement: Statement, region: str) -> str:
    """Return the instruction that shifts all motions from here to its END, "" for none."""
    text = " ".join(statement.text.decode("latin-1").split()).upper()
    for name in _REGIONS:
        if text.startswith(name.upper()):
            return "" if text.startswith(f"{name.upper()} END") else name
    return region


def _take_targets(found: MotionFindings, motion: MotionStatement) -> None:
    why, condition = _why_no_place(motion), _condition_of_motion(motion)
    for number in motion.targets:
        if condition is not None:
            found.needs[number] = condition.add_need(found.needs.get(number))
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
        (motion.camera, CAMERA),
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
