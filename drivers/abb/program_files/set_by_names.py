"""Data that a RAPID module sets by names which it computes: SetDataVal and SetAllDataVal."""

import re
from collections.abc import Callable, Mapping, Set

from cellcal.drivers.abb.program_files.frame_facts import BARRED_SET
from cellcal.drivers.abb.program_files.literals import NAME
from cellcal.drivers.programs.barred import OVERWRITTEN
from cellcal.drivers.programs.positions import Positions

TARGET, AXES, TOOL, WORK_OBJECT = "robtarget", "jointtarget", "tooldata", "wobjdata"
ANY_TYPE = "*"
_TYPES_THAT_COUNT = frozenset((TARGET, AXES, TOOL, WORK_OBJECT))
_OTHER_TYPES = frozenset(
    ("num", "dnum", "bool", "string", "byte", "pos", "orient", "pose", "confdata", "extjoint", "robjoint",
     "loaddata", "speeddata", "zonedata", "stoppointdata")
)  # fmt: skip
_SILENT = re.compile(r'![^\n]*+|"(?:[^"\n]++|"")*+"')
_ALL = re.compile(r'\bSetAllDataVal\b\s*+(?:"(\w++)")?+', re.ASCII | re.IGNORECASE)
_ONE = re.compile(r'\bSetDataVal\b(?!\s*+"\w)([^;]*+)', re.ASCII | re.IGNORECASE)
_VALUE = re.compile(
    rf",\s*+(?:(?P<name>{NAME})\s*+(?:\{{[^{{}}]*+\}})?+|(?P<plain>[-+\d.]++|TRUE|FALSE|\"[^\"]*+\"))\s*+\Z",
    re.ASCII | re.IGNORECASE,
)
_DECLARED = re.compile(
    rf"(?:\b(?:PERS|VAR|CONST|INOUT)|[,(])\s*+(\w++)\s++({NAME})(?![\w.])", re.ASCII | re.IGNORECASE
)
_OF_LANGUAGE = frozenset(("tool0", "wobj0"))  # never set


def types_set_by_names(text: str) -> set[str]:
    """Return the types, in small letters, of targets, tools and work objects that are set so; any type as such."""
    code = _SILENT.sub(lambda found: found[0] if found[0][0] == '"' else "", text)
    types = {(found[1] or ANY_TYPE).lower() for found in _ALL.finditer(code)}
    arguments = {found[1] for found in _ONE.finditer(code)}
    declared: dict[str, set[str]] = {}
    for found in _DECLARED.finditer(code) if arguments else ():
        declared.setdefault(found[2].lower(), set()).add(found[1].lower())
    types |= {_type_of(each, declared) for each in arguments}
    return types & (_TYPES_THAT_COUNT | {ANY_TYPE})


def _type_of(arguments: str, declared: Mapping[str, Set[str]]) -> str:
    """Return the type of the value that a name gets; any where its declarations are not all of one known type."""
    value = _VALUE.search(arguments)
    if value is None:
        return ANY_TYPE
    if value["plain"]:
        return "num"
    types = declared.get(value["name"].lower(), set())
    is_known = len(types) == 1 and types <= _TYPES_THAT_COUNT | _OTHER_TYPES
    return next(iter(types)) if is_known else ANY_TYPE


def rows_set_by_names(positions: Positions, is_set: Callable[[str], bool]) -> dict[int, str]:
    """Return the positions whose tool, work object or own value is of a type that a file sets so, and why."""
    any_type = is_set(ANY_TYPE)
    frame_set, tool_set = (any_type or is_set(kind) for kind in (WORK_OBJECT, TOOL))
    target_set = any_type or is_set(TARGET) or is_set(AXES)
    if not (frame_set or tool_set or target_set):
        return {}
    found = {}
    for row, (tool, frame) in enumerate(zip(positions.tools, positions.user_frames, strict=True)):
        names = (tool if tool_set else None, frame if frame_set else None)
        if any(name is not None and name.lower() not in _OF_LANGUAGE for name in names):
            found[row] = BARRED_SET
        elif target_set and "@" not in positions.names[row]:
            found[row] = OVERWRITTEN
    return found
