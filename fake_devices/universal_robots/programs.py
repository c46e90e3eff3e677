"""Programs that arrive as text, and what the controller makes of them.

Imitates
    The script interpreter of ports 30001 to 30003, as far as this fake needs one.
Source
    The programs that ur_rtde 1.6.5 uploads (README, upload).
Modelled
    Recognising ur_rtde's control program, its register offset and its injected path; in any other program the
    movej and movel lines with plain numbers, run one after another.
Not modelled
    Executing URScript: conditions, loops, threads, functions, sockets.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

_NAME = re.compile(r"^(?:def|sec)\s+(\w+)\s*\(", re.MULTILINE)
_OFFSET = re.compile(r"# int register offset\s*\n?\s*(\d+)")
_WAYPOINT = re.compile(r"^\s*(movej|movel|movep)\((p?)\[([^\]]*)\]([^)]*)\)", re.MULTILINE)
_OPTION = re.compile(r"\b([avr])\s*=\s*([\d.eE+-]+)")


@dataclass(frozen=True)
class Waypoint:
    """One motion of an injected path."""

    verb: str
    is_pose: bool
    target: tuple[float, ...]
    acceleration: float
    speed: float


@dataclass(frozen=True)
class ParsedProgram:
    """The statements that were understood of a text."""

    name: str
    is_control_script: bool
    register_offset: int = 0
    path: tuple[Waypoint, ...] = ()


def parse_program(text: str) -> ParsedProgram:
    """Recognise a program."""
    found = _NAME.search(text)
    name = found.group(1) if found else ""
    if "RTDE Control Script Loaded" not in text and name != "rtde_control":
        return ParsedProgram(name or "unnamed", False, path=tuple(_parse_waypoints(text)))
    offset = _OFFSET.search(text)
    _, _, after = text.partition("# inject move path")
    body, _, _ = after.partition("\n    end")
    return ParsedProgram(name, True, int(offset.group(1)) if offset else 0, tuple(_parse_waypoints(body)))


def _parse_waypoints(body: str) -> Iterator[Waypoint]:
    for verb, pose, numbers, rest in _WAYPOINT.findall(body):
        options = {key: float(value) for key, value in _OPTION.findall(rest)}
        target = tuple(float(value) for value in numbers.split(","))
        if len(target) == 6:
            yield Waypoint(verb, bool(pose), target, options.get("a", 1.2), options.get("v", 0.25))


class ProgramSplitter:
    """Cut the stream of a script port into programs: a line that is exactly ``end`` closes one."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self._rest = b""

    def split_programs(self, data: bytes) -> Iterator[str]:
        """Yield the text of every program that is complete; a single line outside a program is one too."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for raw in lines:
            line = raw.decode("utf-8", "replace").rstrip("\r")
            if not self._lines and not line.startswith(("def ", "sec ")):
                if line.strip():
                    yield line + "\n"
                continue
            self._lines.append(line)
            if line == "end":
                yield "\n".join(self._lines) + "\n"
                self._lines.clear()
