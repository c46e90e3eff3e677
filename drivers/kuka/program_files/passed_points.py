"""Points, frames and components that KRL calls pass to routines, which may move there or give them a value."""

import re
from collections.abc import Container, Iterator, Mapping

from cellcal.drivers.kuka.program_files import patterns
from cellcal.drivers.kuka.program_files.frame_uses import KrlRoutine
from cellcal.drivers.kuka.program_files.lines import point_key
from cellcal.drivers.kuka.program_files.point_uses import PointUses
from cellcal.drivers.programs.barred import COMPUTED
from cellcal.drivers.programs.routine_calls import (
    OWN,
    PARAMETER,
    RoutineCall,
    RoutineParameter,
    RoutineTargets,
)

# Functions of the language and of its Ethernet interface: their first argument that gets a value.
_GIVING: Mapping[str, int] = {"CREAD": 6, "SREAD": 4, "CAST_FROM": 2}
_GIVING_INTERFACE = "EKI_GET"
_NONE_GIVEN = 1000
_PARAMETERS = re.compile(r"\s*\(([^()]*)")
_PARAMETER = re.compile(r"\s*([A-Za-z_]\w*)\s*(?:\[[^\[\]]*\]\s*)?(?::\s*(IN|OUT)\s*)?", re.IGNORECASE)
_COMMAS = re.compile(r",(?![^\[\]]*\])")
_MOST_ARGUMENTS = 100


def parameters_of(header: str) -> tuple[RoutineParameter, ...]:
    """Return the parameters behind the name of a routine; without :IN what it does to one comes back."""
    found = _PARAMETERS.match(header)
    some = [_PARAMETER.fullmatch(part) for part in _COMMAS.split(found[1])] if found else []
    return tuple(
        RoutineParameter(
            one[1].upper(), optional=False, is_target=True, by_value=(one[2] or "").upper() == "IN"
        )
        for one in some
        if one is not None
    )


def is_by_value(text: str, routine: str, number: int) -> bool:
    """Return whether a parameter of a routine, counted from 0, is one that a program declares ``:IN``."""
    header = rf"^[ \t]*(?:GLOBAL[ \t]+)?(?:DEF|DEFFCT[ \t]+\w+)[ \t]+{re.escape(routine)}\b([^\n;]*)"
    found = re.search(header, text, re.IGNORECASE | re.MULTILINE)
    parameters = parameters_of(found[1]) if found is not None else ()
    return number < len(parameters) and parameters[number].by_value


def calls_of(code: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the calls in a statement: the routine in capitals, and the arguments as they are written."""
    for called in patterns.CALLS.finditer(code):
        place, arguments = called.end(), list[str]()
        while place < len(code) and len(arguments) < _MOST_ARGUMENTS:
            end = _end_of_argument(code, place)
            arguments.append(code[place:end])
            place = end + 1
            if code[end : end + 1] != ",":
                break
        yield called[1].upper(), arguments


def _end_of_argument(code: str, place: int) -> int:
    """Return where the comma or the bracket behind an argument stands, or the code's end."""
    deep = 0
    for at in range(place, len(code)):
        if code[at] in ",)" and not deep:
            return at
        deep += (code[at] in "({[") - (code[at] in ")}]")
    return len(code)


def first_filled_argument(name: str) -> int:
    """Return which argument of a function is the first that gets a value; far behind all where none does."""
    return 2 if name.startswith(_GIVING_INTERFACE) else _GIVING.get(name, _NONE_GIVEN)


def call_of(scope: str, name: str, arguments: list[str]) -> RoutineCall | None:
    """Return a call with the points, tables and components that it passes; None for one that passes none."""
    found = [patterns.DATA.fullmatch(argument) for argument in arguments]
    keys = [point_key(one[1], one[2]) if one else "" for one in found]
    whole = tuple(key if one and not one[3] else "" for key, one in zip(keys, found, strict=True))
    parts = tuple(
        key if one and one[3] and patterns.OF_PLACE.fullmatch(one[3]) else ""
        for key, one in zip(keys, found, strict=True)
    )
    return RoutineCall(scope, name, whole, {}, parts) if any((*whole, *parts)) else None


def routine_targets_of(points: PointUses) -> dict[str, RoutineTargets]:
    """Return by routine what it does to the data that it gets."""
    return {
        routine.name: RoutineTargets(
            routine.parameters,
            {one.name: some for one in routine.parameters if (some := points.uses_in(routine, one.name))},
            frozenset(
                one.name for one in routine.parameters if not one.by_value and one.name in routine.assigned
            ),
            routine.shown,
        )
        for routine in points.routines
        if routine.parameters
    }


def calls_of_file(points: PointUses) -> tuple[RoutineCall, ...]:
    """Return the calls of a program, with what they pass as other files name it."""
    by_name = {routine.name: routine for routine in points.routines}
    alike = {(call.scope, call.routine, call.arguments): call for call in points.calls}
    elsewhere = [call for call in alike.values() if call.routine not in by_name]
    return tuple(
        call._replace(
            arguments=tuple(_key_for_other_files(name, by_name[call.scope]) for name in call.arguments),
            parts=tuple(_key_for_other_files(name, by_name[call.scope]) for name in call.parts),
        )
        for call in (*points.calls, *(one for call in elsewhere for one in _calls_with_sources(points, call)))
    )


def copies_of_file(points: PointUses) -> tuple[tuple[str, str], ...]:
    """Return the names of which copies are made that other files may move to, and those of the copies."""
    own = {name for routine in points.routines for name in routine.declared}
    copies = {copy for some in points.copies.values() for copy in some if copy.partition("[")[0] not in own}
    pairs = ((source.removesuffix("[]"), copy) for copy in copies for source in points.copied_into(copy))
    return tuple(sorted(pairs))


def _calls_with_sources(points: PointUses, call: RoutineCall) -> Iterator[RoutineCall]:
    return call.with_sources([sorted(points.copied_into(name)) if name else () for name in call.arguments])


def _key_for_other_files(name: str, routine: KrlRoutine) -> str:
    """Return a name as data lists have it, marked where it is the routine's own."""
    bare = name.partition("[")[0]
    if any(one.name == bare for one in routine.parameters):
        return PARAMETER + bare
    name = name.removesuffix("[]")  # the whole array, or an element whose number the program computes
    return OWN + name if bare in routine.declared else name


def explain_passed_table(doubtful: Container[str], tool: str | None, base: str | None) -> str:
    """Return why a table's tool or base that a call passes to a routine which sets it is unknown, or ""."""
    entries = {
        f"{which}_data[{index}]"
        for which, number in (("tool", tool), ("base", base))
        if number is not None and number.isdigit() and number != "0"
        for index in (number, "")
    }
    return COMPUTED if any(entry in doubtful for entry in entries) else ""
