"""[robot.usual.PROCEDURE]: what a cell answers to a procedure's settings unless a run is told otherwise.

The points of a fixture, the number of a tool, the limits of a line stand in the file once, in the same names and SI
units as ``cellcal run --set`` takes; a technician then types none of them.
"""

import math
from collections.abc import Mapping
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError
from pydantic_core import to_jsonable_python

from cellcal.service.configuration.device_keys import suggest_key

USUAL_KEY = "usual"  # of [[robot]]; no driver knows it
Usual = Mapping[str, Mapping[str, Any]]  # by procedure, by setting
# answers to one loss or one result: as defaults they would answer for other cases
_OF_ONE_RUN = ("write_anyway", "last_counts", "alarms", "exchanged_axes", "of_run", "renew")


def read_usual(table: Mapping[str, Any], where: str, faults: list[tuple[str, str]]) -> Usual:
    """Read the usual settings of a robot's table, as JSON; what is wrong is added to ``faults``."""
    tables = table.get(USUAL_KEY)
    if tables is None:
        return {}
    from cellcal.procedures.catalogue import CATALOGUE  # noqa: PLC0415  heavy: only for a file that needs it

    if not isinstance(tables, dict) or not all(isinstance(part, dict) for part in tables.values()):
        faults.append((f"{where}.{USUAL_KEY}", f"is written as [robot.{USUAL_KEY}.PROCEDURE]"))
        return {}
    for unknown in set(tables) - set(CATALOGUE):
        fault = f"there is no procedure {unknown!r}; {suggest_key(unknown, tuple(CATALOGUE))}"
        faults.append((f"{where}.{USUAL_KEY}.{unknown}", fault))
    return {
        name: _check_settings(CATALOGUE[name].spec_type, settings, f"{where}.{USUAL_KEY}.{name}", faults)
        for name, settings in tables.items()
        if name in CATALOGUE
    }


def _check_settings(
    kind: type, raw: dict[str, Any], where: str, faults: list[tuple[str, str]]
) -> Mapping[str, Any]:
    from cellcal.service.configuration.file_settings import file_settings  # noqa: PLC0415  as above

    hints, files, found = get_type_hints(kind, include_extras=True), file_settings(kind), dict[str, Any]()
    for name, value in raw.items():
        flaw = ""
        if name not in hints:
            flaw = f"unknown setting; {suggest_key(name, tuple(hints))}"
        elif name in files:
            flaw = "is a file of one run; name it with --set or choose it on the page"
        elif name in _OF_ONE_RUN:
            flaw = "belongs to one run; it cannot be said for all of them"
        else:
            found[name], flaw = _validate_value(hints[name], value)
        if flaw:
            faults.append((f"{where}.{name}", flaw))
    return found


def _validate_value(hint: Any, value: Any) -> tuple[Any, str]:
    """Return a value whole, with its parts' own usual values, as JSON; or what is wrong with it."""
    kind: TypeAdapter[Any] = TypeAdapter(hint)
    try:
        read = to_jsonable_python(kind.validate_python(value))
    except ValidationError as error:
        return None, "; ".join(" ".join((*map(str, one["loc"]), one["msg"])) for one in error.errors())
    except ValueError as error:
        return None, str(error)
    if not is_finite(value):
        return None, "not a finite number"
    if bool_became_number(value, read):
        return None, "true and false are no numbers"
    return read, ""


def is_finite(value: Any) -> bool:
    """Return whether no number in a setting is endless or none."""
    if isinstance(value, dict):
        return all(is_finite(part) for part in value.values())
    if isinstance(value, list | tuple):
        return all(is_finite(part) for part in value)
    return not isinstance(value, float) or math.isfinite(value)


def bool_became_number(raw: Any, became: Any) -> bool:
    """Return whether a true or false is taken for 1 or 0 anywhere in a setting: the types alone let it pass."""
    if isinstance(raw, bool):
        return isinstance(became, int | float) and not isinstance(became, bool)
    if isinstance(raw, dict) and isinstance(became, dict):
        return any(bool_became_number(value, became.get(key)) for key, value in raw.items())
    if isinstance(raw, list | tuple) and isinstance(became, list | tuple):
        return any(bool_became_number(a, b) for a, b in zip(raw, became, strict=False))
    return False
