"""RAPID's moving instructions: their targets, and the tool and work object that they name."""

import re
from dataclasses import dataclass
from math import nan

from cellcal.calibration.geometry import Pose
from cellcal.drivers.abb.program_files.literals import (
    AGGREGATES,
    NAME,
    NAMED_ARGUMENT,
    NOT_CODE,
    AggregateError,
    W,
    after_blanks,
    decode_name,
)
from cellcal.drivers.abb.program_files.written_frames import written_work_object
from cellcal.drivers.programs.shifts import UNREADABLE
from cellcal.drivers.programs.spans import ProgramText

# Where the tool stands, from the end of the arguments that are not optional.
_LAST = "movel movej movec moveabsj triggl triggj triggc triggabsj arcl arcc arclstart arclend arcl1 arcl2 arccstart"
_LAST += " arcmovel arcmovej arcmovec arcmoveabsj contactl fcpressl fcpressc search_1d search_part"
_LAST += " trigglios triggjios egmmovel egmmovec fcpress1lstart fcpressend nutl nutj"
_LAST += " arccend arcc1 arcc2 spotl spotj spotml spotmj searchl searchc displ dispc paintl paintc capl capc"
MOVES = {
    **dict.fromkeys(_LAST.split(), -1),
    **dict.fromkeys(("movelsync", "movejsync", "movecsync"), -2),
    **{f"move{way}{signal}": -3 for way in "ljc" for signal in ("do", "ao", "go")},
}

# What moves the robot to no target: where a sensor or another computer sends it, or where a force lets it go.
GUIDES = frozenset(("egmrunpose", "egmrunjoint"))
FORCE_REFERENCES = frozenset(
    ("fcrefforce", "fcreftorque", "fcrefline", "fcrefrot", "fcrefcircle", "fcrefspiral")
)
EXTENDED_MOVE = "moveextj"  # of all external axes, by themselves
TURNS_AXES = frozenset(
    ("indamove", "indrmove", "inddmove", "indcmove", EXTENDED_MOVE)
)  # one by itself, or all

_ARGUMENT = re.compile(rf'{NOT_CODE}|[\[\](){{}},;]|[^\[\](){{}},;!"]++')
_HEAD = re.compile(rf"{W}({NAME}){W}(?:\{{([^{{}}]*+)\}})?+{W}(\()?+", re.ASCII)
_PLAIN = re.compile(rf"{W}({NAME}){W}(?=\\|\Z)", re.ASCII)
_OPTION = re.compile(  # of a whole instruction: brackets and what is in quotes or a comment are stepped over
    rf"{NOT_CODE}|[\[({{]|[\])}}]|(?P<work_object>"
    rf"\\{W}WObj\b{W}(?::={W}(?:(?P<named>{NAME}){W}(?=[\\,;])|(?P<numbers>(?=\[))))?+)",
    re.ASCII | re.IGNORECASE,
)
_NEXT_STATEMENT = re.compile(
    r"\n[ \t\r]*+(?:Move[LJC]|MoveAbsJ|END(?:PROC|FUNC|TRAP|MODULE|IF|FOR|WHILE))\b", re.IGNORECASE
)
_LENGTH = re.compile(rf"{W}([+-]?{W}(?:\d++(?:\.\d*+)?+|\.\d++)(?:[eE][+-]?\d++)?+){W}", re.ASCII)
_INDEX = re.compile(r"\d+(?:,\d+)*")

_CIRCLE = re.compile(r"(?:move|trigg|arc|arcmove|disp|paint|cap|fcpress)c")
_PLACES_OF_SEARCH = {  # behind the signal: what is found, a point of the circle, where the search ends
    "searchl": range(1, 3),
    "searchj": range(1, 3),
    "searchc": range(1, 4),
    "search_1d": range(1, 3),  # behind the result: where the search starts, and where it ends
    "search_part": range(1, 3),
    "egmmovel": range(1, 2),  # behind the process
    "egmmovec": range(1, 3),
}
FINDS = frozenset(("searchl", "searchj", "searchc"))  # the first target gets what was found
_MANY_SIGNS = re.compile(r'[\[({"!]')
_MOST_ARGUMENTS = 40
_SHIFTED = ("offset", "This target is shifted while the program runs.")
COMPUTED = ("computed", "The target of this move is computed.")
BROKEN = ("computed", "A coordinate of this target is no number; it is not read.")
STAR = ("computed", "The target of this move is '*': its coordinates are not in the file.")


@dataclass(frozen=True, slots=True)
class MoveTarget:
    """The target of a move: a name, numbers, or something that is only known while the program runs."""

    place: int
    name: str = ""
    literal: re.Match[str] | None = None
    axes: bool = False
    remark: tuple[str, str] | None = None
    offset_m: tuple[float, float, float] | None = None  # of Offs; NaN for what is computed


@dataclass(frozen=True, slots=True)
class MoveInstruction:
    """A move; tool and frame are None where they are not a plain name."""

    word: str
    targets: tuple[MoveTarget, ...]
    tool: str | None
    frame: str | None
    end: int  # after its semicolon
    frame_pose: Pose | None = None  # of a work object that it writes out


@dataclass(frozen=True, slots=True)
class MoveArgument:
    """One argument, and the numbers that it is where it is a target."""

    start: int
    end: int
    literal: re.Match[str] | None = None


def read_instruction(source: ProgramText, word: str, place: int) -> MoveInstruction:
    """Read a move whose arguments begin at a place.

    Raises
    ------
    ProgramFileError
        A target is not understood, or the instruction does not end.
    """
    arguments, end = _split_arguments(source, place, axes=_is_axis_move(word))
    arguments = [_without_name(source, argument, axes=_is_axis_move(word)) for argument in arguments]
    plain = [argument for argument in arguments if source.text[argument.start : argument.start + 1] != "\\"]
    plain_names = [argument for argument in plain if argument.literal is None]
    frame, named_at, pose = _work_object(source.text, place, end)
    with_frame = [argument for argument in plain_names if argument.start <= named_at < argument.end]
    of_tool = with_frame or plain_names[MOVES[word] :][:1] if len(plain_names) >= -MOVES[word] else []
    tool = _plain_name(source.text, of_tool[0]) if of_tool else None
    named = _PLACES_OF_SEARCH.get(word, range(2 if _CIRCLE.match(word) else 1))
    targets = tuple(
        target
        for k, argument in enumerate(plain)
        if (k in named or argument.literal is not None)
        and (target := _target_of(source, word, k, argument)) is not None
    )
    return MoveInstruction(word, targets, tool, frame, end, pose)


def _without_name(source: ProgramText, argument: MoveArgument, *, axes: bool) -> MoveArgument:
    """Return an argument without the name of the parameter that it is for."""
    if ":=" not in source.text[argument.start : argument.end]:
        return argument
    named = NAMED_ARGUMENT.match(source.text[argument.start : argument.end])
    if named is None:
        return argument
    start = argument.start + named.end()
    return MoveArgument(start, argument.end, _match_literal(source, start, axes=axes))


def _is_axis_move(word: str) -> bool:
    return word in ("moveabsj", "triggabsj", "arcmoveabsj")


def _split_arguments(source: ProgramText, place: int, *, axes: bool) -> tuple[list[MoveArgument], int]:
    """Cut the text up to the semicolon at its outer commas; targets in numbers are matched whole."""
    text, begin, depth = source.text, place, 0
    end = text.find(";", place)
    if end >= 0 and _MANY_SIGNS.search(text, place, end) is None:
        return _plain_arguments(source, place, end), end + 1
    arguments: list[MoveArgument] = []
    place = start = after_blanks(text, place)
    literal = _match_literal(source, place, axes=axes)
    while True:
        place = literal.end() if literal is not None and place == start else place
        token = _ARGUMENT.match(text, place)
        if token is None or (depth <= 0 and token[0] in ",;"):
            arguments.append(MoveArgument(start, place, literal))
            if token is None or token[0] == ";":
                break
            place = start = after_blanks(text, token.end())
            literal = _match_literal(source, place, axes=axes)
            if len(arguments) > _MOST_ARGUMENTS:
                break
            continue
        depth += (token[0] in "[({") - (token[0] in "])}")
        place = token.end()
    end = place + (token is not None)
    missing = _NEXT_STATEMENT.search(text, begin, end)
    if token is None or missing is not None or len(arguments) > _MOST_ARGUMENTS:
        raise source.error_at(begin, "this instruction does not end with ';'.")
    return arguments, end


def _plain_arguments(source: ProgramText, place: int, end: int) -> list[MoveArgument]:
    """Cut arguments without brackets, strings and comments at their commas."""
    text = source.text
    if text.count(",", place, end) >= _MOST_ARGUMENTS or _NEXT_STATEMENT.search(text, place, end):
        raise source.error_at(place, "this instruction does not end with ';'.")
    arguments: list[MoveArgument] = []
    while place <= end:
        comma = text.find(",", place, end)
        stop = end if comma < 0 else comma
        arguments.append(MoveArgument(after_blanks(text, place), stop))
        place = stop + 1
    return arguments


def _match_literal(source: ProgramText, place: int, *, axes: bool) -> re.Match[str] | None:
    """Return the target in numbers that an argument is, or None.

    Raises
    ------
    ProgramFileError
        It is one, but not understood.
    """
    if source.text[place : place + 1] != "[":
        return None
    kind = "jointtarget" if axes else "robtarget"
    try:
        return AGGREGATES[kind].match_at(source.text, place)
    except AggregateError as error:
        second = after_blanks(source.text, place + 1)
        if error.computed or error.broken or source.text[second : second + 1] != "[":
            return None  # a speed or zone in numbers, or a target that is computed or broken
        raise source.error_at(error.place, str(error), remedy="Correct it on the controller.") from None


def _work_object(text: str, place: int, end: int) -> tuple[str | None, int, Pose | None]:
    """Return the work object of an instruction, where it is named (-1 for none: wobj0), and its pose if written out.

    Its name is None where it is computed.
    """
    if text.find("\\", place, end) < 0:
        return "wobj0", -1, None
    depth = 0
    for found in _OPTION.finditer(text, place, end):
        if found["work_object"] and not depth:
            if found["named"]:
                return decode_name(found["named"]), found.start(), None
            has_numbers = found["numbers"] is not None
            name, pose = written_work_object(text, found.end()) if has_numbers else (None, None)
            return name, found.start(), pose
        depth += (found[0] in ("[", "(", "{")) - (found[0] in ("]", ")", "}"))
    return "wobj0", -1, None


def _plain_name(text: str, argument: MoveArgument) -> str | None:
    """Return the name that an argument is, its own options left out; None for an element, a component, a call."""
    found = _PLAIN.match(text, argument.start, argument.end)
    return decode_name(found[1]) if found else None


def _target_of(source: ProgramText, word: str, k: int, argument: MoveArgument) -> MoveTarget | None:
    """Return what an argument moves to; None for a speed, a zone, a tool."""
    if argument.literal is not None:
        return MoveTarget(argument.start, literal=argument.literal, axes=_is_axis_move(word))
    head = _HEAD.match(source.text, argument.start, argument.end)
    first = k == 0 and word not in _PLACES_OF_SEARCH
    if head is None:
        sign = source.text[argument.start : argument.start + 1]
        star = STAR if sign == "*" else COMPUTED
        if sign == "[" and AGGREGATES["robtarget"].error_at(source.text, argument.start).broken:
            star = BROKEN
        return MoveTarget(argument.start, remark=star) if first or sign == "*" else None
    if head[3]:
        return (
            _function_target(source, head, argument)
            if first or head[1].lower() in ("offs", "reltool")
            else None
        )
    index = "".join((head[2] or "").split())
    name = decode_name(head[1])
    return MoveTarget(argument.start, name=f"{name}{{{index}}}" if _INDEX.fullmatch(index) else name)


def _function_target(source: ProgramText, head: re.Match[str], argument: MoveArgument) -> MoveTarget:
    """Return the target of a move to a function's result: the point that it shifts, where it is such a one."""
    text, opened = source.text, head.end()
    inner: re.Match[str] | None = head
    shifted = False
    offset: tuple[float, float, float] | None = None
    while inner is not None and inner[3] and inner[1].lower() in ("offs", "reltool"):
        if inner[1].lower() == "offs":
            offset = UNREADABLE if offset else offset_of(text, inner.end(), argument.end)
        opened = inner.end()
        inner, shifted = _HEAD.match(text, opened, argument.end), True
    if not shifted:
        return MoveTarget(argument.start, remark=COMPUTED)
    named = inner is not None and not inner[3]
    index = "".join((inner[2] or "").split()) if inner else ""
    name = decode_name(inner[1]) if inner and named else ""
    name += f"{{{index}}}" if name and _INDEX.fullmatch(index) else ""
    literal = None if inner is not None else _match_literal(source, after_blanks(text, opened), axes=False)
    place = argument.start if literal is None else literal.start()
    return MoveTarget(place, name=name, literal=literal, remark=_SHIFTED, offset_m=offset)


def offset_of(text: str, place: int, end: int) -> tuple[float, float, float]:
    """Return the last three arguments of Offs, whose first begins at a place [m]; NaN where one is computed."""
    commas: list[int] = []
    depth, stop = 0, end
    for found in _ARGUMENT.finditer(text, place, end):
        if found[0] in ")]}" and not depth:
            stop = found.start()
            break
        depth += (found[0] in "[({") - (found[0] in "])}")
        if found[0] == "," and not depth:
            commas.append(found.start())
    if len(commas) != 3:
        return UNREADABLE
    ends = [*commas[1:], stop]
    x, y, z = (_length_m(text, start + 1, until) for start, until in zip(commas, ends, strict=True))
    return x, y, z


def _length_m(text: str, place: int, end: int) -> float:
    found = _LENGTH.fullmatch(text, place, end)
    return float("".join(found[1].split())) * 1e-3 if found else nan
