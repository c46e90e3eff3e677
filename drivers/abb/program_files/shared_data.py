"""Data that the tasks of a controller share: PERS of one name are one, with the value of the task that was loaded."""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import replace
from pathlib import PurePath

from cellcal.drivers.abb.program_files.literals import AGGREGATES, NAME, NOT_CODE, decode_name
from cellcal.drivers.abb.program_files.passed_targets import TYPES_WITHOUT_TARGETS
from cellcal.drivers.abb.program_files.written_frames import NUMBERS, PARTS, name_of_numbers, standing_numbers
from cellcal.drivers.programs.controller_tasks import find_task, is_of_other_task
from cellcal.drivers.programs.file_declarations import ExternalUses, array_name_of
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, Positions

BARRED_SHARED = "another task of its controller declares it, too, and both tasks share one value"
BARRED_UNLIKE = "another task of its controller declares its tool or work object with other numbers"
_OF_TASKS = "shared"  # before a name and the file that declares it; its reason is the value
_PERS = re.compile(
    rf"{NOT_CODE}|\b(?:PROC|FUNC\s++\w++)\s++{NAME}\s*+\([^()]*+\)"  # whose parameters are no data
    rf"|(?P<own>\b(?:LOCAL|TASK)\s++)?+\bPERS\s++(?P<kind>\w++)\s++(?P<name>{NAME})\s*+(?:\{{[^{{}}]*+\}}\s*+)?+(?::=\s*+)?+",
    re.ASCII | re.IGNORECASE,
)
_VALUE = re.compile(r"[^;]*+")
_SMALL = TYPES_WITHOUT_TARGETS - {*PARTS, "jointtarget"}  # types of data that place nothing

Values = Mapping[str, Sequence[tuple[str, str]]]  # by name: the files that declare it, and its value there


def marks_of_shared_data(file: str, text: str) -> dict[str, str]:
    """Return what a file says to others of the data that it shares with other tasks."""
    return {f"{_OF_TASKS} {name} {file}": value for name, value in _shared_data(text)}


def _shared_data(text: str) -> Iterator[tuple[str, str]]:
    """Yield the names, in small letters, and the values, "" for none, of data that all tasks see."""
    for found in _PERS.finditer(text):
        kind = (found["kind"] or "num").lower()
        if kind in _SMALL or found["own"]:
            continue
        yield decode_name(found["name"]).lower(), _value_of(kind, text, found.end()) if kind in PARTS else ""


def _value_of(kind: str, text: str, place: int) -> str:
    """Return a tool's or work object's numbers, alike, however they are written."""
    literal = AGGREGATES[kind].pattern.match(text, place)
    numbers = None if literal is None else standing_numbers(kind, literal)
    if numbers is not None:
        return name_of_numbers(numbers)
    written = _VALUE.match(text, place)
    return "" if written is None else "".join(written[0].split())


def without_shared_data(
    positions: Positions, external_uses: ExternalUses, keys: Sequence[str], hidden: Set[str]
) -> Positions:
    """Return positions of which those are left that are, or stand in, what another task may set or load otherwise.

    ``hidden`` are the tools and work objects that only the file itself sees.
    """
    marks = external_uses.doubtful
    shared = marks.derive_once(
        _declared_twice.__name__, lambda: _declared_twice(marks, marks.rests_behind(_OF_TASKS))
    )
    if not shared:  # as in most
        return positions
    own = external_uses.file
    tools_and_frames = {name for name in shared if name not in hidden and _is_unlike(own, shared[name])}
    points = {name for name, some in shared.items() if own in dict(some) and _others(own, some)}
    barred: dict[int, str] = {}
    for row, names in enumerate(zip(positions.tools, positions.user_frames, strict=True)):
        parts = {name.lower().partition(NUMBERS)[0] for name in names if name is not None}
        if positions.kinds[row] in (CARTESIAN, JOINTS) and array_name_of(keys[row]) in points:
            barred[row] = BARRED_SHARED
        elif positions.kinds[row] == CARTESIAN and parts & tools_and_frames:
            barred[row] = BARRED_UNLIKE
    return replace(positions, barred={**barred, **positions.barred}) if barred else positions


def _declared_twice(marks: Mapping[str, str], rests: Sequence[str]) -> Values:
    found: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for rest in rests:
        name, _, file = rest.partition(" ")
        found[name].append((file, marks[f"{_OF_TASKS} {rest}"]))
    return {name: some for name, some in found.items() if len(some) > 1}


def _others(file: str, some: Sequence[tuple[str, str]]) -> set[str]:
    """Return the values that other tasks declare."""
    return {value for other, value in some if is_of_other_task(file, other)}


def _is_unlike(file: str, some: Sequence[tuple[str, str]]) -> bool:
    """Return whether a file's task declares a value, and another task of its controller another one."""
    task, folder = find_task(file), PurePath(file).parent
    own = {
        value
        for other, value in some
        if find_task(other) == task and (task is not None or PurePath(other).parent == folder)
    }
    others = _others(file, some) - {""}
    return bool(own and others) and len((own | others) - {""}) > 1
