"""What a step of a URScript begins at: a place that the work or the robot has, or what only others know.

``pose_trans(get_actual_tcp_pose(), p[0, 0, 0.1, 0, 0, 0])`` is a step from where the robot stands, which goes along
with it. In ``pose_trans(camera_frame(), p[…])`` the numbers are a place in a frame that no file holds.
"""

import re
from collections import defaultdict
from collections.abc import Callable
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
_DEEPEST = 5  # of functions and copies that are followed


@dataclass
class StepOrigins:
    """The values that the variables and functions of a script get and return."""

    text: str
    is_known: Callable[[str], bool]  # of a variable: it is a place that a move goes to, or a parameter
    _values: dict[str, list[str]] = field(init=False)
    _returned: dict[str, list[str]] = field(init=False)

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

    def is_place(self, text: str, depth: int = 0) -> bool:
        """Return whether an expression, with which a text begins, surely is a place of the robot or of the work."""
        if depth > _DEEPEST:
            return False
        if (call := _CALL.match(text)) is not None:
            if call[1] in _BEGIN_AT_FIRST:
                rest = text[call.end() :]
                return self.is_place(rest, depth + 1) or _NAMED_BEHIND.match(rest) is not None
            returned = self._returned.get(call[1], [])
            return call[1] in _RETURN_PLACES or (
                bool(returned) and all(self.is_place(one, depth + 1) for one in returned)
            )
        if (named := _NAME.match(text)) is not None:
            values = self._values.get(named[1], [])
            return self.is_known(named[1]) or (
                bool(values) and all(self.is_place(one, depth + 1) for one in values)
            )
        return _POSE.match(text) is not None
