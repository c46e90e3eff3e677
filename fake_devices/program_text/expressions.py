"""Expressions of robot languages: numbers, names with index and member, calls, comparisons, logic.

Imitates
    What stands to the right of an assignment and in a condition, in KRL and in RAPID.
Source
    KUKA KSS 8.x, operators and their priorities; ABB 3HAC050946-001 (RAPID kernel), expressions.
Modelled
    The operators in the two tables below with their priorities: in KRL a comparison binds weakest, in RAPID OR does.
    Both sides of AND and OR are computed. A value of another kind than an operator takes is an error, as there.
Not modelled
    Everything else: an expression with it is not accepted.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

Value = Any  # int, float, bool, text of a name (#P_STOP), or a structure of such values

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<name>\$?[A-Za-z_]\w*)|(?P<word>#\w+)"
    r"|(?P<sign>==|<=|>=|<>|[-+*/()\[\].,<>=]))"
)


class ProgramTextError(ValueError):
    """A program holds what this simulator does not execute, or does what its controller would stop at."""


class Scope(Protocol):
    """What names stand for."""

    def read(self, name: str, index: int | None, member: str) -> Value:
        """Return the value of a name in capitals; ``index`` and ``member`` where they are written."""
        ...

    def call(self, name: str, arguments: Sequence[Value]) -> Value:
        """Return the value of a function."""
        ...


@dataclass(frozen=True)
class Expression:
    """A text that has a value, and the names in it."""

    text: str
    evaluate: Callable[[Scope], Value]
    names: frozenset[str]


@dataclass(frozen=True)
class Reference:
    """A name with its index and member, as a target of an assignment too."""

    name: str
    index: Expression | None
    member: str

    def read(self, scope: Scope) -> Value:
        """Return its value."""
        return scope.read(self.name, self.place(scope), self.member)

    def place(self, scope: Scope) -> int | None:
        """Return the value of its index."""
        return None if self.index is None else int(self.index.evaluate(scope))


@dataclass(frozen=True)
class Grammar:
    """The operators of a language, from the ones that bind weakest to the ones that bind strongest."""

    levels: tuple[tuple[str, ...], ...]
    has_not: bool  # NOT before an operand, binding strongest


KRL = Grammar((("==", "<>", "<=", ">=", "<", ">"), ("OR",), ("AND",), ("+", "-"), ("*", "/")), has_not=True)
RAPID = Grammar(
    (("OR",), ("AND",), ("=", "<>", "<=", ">=", "<", ">"), ("+", "-"), ("*", "/", "DIV", "MOD")),
    has_not=False,
)


def parse_expression(text: str, grammar: Grammar) -> Expression:
    """Return an expression; raise ProgramTextError where it holds what is not modelled."""
    parser = _Parser(text, grammar)
    evaluate = parser.parse_level(0)
    parser.expect_end()
    return Expression(text.strip(), evaluate, frozenset(parser.names))


def parse_reference(text: str, grammar: Grammar) -> Reference:
    """Return a target of an assignment."""
    parser = _Parser(text, grammar)
    found = parser.parse_reference()
    parser.expect_end()
    return found


class _Parser:
    """Recursive descent."""

    def __init__(self, text: str, grammar: Grammar) -> None:
        self._text, self._grammar, self._at = text, grammar, 0
        self._tokens = self._split_text(text)
        self.names: set[str] = set()

    def _split_text(self, text: str) -> list[tuple[str, str]]:
        tokens, at = [], 0
        while at < len(text.rstrip()):
            found = _TOKEN.match(text, at)
            if found is None:
                raise ProgramTextError(f"{text.strip()!r} is not understood at {text[at:].strip()!r}")
            tokens.append((str(found.lastgroup), found[str(found.lastgroup)]))
            at = found.end()
        return tokens

    def expect_end(self) -> None:
        if self._at != len(self._tokens):
            raise ProgramTextError(f"{self._text.strip()!r}: {self._tokens[self._at][1]!r} is not understood")

    def parse_level(self, level: int) -> Callable[[Scope], Value]:
        if level == len(self._grammar.levels):
            return self._parse_operand()
        left = self.parse_level(level + 1)
        while sign := self._take_sign(*self._grammar.levels[level]):
            left = _combine_values(sign, left, self.parse_level(level + 1), self._text)
        return left

    def parse_reference(self) -> Reference:
        kind, name = self._next_token()
        if kind != "name":
            raise ProgramTextError(f"{self._text.strip()!r}: {name!r} is no name")
        index = None
        if self._take_sign("["):
            inside = self.parse_level(0)
            self._expect_sign("]")
            index = Expression(self._text, inside, frozenset())
        member = self._next_token()[1].upper() if self._take_sign(".") else ""
        self.names.add(name.upper())
        return Reference(name.upper(), index, member)

    def _parse_operand(self) -> Callable[[Scope], Value]:
        if self._grammar.has_not and self._take_sign("NOT"):
            inside = self._parse_operand()
            return lambda scope: not _as_flag(inside(scope), self._text)
        if self._take_sign("-"):
            inside = self._parse_operand()
            return lambda scope: -_as_number(inside(scope), self._text)
        if self._take_sign("("):
            inside = self.parse_level(0)
            self._expect_sign(")")
            return inside
        return self._parse_atom()

    def _parse_atom(self) -> Callable[[Scope], Value]:
        kind, text = self._next_token()
        if kind == "number":
            number: int | float = int(text) if text.isdigit() else float(text)
            return lambda _scope: number
        if kind == "word" or text.upper() in ("TRUE", "FALSE"):
            constant: Value = text.upper() if kind == "word" else text.upper() == "TRUE"
            return lambda _scope: constant
        self._at -= 1
        reference = self.parse_reference()
        if not self._take_sign("("):
            return reference.read
        self._expect_sign(")")
        return lambda scope: scope.call(reference.name, ())

    def _next_token(self) -> tuple[str, str]:
        if self._at >= len(self._tokens):
            raise ProgramTextError(f"{self._text.strip()!r} ends too early")
        self._at += 1
        return self._tokens[self._at - 1]

    def _expect_sign(self, sign: str) -> None:
        if not self._take_sign(sign):
            raise ProgramTextError(f"{self._text.strip()!r}: {sign!r} is missing")

    def _take_sign(self, *signs: str) -> str:
        if self._at < len(self._tokens) and self._tokens[self._at][1].upper() in signs:
            self._at += 1
            return self._tokens[self._at - 1][1].upper()
        return ""


def _as_flag(value: Value, text: str) -> bool:
    if not isinstance(value, bool):
        raise ProgramTextError(f"{text.strip()!r}: {value!r} is neither TRUE nor FALSE")
    return value


def _as_number(value: Value, text: str) -> int | float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ProgramTextError(f"{text.strip()!r}: {value!r} is no number")
    return value


_COMPARED: dict[str, Callable[[Value, Value], bool]] = {
    "=": lambda a, b: bool(a == b),
    "==": lambda a, b: bool(a == b),
    "<>": lambda a, b: bool(a != b),
    "<=": lambda a, b: bool(a <= b),
    ">=": lambda a, b: bool(a >= b),
    "<": lambda a, b: bool(a < b),
    ">": lambda a, b: bool(a > b),
}
_COMPUTED: dict[str, Callable[[Value, Value], Value]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "DIV": lambda a, b: int(a / b),
    "MOD": lambda a, b: int(a) % int(b),
}


def _combine_values(
    sign: str, left: Callable[[Scope], Value], right: Callable[[Scope], Value], text: str
) -> Callable[[Scope], Value]:
    if sign in ("AND", "OR"):
        both = all if sign == "AND" else any
        return lambda scope: both([_as_flag(left(scope), text), _as_flag(right(scope), text)])
    if sign in _COMPUTED:
        compute = _COMPUTED[sign]
        return lambda scope: compute(_as_number(left(scope), text), _as_number(right(scope), text))
    compare = _COMPARED[sign]

    def evaluate(scope: Scope) -> Value:
        first, second = left(scope), right(scope)
        if type(first) is not type(second) and _kind_name(first) != _kind_name(second):
            raise ProgramTextError(f"{text.strip()!r} compares {first!r} with {second!r}")
        return compare(first, second)

    return evaluate


def _kind_name(value: Value) -> str:
    if isinstance(value, bool):
        return "flag"
    return "number" if isinstance(value, int | float) else type(value).__name__
