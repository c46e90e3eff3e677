"""Mixed logic of a FANUC controller: what stands in brackets, as a function of the controller's state.

Imitates
    Expressions of mixed logic instructions.
Source
    deploy/controller_setup/fanuc_tp.md, "Instructions that the programs use".
Modelled
    Registers R[n] and PR[n,i], flags F[n], outputs UO[n], system variables, numbers, ON and OFF; + - * / DIV MOD;
    comparisons; AND, OR, !; brackets.
Not modelled
    Everything else: an expression with it is not accepted.
"""

import re
from collections.abc import Callable
from typing import Protocol

Value = float | bool
Expression = Callable[["TpState"], Value]

_TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+\.?\d*|\.\d+)|(?P<item>(?:R|F|UO|PR)\[(?:[^\[\]]|R\[\d+\])+\])"
    r"|(?P<system>\$[A-Z_0-9]+(?:\[\d+\])?(?:\.\$[A-Z_0-9]+(?:\[\d+\])?)*)"
    r"|(?P<word>AND|OR|DIV|MOD|ON|OFF)\b|(?P<sign><=|>=|<>|[-+*/()!=<>]))"
)
_ITEM = re.compile(r"(R|F|UO|PR)\[(\d+)(?:,(\d+|R\[\d+\]))?(?::[^\[\]]*)?\]\Z")


class TpSyntaxError(ValueError):
    """An instruction that this simulator does not know."""


class TpState(Protocol):
    """The controller's state that expressions read."""

    def read_item(self, kind: str, number: int, element: int) -> Value: ...
    def read_system(self, name: str) -> Value: ...


def compile_expression(text: str) -> Expression:
    """Return the function of an expression.

    Raises
    ------
    TpSyntaxError
        It holds something that is not modelled.
    """
    parser = _ExpressionParser(_split_tokens(text), text)
    found = parser.parse_or()
    parser.expect_end()
    return found


def compile_item(text: str) -> Expression:
    """Return the function that reads one register, flag or output."""
    kind, number, element = parse_item(text)
    return lambda state: state.read_item(kind, number, 0 if element is None else int(element(state)))


def parse_item(text: str) -> tuple[str, int, Expression | None]:
    """Return kind, number and element of R[5], F[20], UO[3], PR[90,1] or PR[90,R[103]]."""
    found = _ITEM.match(text.strip())
    if found is None:
        raise TpSyntaxError(f"{text!r} is no register, flag or output")
    element: Expression | None = None
    if found[3] is not None:
        fixed = float(found[3]) if found[3].isdigit() else None
        element = (lambda _state, n=fixed: n) if fixed is not None else compile_item(found[3])
    return found[1], int(found[2]), element


def _split_tokens(text: str) -> list[tuple[str, str]]:
    tokens, at = [], 0
    while at < len(text.rstrip()):
        found = _TOKEN.match(text, at)
        if found is None:
            raise TpSyntaxError(f"{text!r} is not understood at column {at + 1}")
        kind = str(found.lastgroup)
        tokens.append((kind, found[kind]))
        at = found.end()
    return tokens


class _ExpressionParser:
    """Recursive descent; AND and OR are evaluated whole, as by the controller."""

    def __init__(self, tokens: list[tuple[str, str]], text: str) -> None:
        self._tokens, self._text, self._at = tokens, text, 0

    def expect_end(self) -> None:
        if self._at != len(self._tokens):
            raise TpSyntaxError(f"{self._text!r}: {self._tokens[self._at][1]!r} stands where nothing should")

    def parse_or(self) -> Expression:
        left = self._parse_and()
        while self._take("OR"):
            left = _both(left, self._parse_and(), lambda a, b: bool(a) or bool(b))
        return left

    def _parse_and(self) -> Expression:
        left = self._parse_comparison()
        while self._take("AND"):
            left = _both(left, self._parse_comparison(), lambda a, b: bool(a) and bool(b))
        return left

    def _parse_comparison(self) -> Expression:
        left = self._parse_sum()
        for sign, compare in _COMPARISONS.items():
            if self._take(sign):
                return _both(left, self._parse_sum(), compare)
        return left

    def _parse_sum(self) -> Expression:
        left = self._parse_product()
        while sign := self._take("+", "-"):
            right = self._parse_product()
            left = _both(left, right, _ARITHMETIC[sign])
        return left

    def _parse_product(self) -> Expression:
        left = self._parse_operand()
        while sign := self._take("*", "/", "DIV", "MOD"):
            right = self._parse_operand()
            left = _both(left, right, _ARITHMETIC[sign])
        return left

    def _parse_operand(self) -> Expression:
        if self._take("!"):
            operand = self._parse_operand()
            return lambda state: not operand(state)
        if self._take("-"):
            operand = self._parse_operand()
            return lambda state: -float(operand(state))
        if self._take("("):
            inside = self.parse_or()
            if not self._take(")"):
                raise TpSyntaxError(f"{self._text!r}: a bracket is not closed")
            return inside
        return self._parse_atom()

    def _parse_atom(self) -> Expression:
        if self._at >= len(self._tokens):
            raise TpSyntaxError(f"{self._text!r} ends too early")
        kind, text = self._tokens[self._at]
        self._at += 1
        if kind == "number":
            number = float(text)
            return lambda _state: number
        if kind == "item":
            return compile_item(text)
        if kind == "system":
            return lambda state: state.read_system(text)
        if text in ("ON", "OFF"):
            return lambda _state: text == "ON"
        raise TpSyntaxError(f"{self._text!r}: {text!r} is no operand")

    def _take(self, *signs: str) -> str:
        if self._at < len(self._tokens) and self._tokens[self._at][1] in signs:
            self._at += 1
            return self._tokens[self._at - 1][1]
        return ""


_COMPARISONS: dict[str, Callable[[Value, Value], Value]] = {
    "<=": lambda a, b: a <= b,
    ">=": lambda a, b: a >= b,
    "<>": lambda a, b: a != b,
    "=": lambda a, b: a == b,
    "<": lambda a, b: a < b,
    ">": lambda a, b: a > b,
}
_ARITHMETIC: dict[str, Callable[[Value, Value], Value]] = {
    "+": lambda a, b: float(a) + float(b),
    "-": lambda a, b: float(a) - float(b),
    "*": lambda a, b: float(a) * float(b),
    "/": lambda a, b: float(a) / float(b),
    "DIV": lambda a, b: float(int(float(a) / float(b))),
    "MOD": lambda a, b: float(int(a) % int(b)),
}


def _both(left: Expression, right: Expression, combine: Callable[[Value, Value], Value]) -> Expression:
    return lambda state: combine(left(state), right(state))
