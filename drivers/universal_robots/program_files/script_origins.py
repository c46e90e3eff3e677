"""What a step of a URScript begins at: a place that the work or the robot has, or what only others know.

``pose_trans(get_actual_tcp_pose(), p[0, 0, 0.1, 0, 0, 0])`` is a step from where the robot stands, which goes along
with it. In ``pose_trans(camera_frame(), p[…])`` the numbers are a place in a frame that no file holds.
"""

import re
from collections import defaultdict
from collections.abc import Set
from dataclasses import dataclass, field

from cellcal.drivers.universal_robots.program_files.script_text import SIX_OVER_LINES

_CALL = re.compile(r"\s*+([A-Za-z_]\w*+)[ \t]*+\(", re.ASCII)
_NAME = re.compile(r"\s*+([A-Za-z_]\w*+)\s*+(?:,|\)|#|\r|\n|\Z)", re.ASCII)
_STATEMENT = re.compile(
    r"^[ \t]*+(?:(?:def|thread)[ \t]++(?P<function>\w++)|return\b(?P<returned>[^\r\n]*+)"
    r"|(?:(?:global|local)[ \t]++)?+(?P<name>[A-Za-z_]\w*+)[ \t]*+=(?!=)(?P<value>[^\r\n]*+))",
    re.ASCII | re.MULTILINE,
)
_RETURN_PLACES = frozenset(
    ("get_actual_tcp_pose", "get_target_tcp_pose", "get_forward_kin", "get_target_waypoint")
)
_BEGIN_AT_FIRST = frozenset(("pose_trans", "pose_add", "pose_sub", "interpolate_pose"))
_POSE = re.compile(rf"\s*+p\[{SIX_OVER_LINES}\]", re.ASCII)  # which is read as a place by itself
_NAMED_BEHIND = re.compile(  # numbers in an unknown frame, which are left by themselves where they stand
    r"[^(),]*+,\s*+(?:p\[|[A-Za-z_]\w*+\s*+\))", re.ASCII
)


@dataclass
class StepOrigins:
    """The values that the variables and functions of a script get and return."""

    text: str
    reached: Set[str]  # variables that a move goes to
    parameters: Set[str]
    _values: dict[str, list[str]] = field(init=False)
    _returned: dict[str, list[str]] = field(init=False)
    _places: dict[str, bool] = field(init=False, default_factory=dict)  # of variables and functions (``f(``)

    def __post_init__(self) -> None:
        self._values, self._returned = defaultdict(list), defaultdict(list)
        function = ""
        for found in _STATEMENT.finditer(self.text):
            if found["function"]:
                function = found["function"]
                self._returned[function] = []
            elif found["name"]:
                self._values[found["name"]].append(found["value"])
            else:
                self._returned[function].append(found["returned"])

    def is_place(self, text: str) -> bool:
        """Return whether an expression, with which a text begins, surely is a place of the robot or of the work."""
        source = self._source_of(text)
        return source if isinstance(source, bool) else self._is_surely_place(source)

    def _source_of(self, text: str, own: str = "") -> bool | str:
        """Return whether an expression is a place; the variable or function that it is taken from, where that says.

        ``own`` is the variable that gets it: its numbers are no place for being taken from itself.
        """
        start, is_named = 0, False
        while (call := _CALL.match(text, start)) is not None and call[1] in _BEGIN_AT_FIRST:
            start = call.end()
            is_named |= _NAMED_BEHIND.match(text, start) is not None
        named = _NAME.match(text, start)
        if is_named and (named is None or named[1] != own):
            return True
        if call is not None:
            return call[1] in _RETURN_PLACES or f"{call[1]}("
        if named is not None:
            return named[1] in self.reached or named[1]
        return _POSE.match(text, start) is not None

    def _is_surely_place(self, source: str) -> bool:
        """Return whether all that a variable or function may be taken from, step by step, are places."""
        found, waiting, has_place = {source}, [source], False
        while waiting:
            one = waiting.pop()
            its = {self._places[one]} if one in self._places else self._sources_of(one)
            if not its or False in its:
                self._places[source] = False
                return False
            has_place |= True in its
            more = {each for each in its if isinstance(each, str)} - found
            found |= more
            waiting += more
        self._places |= dict.fromkeys(found if has_place else [source], has_place)
        return has_place

    def _sources_of(self, source: str) -> set[bool | str]:
        """Return what a variable or function is taken from, but itself; what a parameter gets is a place."""
        values = self._returned.get(source[:-1], []) if source.endswith("(") else self._values.get(source, [])
        sources = {self._source_of(one, source) for one in values} - {source}
        return sources | {True} if source in self.parameters else sources
