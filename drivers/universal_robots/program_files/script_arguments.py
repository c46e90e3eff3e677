"""Places that a URScript program passes to its own functions, which may bring them into a frame."""

import re
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field

from cellcal.drivers.universal_robots.program_files.script_scopes import UNKNOWN, ScriptScopes, Variable

Use = tuple[int, str, str]  # where a name stands, what for, and in which call or frame

_COPY = re.compile(
    r"^[ \t]*+(?:(?:global|local)[ \t]++)?+([A-Za-z_]\w*+)(?:\[[^\]\n]*+\])?+[ \t]*+=[ \t]*+"
    r"(?:(\[)|([A-Za-z_]\w*+)(?:\[[^\]\n]*+\])?+[ \t]*+(?:#[^\r\n]*+)?\r?$)",
    re.ASCII | re.MULTILINE,
)
_LISTED = re.compile(r"#[^\r\n]*+|[\[\](){}]|(?<![\w.])([A-Za-z_]\w*+)", re.ASCII)
_KEYWORD = re.compile(r"([A-Za-z_]\w*+)\s*+=\s*+\Z", re.ASCII)
_CALLED = re.compile(r"([A-Za-z_]\w*+)[ \t]*+\Z", re.ASCII)
_RETURNS = re.compile(r"^[ \t]*+return[ \t(]++([A-Za-z_]\w*+)", re.ASCII | re.MULTILINE)
_LONGEST_CALL = 2000
_LONGEST_LIST = 100_000
_LONGEST_NAME = 60
_MOST_ROUNDS = 20
_MOVED_TO = ("target", "in_frame")
_EVERYWHERE = -3  # in place of where a variable gets its value: all uses count


@dataclass
class _Uses:
    """The uses of a variable in one function, in the order of the text."""

    offsets: list[int] = field(default_factory=list)
    uses: list[Use] = field(default_factory=list)


@dataclass
class PassedArguments:
    """The use that a script's functions make of their parameters, and a script with copies of its places."""

    text: str
    uses: Mapping[str, Sequence[Use]]
    behind_frame: Callable[[int], bool]  # whether a pose in pose_trans stands behind a frame
    _scopes: ScriptScopes = field(init=False)
    _parameters: dict[str, Sequence[str]] = field(init=False, default_factory=dict)
    _framed: set[tuple[str, str]] = field(init=False, default_factory=set)  # function, parameter
    _moved: set[tuple[str, str]] = field(init=False, default_factory=set)  # the same, that moves go to
    _copies: dict[int, tuple[str, int]] = field(init=False, default_factory=dict)  # by use: into what, where
    _variables: dict[str, dict[Variable, dict[int, _Uses]]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._scopes = ScriptScopes(self.text)
        for one in _COPY.finditer(self.text):
            if one[3]:
                self._copies[one.start(3)] = (one[1], one.start(1))
            else:
                self._copies |= dict.fromkeys(self._listed_names(one.end()), (one[1], one.start(1)))
        self._parameters = {one.name: one.parameters for one in self._scopes.functions}
        passed: list[tuple[tuple[str, str], Use]] = []
        for number, function in enumerate(self._scopes.functions):
            for name in filter(None, function.parameters):
                inside = list(self._reached_uses((number, name)))
                if any(self._is_framed(use) for use in inside):
                    self._framed.add((function.name, name))
                self._moved |= {(function.name, name) for use in inside if use[1] in _MOVED_TO}
                passed += [((function.name, name), use) for use in inside]
        for _ in range(_MOST_ROUNDS):  # a function may pass its parameter on
            framed = {key for key, use in passed if self._goes_into(use, self._framed)}
            moved = {key for key, use in passed if self._goes_into(use, self._moved)}
            if framed <= self._framed and moved <= self._moved:
                break
            self._framed |= framed
            self._moved |= moved

    def moves_to_copies(self, name: str, at: int) -> set[int]:
        """Return where moves go to copies of a place, and where functions are called that go to what they get.

        Parameters
        ----------
        at
            Where the place gets its name.
        """
        uses = self.uses.get(name, ())
        if not self._moved and not any(use[0] in self._copies for use in uses):  # as nearly always
            return set()
        variable = self._scopes.variable_at(name, at)
        return {
            use[0]
            for use in self._reached_uses(variable)
            if use[1] in _MOVED_TO or self._goes_into(use, self._moved)
        }

    def is_brought_into_a_frame(self, name: str, at: int, *, itself: bool = False) -> bool:
        """Return whether a copy of a place, or a function that it is passed to, goes to it in a frame.

        Parameters
        ----------
        at
            Where the place gets its name.
        itself
            Whether a use by that name counts, too.
        """
        uses = self.uses.get(name, ())
        if (
            not itself and not self._framed and not any(use[0] in self._copies for use in uses)
        ):  # as nearly always
            return False
        variable = self._scopes.variable_at(name, at)
        own = set[int]() if itself else {use[0] for use in uses}
        return any(
            (use[0] not in own and self._is_framed(use)) or self._goes_into(use, self._framed)
            for use in self._reached_uses(variable)
        )

    def is_passed_into_a_frame(self, at: int) -> bool:
        """Return whether what stands at an offset, in a list or as an argument, is gone to in a frame."""
        if (copy := self._copies.get(at)) is not None:
            return self.is_brought_into_a_frame(*copy, itself=True)
        return self._goes_into((at, "other", "["), self._framed)

    def returning(self, taken: Iterable[re.Match[str]]) -> set[str]:
        """Return the functions that return what is taken at a ``call``, or by the name ``to`` that it gets."""
        returned = {(self._scopes.function_at(one.start()), one[1]) for one in _RETURNS.finditer(self.text)}
        functions = {
            function
            for one in taken
            for function in [self._scopes.function_at(one.start("call"))]
            if {(function, one["call"]), (function, one["to"])} & returned
        }
        return {self._scopes.functions[each].name for each in functions if each >= 0}

    def _reached_uses(self, variable: Variable) -> Iterator[Use]:
        """Yield the uses of a variable, and of what is set to it or to a copy of it, as long as that lasts."""
        found: set[tuple[Variable, int]] = {(variable, _EVERYWHERE)}
        waiting = list(found)
        while waiting:
            for use in self._uses_of(*waiting.pop()):
                yield use
                copy = self._copies.get(use[0])
                if copy is None:
                    continue
                new = (self._scopes.variable_at(*copy), copy[1])
                if new not in found:
                    found.add(new)
                    waiting.append(new)

    def _uses_of(self, variable: Variable, at: int) -> Iterator[Use]:
        """Yield the uses of a variable that may hold what it gets at an offset."""
        function = _EVERYWHERE if at == _EVERYWHERE else self._scopes.function_at(at)
        for one in (variable, (UNKNOWN, variable[1])):
            for number, some in self._variables_named(variable[1]).get(one, {}).items():
                if number != function:
                    yield from some.uses
                    continue
                for start, stop in self._scopes.reach_of(variable, at):
                    yield from some.uses[bisect_left(some.offsets, start) : bisect_right(some.offsets, stop)]

    def _variables_named(self, name: str) -> dict[Variable, dict[int, _Uses]]:
        """Return the variables of a name, and by function their uses."""
        if name not in self._variables:
            found: dict[Variable, dict[int, _Uses]] = defaultdict(lambda: defaultdict(_Uses))
            for use in sorted(self.uses.get(name, ())):
                at = use[0]
                some = found[self._scopes.variable_at(name, at)][self._scopes.function_at(at)]
                some.offsets.append(at)
                some.uses.append(use)
            self._variables[name] = found
        return self._variables[name]

    def _listed_names(self, start: int) -> Iterator[int]:
        """Yield where names stand in a list, behind its bracket, that are no arguments of calls."""
        brackets = ["["]
        for found in _LISTED.finditer(self.text, start, start + _LONGEST_LIST):
            if found[1]:
                if "(" not in brackets:
                    yield found.start(1)
            elif found[0] in "([{":
                brackets.append(found[0])
            elif found[0] in ")]}":
                brackets.pop()
                if not brackets:
                    return

    def _is_framed(self, use: Use) -> bool:
        at, role, where = use
        return role == "in_frame" or (
            role == "other" and where in ("pose_trans", "[") and self.behind_frame(at)
        )

    def _goes_into(self, use: Use, parameters_so: Set[tuple[str, str]]) -> bool:
        """Return whether a use passes a place to a function's parameter that is one of these."""
        at, role, where = use
        where = self._function_called_at(at) if where == "[" else where
        parameters = self._parameters.get(where) if role == "other" else None
        return parameters is not None and (where, self._parameter_at(at, where, parameters)) in parameters_so

    def _function_called_at(self, at: int) -> str:
        """Return the function that an element of a list is an argument of; "" where it is none."""
        begins = max(0, at - _LONGEST_CALL)
        deep = 0
        for i in range(at - 1, begins - 1, -1):
            sign = self.text[i]
            deep += (sign in ")]") - (sign in "([")
            if deep < 0:
                called = _CALLED.search(self.text, max(0, i - _LONGEST_NAME), i) if sign == "(" else None
                return called[1] if called else ""
            if sign == "\n" and not deep and self.text[max(0, i - 1)] not in ",(\\\r":
                return ""
        return ""

    def taker_of_element(self, at: int) -> str:
        """Return what takes up one element of a list: "[" for another list, the function, or "" for neither."""
        deep = 0
        for i in range(at - 1, max(0, at - _LONGEST_CALL) - 1, -1):
            sign = self.text[i]
            deep += (sign in ")]") - (sign in "([")
            if deep < 0:
                called = _CALLED.search(self.text, max(0, i - _LONGEST_NAME), i)
                if sign == "[":
                    return "" if called and called[1] != "p" else "["  # behind a name it chooses an element
                if called:
                    return called[1]
                deep = 0  # brackets of an expression
            if sign == "\n" and not deep and self.text[max(0, i - 1)] not in ",([\\\r":
                return ""
        return ""

    def _parameter_at(self, at: int, function: str, parameters: Sequence[str]) -> str:
        """Return the parameter that an argument is for; "" where it is none."""
        before = self.text[max(0, at - _LONGEST_CALL) : at]
        called = list(re.finditer(rf"(?<!\w){re.escape(function)}\s*\(", before))
        if not called:
            return ""
        keyword = _KEYWORD.search(before)
        if keyword is not None:
            return keyword[1]
        deep, commas = 0, 0
        for sign in before[called[-1].end() :]:
            deep += (sign in "([{") - (sign in ")]}")
            commas += sign == "," and not deep
        return parameters[commas] if commas < len(parameters) else ""
