"""Listings of TP programs: their lines as instructions, for exactly the instructions that CELLCAL and CELLCAL_BG use.

Imitates
    The translation of an ASCII listing (.LS) on a FANUC controller.
Source
    deploy/controller_setup/fanuc_tp.md, "Instructions that the programs use".
Modelled
    Remarks, labels, jumps, WAIT for a comparison or a time, assignments, IF with a jump or an assignment, joint
    motion to a position register with its speed in a register and Skip, selection of tool and frame.
Not modelled
    Every other instruction: a listing with it is not accepted.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cellcal.fake_devices.tp_programs.expressions import (
    Expression,
    TpSyntaxError,
    compile_expression,
    compile_item,
    parse_item,
)

_LINE = re.compile(r"\s*(\d+):(.*?);\s*\Z")
_LABEL = re.compile(r"LBL\[(\d+)(?::[^\]]*)?\]\Z")
_JUMP = re.compile(r"JMP\s+LBL\[(\d+)\]\Z")
_COMPARED = re.compile(r"(.+?)(<>|<=|>=|=|<|>)(.+)\Z")
_TIME = re.compile(r"WAIT\s+(\d*\.?\d+)\(sec\)\Z")
_MOVE = re.compile(r"J\s+PR\[(\d+)\]\s+R\[(\d+)\]%\s+FINE\s+Skip,LBL\[(\d+)\]\Z")
_SKIP = re.compile(r"SKIP\s+CONDITION\s+F\[(\d+)\]=ON\Z")


@dataclass(frozen=True)
class Assignment:
    """Put a value into a register, a flag, an element of a position register, or the number of tool or frame."""

    kind: str  # R, F, PR, UTOOL_NUM, UFRAME_NUM
    number: int
    element: Expression | None
    value: Expression


@dataclass(frozen=True)
class PresentPosition:
    """``PR[n]=JPOS``."""

    number: int


@dataclass(frozen=True)
class Jump:
    """``JMP LBL[n]``."""

    label: int


@dataclass(frozen=True)
class ConditionalStep:
    """``IF …,`` an assignment or a jump."""

    holds: Expression
    then: "Assignment | Jump"


@dataclass(frozen=True)
class WaitUntil:
    """``WAIT`` for a comparison."""

    holds: Expression


@dataclass(frozen=True)
class WaitTime:
    """``WAIT`` for seconds."""

    seconds: float


@dataclass(frozen=True)
class SkipCondition:
    """``SKIP CONDITION F[n]=ON``."""

    flag: int


@dataclass(frozen=True)
class JointMotion:
    """``J PR[n] R[m]% FINE Skip,LBL[k]``: to the label when it arrived, to the next line where it was skipped."""

    position: int
    speed: int
    label: int


Instruction = (
    Assignment
    | PresentPosition
    | Jump
    | ConditionalStep
    | WaitUntil
    | WaitTime
    | SkipCondition
    | JointMotion
    | None
)


@dataclass(frozen=True)
class TpListing:
    """A program: instructions in their order; labels as indices. ``has_group``: it may move group 1."""

    name: str
    has_group: bool
    instructions: tuple[Instruction, ...]
    labels: dict[int, int]


_FIXED: dict[re.Pattern[str], Callable[[re.Match[str]], Instruction]] = {
    _MOVE: lambda found: JointMotion(int(found[1]), int(found[2]), int(found[3])),
    _SKIP: lambda found: SkipCondition(int(found[1])),
    _TIME: lambda found: WaitTime(float(found[1])),
    _JUMP: lambda found: Jump(int(found[1])),
}


def read_listing(path: Path) -> TpListing:
    """Read a listing.

    Raises
    ------
    TpSyntaxError
        A line is not one of the instructions that are modelled, or a label is missing.
    """
    return parse_listing(path.read_text(encoding="cp437"))


def parse_listing(text: str) -> TpListing:
    """Read the text of a listing."""
    head, _, rest = text.replace("\r\n", "\n").partition("\n/MN\n")
    body = rest.partition("\n/POS")[0]
    name = re.search(r"/PROG\s+(\S+)", head)
    group = re.search(r"DEFAULT_GROUP\s*=\s*([1*]),", head)
    if name is None or group is None:
        raise TpSyntaxError("a listing needs /PROG, DEFAULT_GROUP and /MN")
    instructions: list[Instruction] = []
    labels: dict[int, int] = {}
    for number, line in enumerate(body.split("\n"), 1):
        found = _LINE.match(line)
        if found is None or int(found[1]) != number:
            raise TpSyntaxError(f"{name[1]}: {line!r} is not line {number}")
        statement = found[2].strip()
        label = _LABEL.match(statement)
        if label is not None:
            labels[int(label[1])] = len(instructions)
        instructions.append(
            None if label or not statement or statement.startswith("!") else _parse(statement)
        )
    listing = TpListing(name[1], group[1] == "1", tuple(instructions), labels)
    _refuse_missing_labels(listing)
    return listing


def _parse(statement: str) -> Instruction:
    for pattern, make in _FIXED.items():
        if (found := pattern.match(statement)) is not None:
            return make(found)
    if statement.startswith("WAIT "):
        return WaitUntil(_parse_comparison(statement[5:]))
    if statement.startswith("IF "):
        condition, _, action = _split_action(statement[3:])
        then = _parse(action)
        if not isinstance(then, Assignment | Jump):
            raise TpSyntaxError(f"{statement!r}: only a jump or an assignment may follow")
        return ConditionalStep(condition, then)
    return _parse_assignment(statement)


def _split_action(text: str) -> tuple[Expression, str, str]:
    """Split ``<condition>,<action>``; a condition in brackets is mixed logic, else one comparison."""
    depth = 0
    for at, letter in enumerate(text):
        depth += (letter in "([") - (letter in ")]")
        if letter == "," and depth == 0:
            condition, action = text[:at].strip(), text[at + 1 :].strip()
            mixed = condition.startswith("(") and condition.endswith(")")
            return (compile_expression(condition) if mixed else _parse_comparison(condition)), ",", action
    raise TpSyntaxError(f"IF {text!r} has no action")


def _parse_comparison(text: str) -> Expression:
    if _COMPARED.match(text.strip()) is None or any(mark in text for mark in ("(", "$", "!")):
        raise TpSyntaxError(f"{text!r} is no comparison; mixed logic stands in brackets")
    return compile_expression(text)


def _parse_assignment(statement: str) -> Instruction:
    target, sign, value = (part.strip() for part in statement.partition("="))
    if not sign:
        raise TpSyntaxError(f"{statement!r} is not one of the instructions of this simulator")
    if target in ("UTOOL_NUM", "UFRAME_NUM"):
        return Assignment(target, 0, None, compile_item(value))
    kind, number, element = parse_item(target)
    if kind == "PR" and element is None:
        if value != "JPOS":
            raise TpSyntaxError(f"{statement!r}: only JPOS is put into a whole position register")
        return PresentPosition(number)
    if kind == "UO":
        raise TpSyntaxError(f"{statement!r}: an output of the controller is not written")
    return Assignment(kind, number, element, compile_expression(value))


def _refuse_missing_labels(listing: TpListing) -> None:
    used = set()
    for instruction in listing.instructions:
        then = instruction.then if isinstance(instruction, ConditionalStep) else instruction
        if isinstance(then, Jump | JointMotion):
            used.add(then.label)
    missing = sorted(used - listing.labels.keys())
    if missing:
        raise TpSyntaxError(f"{listing.name}: there is no label {missing}")
