"""What a PolyScope program moves to without a fixed waypoint: relative steps, variables, expressions, scripts."""

import re
from collections.abc import Iterator

from cellcal.drivers.programs.shifts import NO_TURN, UNREADABLE, Axes, Shift
from cellcal.drivers.universal_robots.program_files.script_text import SIX
from cellcal.drivers.universal_robots.program_files.urp_waypoints import BASE, Reader
from cellcal.drivers.universal_robots.program_files.urp_xml import XmlText

IN_SCRIPT = "it stands in a script or an expression of the program, and is not read"
STRAY = "it belongs to no waypoint, and is not read"
_LITERAL = re.compile(rf"p?\[{SIX}\]", re.ASCII)
_COMPUTES = re.compile(r"pose_\w+|interpolate_pose|\w+_kin\(|p\[|\bspeedl\b|\bforce_mode\b", re.ASCII)
_COMPUTED_PLACE = "a computed place"


def shifts_of(xml: XmlText, reader: Reader) -> tuple[Shift, ...]:
    """Return the steps of a program that do not turn with its waypoints, and the places that it computes."""
    found = [*_relative(xml, reader), *_computed(xml, reader)]
    return tuple(sorted(found, key=lambda one: one.line))


def _relative(xml: XmlText, reader: Reader) -> Iterator[Shift]:
    for i in reader.tags.get("Waypoint", ()):
        kind, name = xml.value(i, "type", "Fixed"), xml.value(i, "name") or "a waypoint"
        line = xml.line(xml.elements[i].offset)
        if kind == "Relative":
            yield Shift(line, "a relative waypoint", Axes.USER_FRAME, (), name, BASE, UNREADABLE, NO_TURN)
        elif kind != "Fixed":
            yield Shift(line, "a variable", Axes.USER_FRAME, (), name, BASE, UNREADABLE, None)


def _computed(xml: XmlText, reader: Reader) -> Iterator[Shift]:
    for i, text in _scripts(xml, reader):
        if _COMPUTES.search(text) is not None:
            line = xml.line(xml.elements[i].offset)
            yield Shift(
                line, "a script or an expression", Axes.USER_FRAME, (), _COMPUTED_PLACE, BASE, quaternion=None
            )


def unread_of(xml: XmlText, reader: Reader) -> list[tuple[str, int, str]]:
    """Return name, line and reason of positions that are in the file and not in a waypoint."""
    found = [
        (f"line {xml.line(xml.elements[i].offset)}", xml.line(xml.elements[i].offset), IN_SCRIPT)
        for i, text in _scripts(xml, reader)
        for _ in _LITERAL.finditer(text)
    ]
    return found + [
        (f"line {xml.line(xml.elements[i].offset)}", xml.line(xml.elements[i].offset), STRAY)
        for i in reader.stray_joints()
    ]


def _scripts(xml: XmlText, reader: Reader) -> Iterator[tuple[int, str]]:
    """Yield the text of every script node and expression."""
    for i in reader.tags.get("cachedContents", ()):
        begin = xml.text.find(">", xml.elements[i].offset) + 1
        end = xml.text.find("</cachedContents", begin)
        yield i, xml.text[begin : end if end >= 0 else begin]
    for i in reader.tags.get("expression", ()):
        yield i, "".join(xml.value(child, "character") for child in xml.children[i])
