"""Registers that a program fills from its positions and computes with, and what they hold when that is certain."""

import re
from collections import deque
from collections.abc import Sequence, Set
from dataclasses import dataclass, field
from itertools import accumulate
from math import isnan, nan

from cellcal.drivers.fanuc.program_files.ls_statements import (
    BESIDE_WORDS,
    MotionStatement,
    Statement,
    read_statements,
)
from cellcal.drivers.programs.shifts import NO_TURN, UNREADABLE, Quaternion, Triple

_ASSIGNED = re.compile(  # an element is a number, or a register has it: PR[1,R[2]]=
    rb"PR\[ *+(?:GP *+1 *+: *+)?+(\d{1,5}+) *+(?:, *+(\d|[A-Za-z]{1,3}+\[[^\]]*+\]) *+)?+\] *+= *+(.*)",
    re.DOTALL,
)
_POSITION = re.compile(rb"P(?<![A-Za-z]P)\[ *+(\d{1,5}+)")
_REGISTER = re.compile(rb"PR(?<![A-Z]PR)\[ *+(?:GP\d *+: *+)?+(\d{1,5}+) *+\]")
_CHOSEN_REGISTER = re.compile(rb"PR(?<![A-Z]PR)\[ *+(?:GP *+1 *+: *+)?+[A-Za-z]{1,3}+\[[^=]*=")
_CHOSEN_POSITION = re.compile(rb"P(?<![A-Za-z]P)\[ *+[A-Za-z]")
_HERE = re.compile(rb"\b[LJ]P(?:OS|NT)\b")
_IN_JOINTS = re.compile(rb"\bJP(?:OS|NT)\b")
_ALONE = re.compile(rb"(?:PR?\[[^\]]*+\] *+|[LJ]P(?:OS|NT) *+(?:\([^)]*+\))?)")
_ELEMENT = re.compile(rb"PR\[ *+(?:GP *+1 *+: *+)?+(\d{1,5}+) *+, *+(\d) *+\]")
_CONDITIONAL = re.compile(rb"(?:IF|WENN)\b")
_BRACKETS = re.compile(rb"[()\[\],]")
_OTHER_PLACE = re.compile(rb"(?<![A-Za-z])PR?\[")
_NOTHING = re.compile(rb"(PR\[ *\d+ *\]|LPOS|JPOS) *- *\1")
_NUMBER = re.compile(rb"\(? *+(-?+(?:\d++(?:\.\d*+)?+|\.\d++)) *+\)?")
_BRANCHES = re.compile(
    rb"\b(?:IF|WENN|LBL|MARKE|JMP|SPRUNG|SELECT|FOR|WHILE|CALL|AUFRUF|" + BESIDE_WORDS + rb")\b"
    rb"|\A[A-Za-z]\w*+(?:[ \t]++\w++)*+\Z"  # words alone: a macro
)
ANY_PLACE, ADDED, TURNED = "PR[...]", "+", "~"
_MM = 1e-3
_ELEMENTS = range(1, 7)
_LENGTHS = 3  # elements X, Y and Z; W, P and R come after


@dataclass
class ComputedRegisters:
    """The registers that a program changes, whatever the order of its statements."""

    origins: dict[int, set[int]] = field(default_factory=dict)  # positions whose numbers a register gets
    altered: dict[int, int] = field(default_factory=dict)  # registers that are computed, and in which line
    computed: set[int] = field(default_factory=set)  # positions that an expression uses
    copied: dict[int, set[int]] = field(
        default_factory=dict
    )  # positions, and the registers that get them whole
    holding: dict[int, set[int]] = field(default_factory=dict)  # the same by register: its positions
    turned: set[int] = field(
        default_factory=set
    )  # registers whose W, P or R the program sets to other than zero
    passed_on: set[int] = field(default_factory=set)  # registers that another one gets whole
    used: set[int] = field(default_factory=set)  # registers that an expression of another one uses
    here: set[int] = field(default_factory=set)  # registers that get where the robot was before any position
    altered_whole: set[int] = field(default_factory=set)  # registers of which any element may be computed
    added: dict[int, set[int]] = field(default_factory=dict)  # elements to which something is added
    set_to: dict[int, set[int]] = field(default_factory=dict)  # elements that get a value of their own
    any_altered: int = 0  # a line in which a number chooses the register that is computed
    any_position: int = 0  # a line in which a number chooses the position that a register gets
    camera: set[int] = field(default_factory=set)  # registers that get what a camera found
    joints: set[int] = field(default_factory=set)  # registers that may hold joints: their elements are angles

    def count_of(self, register: int) -> tuple[int, ...]:
        """Return how much is found of a register so far."""
        of_sets = (self.origins, self.holding, self.added, self.set_to)
        in_sets = (self.altered, self.turned, self.camera, self.joints, self.here, self.altered_whole)
        return (
            *(len(each.get(register, ())) for each in of_sets),
            *(int(register in each) for each in in_sets),
        )

    def read_addition(self, register: int) -> Triple:
        """Return what is added to a register that holds a position: zero, or not readable."""
        if register in self.altered_whole or self.any_altered:
            return UNREADABLE
        x, y, z = (nan if each in self.added.get(register, ()) else 0.0 for each in (1, 2, 3))
        return x, y, z


def registers_of(
    assigned: Sequence[tuple[Statement, int | None]], joint_positions: Set[int] = frozenset()
) -> ComputedRegisters:
    """Return what assignments do; each comes with the position that the program went to last above it.

    ``joint_positions`` are those that the listing holds in joint angles.
    """
    found = ComputedRegisters()
    matches = [match_assignment(statement) for statement, _ in assigned]
    readers = _readers_of(matches)
    waiting = deque(range(len(assigned)))
    queued = set(waiting)
    while waiting:  # a register may get another one's that is assigned below
        at = waiting.popleft()
        queued.discard(at)
        (statement, last), match = assigned[at], matches[at]
        number = int(match[1]) if match is not None else -1
        before = found.count_of(number)
        _take_chosen(found, statement, certain=match is not None)
        if match is not None and match[2]:
            _assign_element(found, match, statement.line)
        elif match is not None:
            _note_joints(found, match, joint_positions)
            _assign_whole(found, match, statement.line, last)
        if found.count_of(number) != before:
            again = [each for each in readers.get(number, ()) if each not in queued]
            queued.update(again)
            waiting.extend(again)
    found.turned |= found.joints & found.altered.keys()  # a joint that is added to turns the tip
    return found


def _readers_of(matches: Sequence[re.Match[bytes] | None]) -> dict[int, list[int]]:
    """Return by register the assignments of a whole value that name it."""
    found: dict[int, list[int]] = {}
    for at, match in enumerate(matches):
        if match is not None and not match[2]:
            for register in places_named(match[3])[1]:
                found.setdefault(register, []).append(at)
    return found


def _note_joints(found: ComputedRegisters, match: re.Match[bytes], joint_positions: Set[int]) -> None:
    """Take up that a register gets joints: from where the robot stands, a position or another register."""
    positions, registers = places_named(match[3])
    if _IN_JOINTS.search(match[3]) or positions & joint_positions or registers & found.joints:
        found.joints.add(int(match[1]))


def computed_places(data: bytes) -> frozenset[str]:
    """Return the registers that a program computes: PR[n], PR[n]+ where it only adds lengths, PR[...] for any.

    PR[n]~ stands beside it where W, P or R get a value.
    """
    if b"PR[" not in data.upper():
        return frozenset()
    found = registers_of([(each, None) for each in read_statements(data) if is_computing(each)])
    more_than_added = found.altered_whole | found.set_to.keys() | found.turned
    names = {f"PR[{number}]{'' if number in more_than_added else ADDED}" for number in found.altered}
    names |= {f"PR[{number}]{TURNED}" for number in found.turned}
    return frozenset(names | ({ANY_PLACE} if found.any_altered else set()))


def is_computing(statement: Statement) -> bool:
    """Return whether a statement that is no motion gives a value to a position register, or uses a position."""
    return any(
        pattern.search(statement.text)
        for pattern in (_ASSIGNED, _CHOSEN_REGISTER, _POSITION, _CHOSEN_POSITION)
    )


def _take_chosen(found: ComputedRegisters, statement: Statement, *, certain: bool) -> None:
    """Take up what a number chooses, and positions in statements that are not understood."""
    if _CHOSEN_POSITION.search(statement.text):
        found.any_position = found.any_position or statement.line
    if not certain:
        found.computed |= {int(each) for each in _POSITION.findall(statement.text)}
        if _CHOSEN_REGISTER.search(statement.text):
            found.any_altered = found.any_altered or statement.line


def _assign_element(found: ComputedRegisters, match: re.Match[bytes], line: int) -> None:
    number, value = int(match[1]), without_brackets(match[3])
    found.altered.setdefault(number, line)
    found.computed |= {int(each) for each in _POSITION.findall(value)}
    if not match[2].isdigit():  # a register chooses the element: any of them, with any value
        found.altered_whole.add(number)
        found.turned.add(number)
        if match[2].join((b",", b"]")) not in value.replace(b" ", b""):  # and not one that is added to
            found.set_to.setdefault(number, set()).update(_ELEMENTS)
        return
    element = int(match[2])
    adds = _adds_to(value, number, element)
    (found.added if adds else found.set_to).setdefault(number, set()).add(element)
    constant = _NUMBER.fullmatch(value)
    if element > _LENGTHS and (constant is None or float(constant[1])):
        found.turned.add(number)


def match_assignment(statement: Statement) -> re.Match[bytes] | None:
    """Return register, element and value that a statement assigns; behind the condition of an IF."""
    start = 0
    if _CONDITIONAL.match(statement.text):
        depth = 0
        for found in _BRACKETS.finditer(statement.text):
            depth += (found[0] in b"([") - (found[0] in b")]")
            if not depth and found[0] == b",":
                start = found.end()
                break
    return _ASSIGNED.search(statement.text, start)


def places_named(value: bytes) -> tuple[set[int], set[int]]:
    """Return the positions and the whole registers that an expression names."""
    return {int(each) for each in _POSITION.findall(value)}, {int(each) for each in _REGISTER.findall(value)}


def without_brackets(value: bytes) -> bytes:
    """Return an expression without brackets around all of it: mixed logic writes ``PR[1,3]=(PR[1,3]+50)``."""
    value = value.strip()
    while value.startswith(b"(") and value.endswith(b")"):
        depths = list(accumulate((sign == ord("(")) - (sign == ord(")")) for sign in value))
        if 0 in depths[:-1]:
            break
        value = value[1:-1].strip()
    return value


def _adds_to(value: bytes, number: int, element: int) -> bool:
    """Return whether an expression is an element of a register and something that is added to it."""
    for itself in _ELEMENT.finditer(value):
        before, after = value[: itself.start()].rstrip(), value[itself.end() :].lstrip()
        is_term = before[-1:] in (b"", b"+") and after[:1] in (b"", b"+", b"-")
        outside = before.count(b"(") == before.count(b")")
        if is_term and outside and (int(itself[1]), int(itself[2])) == (number, element):
            return (before + after).strip(b"+") != b"" and not _OTHER_PLACE.search(before + after)
    return False


def _assign_whole(found: ComputedRegisters, match: re.Match[bytes], line: int, last: int | None) -> None:
    number, value = int(match[1]), without_brackets(match[3])
    if _NOTHING.fullmatch(value):
        return
    positions, registers = places_named(value)
    origins = found.origins.setdefault(number, set())
    origins |= positions | {n for each in registers for n in found.origins.get(each, ())}
    if _HERE.search(value) and last is not None:
        origins.add(last)
    found.here |= {number} if (_HERE.search(value) and last is None) or registers & found.here else set()
    found.turned |= {number} if registers & found.turned else set()
    found.camera |= {number} if b"VR[" in value or registers & found.camera else set()
    if _ALONE.fullmatch(value) is not None:
        found.passed_on |= registers - {number}
        copied = positions.union(*(found.holding.get(each, ()) for each in registers))
        found.holding.setdefault(number, set()).update(copied)
        for each in copied:
            found.copied.setdefault(each, set()).add(number)
        if registers & found.altered.keys():
            found.altered.setdefault(number, line)
            found.altered_whole |= {number} if registers & found.altered_whole else set()
            for elements in (found.added, found.set_to):
                of_others = {element for each in registers for element in elements.get(each, ())}
                if of_others:
                    elements.setdefault(number, set()).update(of_others)
    else:
        found.used |= registers - {number}
        found.altered.setdefault(number, line)
        found.altered_whole.add(number)
        found.computed |= positions


@dataclass
class RegisterContents:
    """The contents of registers while a program without branches and calls runs from its first line."""

    conditions: frozenset[int] = frozenset()  # registers that shift motions which name none
    beside: frozenset[int] = frozenset()  # registers that get a value at any time
    certain: bool = True
    elements: dict[tuple[int, int], float] = field(default_factory=dict)

    def follow_statement(self, statement: Statement) -> None:
        """Take up a statement."""
        if _BRANCHES.search(statement.text) or _CHOSEN_REGISTER.search(statement.text):
            self.certain = False
        match = match_assignment(statement)
        if match is None:
            return
        number, element, value = int(match[1]), match[2], without_brackets(match[3])
        if element is None:
            nothing = _NOTHING.fullmatch(value) is not None
            for each in range(1, 7):
                self.elements[number, each] = 0.0 if nothing else nan
            return
        constant = _NUMBER.fullmatch(value)
        if not element.isdigit():
            self.certain = False
        else:
            self.elements[number, int(element)] = float(constant[1]) if constant else nan

    def shift_of_motion(self, motion: MotionStatement, turned: set[int]) -> tuple[Triple, Quaternion | None]:
        """Return the shift of a motion; NaN and None where it is not certain."""
        registers = motion.offset_registers
        shifting = set(registers or self.conditions)
        quaternion = NO_TURN if shifting and not turned & shifting else None  # of any register: it may turn
        if not self.certain or len(registers) != 1 or registers[0] in self.beside:
            return UNREADABLE, quaternion
        x, y, z = (self._length_m(registers[0], each) for each in (1, 2, 3))
        return (x, y, z), quaternion

    def _length_m(self, register: int, element: int) -> float:
        value = self.elements.get((register, element), nan)
        return nan if isnan(value) else value * _MM  # one nan, so that equal shifts are equal
