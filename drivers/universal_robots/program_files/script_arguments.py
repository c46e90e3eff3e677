"""Places that a URScript program passes to its own functions, which may bring them into a frame."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

Use = tuple[int, str, str]  # where a name stands, what for, and in which call or frame

_HEADER = re.compile(
    r"^[ \t]*+(?:def|thread)[ \t]++([A-Za-z_]\w*+)[ \t]*+\(([^()]*+)\)", re.ASCII | re.MULTILINE
)
_COPY = re.compile(
    r"^[ \t]*+(?:(?:global|local)[ \t]++)?+([A-Za-z_]\w*+)[ \t]*+=[ \t]*+([A-Za-z_]\w*+)[ \t]*+(?:#[^\r\n]*+)?\r?$",
    re.ASCII | re.MULTILINE,
)
_PARAMETER = re.compile(r"\s*+([A-Za-z_]\w*+)", re.ASCII)
_KEYWORD = re.compile(r"([A-Za-z_]\w*+)\s*+=\s*+\Z", re.ASCII)
_LONGEST_CALL = 2000
_MOST_ROUNDS = 20


@dataclass
class PassedArguments:
    """What the functions of a script do with their parameters, and a script with copies of its places."""

    text: str
    uses: Mapping[str, Sequence[Use]]
    behind_frame: Callable[[int], bool]  # whether a pose in pose_trans stands behind a frame
    _parameters: dict[str, list[str]] = field(init=False, default_factory=dict)
    _framed: set[tuple[str, str]] = field(init=False, default_factory=set)  # function, parameter

    _copies: dict[str, set[str]] = field(init=False, default_factory=dict)  # by name: what is set to it

    def __post_init__(self) -> None:
        for one in _COPY.finditer(self.text):
            self._copies.setdefault(one[2], set()).add(one[1])
        headers = list(_HEADER.finditer(self.text))
        ends = [*(one.start() for one in headers), len(self.text)][1:]
        passed: list[tuple[tuple[str, str], Use]] = []
        for header, end in zip(headers, ends, strict=True):
            function = header[1]
            found = [_PARAMETER.match(part) for part in header[2].split(",")]
            self._parameters[function] = [one[1] if one else "" for one in found]
            for name in filter(None, self._parameters[function]):
                inside = [use for use in self._uses_of(name) if header.end() < use[0] < end]
                if any(self._is_framed(use) for use in inside):
                    self._framed.add((function, name))
                passed += [((function, name), use) for use in inside]
        for _ in range(_MOST_ROUNDS):  # a function may pass its parameter on
            more = {key for key, use in passed if self._goes_into_frame(use)}
            if more <= self._framed:
                break
            self._framed |= more

    def is_brought_into_a_frame(self, name: str) -> bool:
        """Tell whether a copy of a place, or a function that it is passed to, goes to it in a frame."""
        if any(self._goes_into_frame(use) for use in self.uses.get(name, ()) if self._framed):
            return True
        return any(
            self._is_framed(use) or self._goes_into_frame(use)
            for copy in self._copies_of(name) - {name}
            for use in self.uses.get(copy, ())
        )

    def _copies_of(self, name: str) -> set[str]:
        """Return a name and all that are set to it, or to a copy of it."""
        found, waiting = {name}, [name]
        while waiting:
            new = self._copies.get(waiting.pop(), set()) - found
            found |= new
            waiting += new
        return found

    def _uses_of(self, name: str) -> list[Use]:
        return [use for copy in sorted(self._copies_of(name)) for use in self.uses.get(copy, ())]

    def _is_framed(self, use: Use) -> bool:
        at, role, where = use
        return role == "in_frame" or (role == "other" and where == "pose_trans" and self.behind_frame(at))

    def _goes_into_frame(self, use: Use) -> bool:
        at, role, where = use
        parameters = self._parameters.get(where) if role == "other" else None
        return parameters is not None and (where, self._parameter_at(at, where, parameters)) in self._framed

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
