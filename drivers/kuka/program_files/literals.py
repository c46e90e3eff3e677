"""KUKA's way to write a position: ``{E6POS: X 1.0,Y 2.0,...}`` with fields in any order, some of them missing."""

import re
from typing import NamedTuple

from cellcal.calibration.message import make_message

POSE_FIELDS = ("X", "Y", "Z", "A", "B", "C")
AXIS_FIELDS = ("A1", "A2", "A3", "A4", "A5", "A6")
STATE_FIELDS = ("S", "T")
EXTERNAL_FIELDS = ("E1", "E2", "E3", "E4", "E5", "E6")
AXIS_TYPES = ("AXIS", "E6AXIS")

_FIELDS_OF_TYPE = {
    "FRAME": POSE_FIELDS,
    "POS": (*POSE_FIELDS, *STATE_FIELDS),
    "E6POS": (*POSE_FIELDS, *STATE_FIELDS, *EXTERNAL_FIELDS),
    "AXIS": AXIS_FIELDS,
    "E6AXIS": (*AXIS_FIELDS, *EXTERNAL_FIELDS),
}
_NUMBER = r"[+-]?(?:\d++(?:\.\d*+)?+|\.\d++)(?:[eE][+-]?\d++)?+"
_WHOLE = rf"{_NUMBER}|'[Bb][01]++'|'[Hh][0-9A-Fa-f]++'"
_B = r"[ \t\r]"
_OPEN = re.compile(rf"\{{{_B}*+(?:([A-Za-z]\w*+){_B}*+:)?+", re.ASCII)
_NAME = re.compile(rf"{_B}*+([A-Za-z]\w*+)", re.ASCII)
_VALUE = re.compile(rf"{_B}++({_WHOLE})(?=[ \t\r,}}]){_B}*+([,}}])", re.ASCII)
_EXPRESSION = re.compile(rf"{_B}++(?:[+-]?{_B}*+[A-Za-z_$(]|{_NUMBER}{_B}*+[-+*/]{_B}*+[\w.$(])", re.ASCII)
_STATE = re.compile(r"'([BbHh])([0-9A-Fa-f]++)'|(\d++)(?:\.0*+)?+", re.ASCII)

# The order in which the controller itself writes; what is written otherwise goes field by field.
_CANONICAL_POSE = re.compile(
    rf"\{{(?:([A-Za-z]\w*+){_B}*+:{_B}*+)?+"
    + rf"{_B}*+,{_B}*+".join(rf"{name}{_B}++({_NUMBER})" for name in POSE_FIELDS)
    + "".join(rf"(?:{_B}*+,{_B}*+{name}{_B}++({_WHOLE}))?+" for name in STATE_FIELDS)
    + "".join(rf"(?:{_B}*+,{_B}*+{name}{_B}++({_NUMBER}))?+" for name in EXTERNAL_FIELDS)
    + rf"{_B}*+\}}",
    re.ASCII | re.IGNORECASE,
)

_CANONICAL_FIELDS = (*POSE_FIELDS, *STATE_FIELDS, *EXTERNAL_FIELDS)


class KrlLiteralError(ValueError):
    """The text is no position that this program states.

    ``computed`` where only the controller knows it, ``broken`` where a value of a whole struct is no number,
    ``closed`` where a whole struct is none of its type.
    """

    def __init__(
        self, place: int, message: str, *, computed: bool = False, broken: bool = False, closed: bool = False
    ) -> None:
        super().__init__(message)
        self.place = place
        self.computed = computed
        self.broken = broken
        self.closed = closed


class KrlLiteral(NamedTuple):
    """A struct as written; texts are None where a field is missing."""

    type: str  # "" where it is not written
    axes: bool  # A1 to A6 in place of X to C
    main: tuple[str | None, ...]  # (6,)
    state: tuple[str | None, ...]  # (2,) S and T, for a pose
    external: tuple[str | None, ...]  # (6,)
    start: int
    end: int

    @property
    def is_whole(self) -> bool:
        """Return whether no coordinate is left to what the robot has at that moment."""
        return None not in self.main

    @property
    def configuration_text(self) -> str:
        """Return the flags and turns as written, such as ``S 2,T 35``."""
        stated = zip(STATE_FIELDS, self.state, strict=True)
        return ",".join(f"{name} {text}" for name, text in stated if text is not None)


def read_literal(text: str, start: int, end: int) -> KrlLiteral:
    """Read the struct that opens at ``start`` and must close before ``end``.

    Raises
    ------
    LiteralError
        It is not a position, or not understood.
    """
    fast = _CANONICAL_POSE.match(text, start, end)
    if fast is not None:
        texts = fast.groups()
        literal = KrlLiteral(
            (texts[0] or "").upper(), False, texts[1:7], texts[7:9], texts[9:], start, fast.end()
        )
        if not literal.type or literal.type == "E6POS":
            return literal
    return _literal_of(text, start, end)


def field_spans(text: str, start: int, end: int) -> dict[str, tuple[int, int]]:
    """Return where the values of a struct stand, by the field's name in capitals.

    Raises
    ------
    LiteralError
        It is not understood.
    """
    fast = _CANONICAL_POSE.match(text, start, end)
    if fast is not None:
        spans = {name: at for name, at in zip(_CANONICAL_FIELDS, fast.regs[2:], strict=True) if at[0] >= 0}
        spans["}"] = (fast.end() - 1, fast.end())
        return spans
    opening = _OPEN.match(text, start, end)
    if opening is None:
        raise KrlLiteralError(start, "a position opens with '{'.")
    spans = {}
    place, closing = opening.end(), ","
    while closing == ",":
        name = _NAME.match(text, place, end)
        if name is None:
            raise KrlLiteralError(place, "here should be a field of the position, such as X.")
        value = _VALUE.match(text, name.end(), end)
        if value is None:
            raise _value_error(text, name, end)
        if name[1].upper() in spans:
            raise KrlLiteralError(
                name.start(1), make_message("{name} stands twice in this position.", name=name[1])
            )
        spans[name[1].upper()] = value.span(1)
        place, closing = value.end(), value[2]
    spans["}"] = (place - 1, place)
    return spans


def state_value(text: str) -> int | None:
    """Return S or T as a number, from ``35``, ``'B100011'`` or ``'H23'``; None for anything else."""
    found = _STATE.fullmatch(text)
    if found is None:
        return None
    if found[3]:
        return int(found[3]) if len(found[3]) < 10 else None
    try:
        return int(found[2], 2 if found[1] in "Bb" else 16)
    except ValueError:
        return None


def state_text(like: str, value: int) -> str:
    """Return S or T in the spelling of an old text."""
    if not like.startswith("'"):
        return str(value)
    digits = len(like) - 3
    return f"'{like[1]}{value:0{digits}{'b' if like[1] in 'Bb' else 'X'}}'"


_NO_NUMBER = re.compile(
    r"[ \t\r]+[+-]?\d*\.?#?(?:[QS]?NAN|IND|INF)\b", re.IGNORECASE
)  # 1.#QNAN of a computation
_REST_OF_STRUCT = re.compile(r"[^{}\n;]*+\}")


def _value_error(text: str, name: re.Match[str], end: int) -> KrlLiteralError:
    no_number = _NO_NUMBER.match(text, name.end(), end) is not None
    if not no_number and _EXPRESSION.match(text, name.end(), end):
        return KrlLiteralError(name.end(), make_message("{name} is computed.", name=name[1]), computed=True)
    return KrlLiteralError(
        name.end(),
        make_message("the value of {name} is not understood, or the position does not end.", name=name[1]),
        broken=no_number or _REST_OF_STRUCT.match(text, name.end(), end) is not None,
    )


def _literal_of(text: str, start: int, end: int) -> KrlLiteral:
    spans = field_spans(text, start, end)
    close = spans.pop("}")[1]
    opening = _OPEN.match(text, start, end)
    kind = (opening[1] or "" if opening else "").upper()
    axes = kind in AXIS_TYPES or (not kind and any(name in spans for name in AXIS_FIELDS))
    allowed = _FIELDS_OF_TYPE.get(kind or ("E6AXIS" if axes else "E6POS"))
    if allowed is None:
        raise KrlLiteralError(start, make_message("{kind} is no type of position.", kind=kind))
    for name, (place, _) in spans.items():
        if name not in allowed:
            why = make_message("{name} is no field of this position.", name=name)
            raise KrlLiteralError(place, why, closed=True)
        if name not in STATE_FIELDS and text[place] == "'":
            why = make_message("{name} must be a number.", name=name)
            raise KrlLiteralError(place, why, closed=True)

    def field_texts(names: tuple[str, ...]) -> tuple[str | None, ...]:
        return tuple(text[slice(*spans[name])] if name in spans else None for name in names)

    main, state = field_texts(AXIS_FIELDS if axes else POSE_FIELDS), field_texts(STATE_FIELDS)
    return KrlLiteral(kind, axes, main, state, field_texts(EXTERNAL_FIELDS), start, close)
