"""What a PolyScope program moves to without a fixed waypoint: relative steps, variables, expressions, scripts."""

import re
from collections.abc import Iterator

from cellcal.drivers.programs.positions import NO_NUMBER
from cellcal.drivers.programs.shifts import NO_TURN, UNREADABLE, ProgramShift, ShiftAxes
from cellcal.drivers.universal_robots.program_files.feature_variables import FEATURE_VARIABLE
from cellcal.drivers.universal_robots.program_files.script_text import SIX, SIX_NUMBERS
from cellcal.drivers.universal_robots.program_files.urp_waypoints import BASE, WaypointReader
from cellcal.drivers.universal_robots.program_files.urp_xml import XmlText

IN_SCRIPT = "it stands in a script or an expression of the program, and is not read"
IN_URCAP = "it stands in a node of a URCap, and is not read"
STRAY = "it belongs to no waypoint, and is not read"
_LITERAL = re.compile(rf"p?\[{SIX}\]", re.ASCII)
_COMPUTES = re.compile(
    r"pose_\w+|interpolate_pose|\bset_tcp\b|\w+_kin\(|p\[|\bspeedl\b|\bforce_mode\b", re.ASCII
)
# A move of a script: where to is a variable or a call; what is written out is a position that is not read.
_MOVES = re.compile(r"\b(?:(?:opti)?move[jl]|move[cp]|servo[jlc])\s*\(\s*(?P<target>\w*)", re.ASCII)
_COMPUTED_PLACE = "a computed place"
_KNOWN_NODES = frozenset(  # those of public programs: read here, or they move nothing, or what is inside is read
    (
        "Move", "CircleMove", "Waypoint", "Script", "If", "ElseIf", "Else", "Loop", "Switch", "Case", "DefaultCase",
        "Folder", "Comment", "Halt", "Popup", "Wait", "Set", "Assignment", "Timer", "Event", "Thread",
        "SuppressedNode", "SubProgram", "CallSubProgram", "SafeHome", "MainProgram", "SpecialSequence",
        "InitVariablesNode", "Contributed", "Until",
    )
)  # fmt: skip
_READ_ELSEWHERE = frozenset(("Waypoint", "Script"))
_DIRECTED = re.compile(r"Force|Direction")  # along axes: a shift of the work changes nothing


def shifts_of(xml: XmlText, reader: WaypointReader) -> tuple[ProgramShift, ...]:
    """Return the steps of a program that do not turn with its waypoints, and the places that it computes."""
    found = [*_relative_shifts(xml, reader), *_computed_shifts(xml, reader), *_unread_nodes(xml, reader)]
    return tuple(sorted(found, key=lambda one: one.line))


def _relative_shifts(xml: XmlText, reader: WaypointReader) -> Iterator[ProgramShift]:
    for i in reader.tags.get("Waypoint", ()):
        kind, name = xml.attribute_value(i, "type", "Fixed"), xml.attribute_value(i, "name") or "a waypoint"
        line = xml.line_of(xml.elements[i].offset)
        if kind == "Relative":
            yield ProgramShift(
                line, "a relative waypoint", ShiftAxes.USER_FRAME, (), name, BASE, UNREADABLE, NO_TURN
            )
        elif kind != "Fixed":
            yield ProgramShift(line, "a variable", ShiftAxes.USER_FRAME, (), name, BASE, UNREADABLE, None)


def _computed_shifts(xml: XmlText, reader: WaypointReader) -> Iterator[ProgramShift]:
    own = {
        f"{xml.attribute_value(i, 'name')}_{kind}" for i in reader.tags.get("Waypoint", ()) for kind in "pq"
    }  # what PolyScope calls the pose and the joints of a waypoint: these follow it
    for i, text in (*_script_texts(xml, reader), *_outside_scripts(xml, reader)):
        moves = any(move["target"] not in own for move in _MOVES.finditer(text))
        if moves or _COMPUTES.search(text) is not None:
            line = xml.line_of(xml.elements[i].offset)
            yield ProgramShift(
                line,
                "a script or an expression",
                ShiftAxes.USER_FRAME,
                (),
                _COMPUTED_PLACE,
                BASE,
                quaternion=None,
            )


def _unread_nodes(xml: XmlText, reader: WaypointReader) -> Iterator[ProgramShift]:
    """Yield nodes of the program that are not known, such as Force, Direction or Pallet: they may move the robot."""
    for around in reader.tags.get("children", ()):
        for i in xml.children[around]:
            tag = xml.elements[i].tag
            if tag not in _KNOWN_NODES and "reference" not in xml.elements[i].attributes:
                turn = NO_TURN if _DIRECTED.search(tag) else None
                line = xml.line_of(xml.elements[i].offset)
                yield ProgramShift(
                    line, f"the node {tag}", ShiftAxes.BASE, (), _COMPUTED_PLACE, BASE, UNREADABLE, turn
                )


def features_set_by(xml: XmlText, reader: WaypointReader) -> frozenset[str]:
    """Return the features whose variable, which PolyScope calls NAME_var, the program names: it may set them."""
    texts = [xml.text, *(text for _, text in _script_texts(xml, reader))]
    return frozenset(name for text in texts for name in FEATURE_VARIABLE.findall(text))


def calls_others(reader: WaypointReader) -> bool:
    """Return whether a program calls others, which then see its variables, and it theirs."""
    return any(tag in reader.tags for tag in ("SubProgram", "CallSubProgram", "Script"))


def unread_positions_of(xml: XmlText, reader: WaypointReader) -> list[tuple[str, int, str]]:
    """Return name, line and reason of positions that are in the file and not in a waypoint."""
    found = [
        (f"line {xml.line_of(xml.elements[i].offset)}", xml.line_of(xml.elements[i].offset), IN_SCRIPT)
        for i, text in _script_texts(xml, reader)
        for _ in _LITERAL.finditer(text)
    ]
    found += [
        (f"line {xml.line_of(xml.elements[i].offset)}", xml.line_of(xml.elements[i].offset), IN_URCAP)
        for i in _inside_urcaps(xml, reader)
        for _ in _LITERAL.finditer(_data_text(xml, i))
    ]
    for i in reader.broken:
        line = xml.line_of(xml.elements[i].offset)
        found.append((xml.attribute_value(i, "name") or f"line {line}", line, NO_NUMBER))
    return found + [
        (f"line {xml.line_of(xml.elements[i].offset)}", xml.line_of(xml.elements[i].offset), STRAY)
        for i in reader.stray_joints()
    ]


def _inside_urcaps(xml: XmlText, reader: WaypointReader) -> Iterator[int]:
    """Yield the elements in which nodes of URCaps store values; waypoints and scripts inside are read as such."""
    if "Contributed" not in reader.tags:
        return
    for i, element in enumerate(xml.elements):
        around = (element.tag, *(tag for tag in _READ_ELSEWHERE if xml.find_above(i, tag) is not None))
        if not _READ_ELSEWHERE.intersection(around) and xml.find_above(i, "Contributed") is not None:
            yield i


def _data_text(xml: XmlText, data: int) -> str:
    """Return what a node of a URCap stores, with the brackets of a list around bare numbers."""
    text = xml.attribute_value(data, "value").replace("&quot;", '"')
    begin = xml.text.find(">", xml.elements[data].offset) + 1
    text = text or xml.text[begin : xml.text.find("<", begin)].strip()
    return f"[{text}]" if SIX_NUMBERS.fullmatch(text) else text


def _outside_scripts(xml: XmlText, reader: WaypointReader) -> Iterator[tuple[int, str]]:
    """Yield script nodes whose text is in another file, as a move to what only that file tells."""
    for i in reader.tags.get("Script", ()):
        is_file = xml.attribute_value(i, "type") == "File"
        if is_file and xml.find_child(i, "cachedContents") is None:
            yield i, "movel("


def _script_texts(xml: XmlText, reader: WaypointReader) -> Iterator[tuple[int, str]]:
    """Yield the text of every script node and expression."""
    for i in reader.tags.get("cachedContents", ()):
        begin = xml.text.find(">", xml.elements[i].offset) + 1
        end = xml.text.find("</cachedContents", begin)
        yield i, xml.text[begin : end if end >= 0 else begin]
    for i in reader.tags.get("expression", ()):
        yield i, "".join(xml.attribute_value(child, "character") for child in xml.children[i])
