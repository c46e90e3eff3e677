"""A procedure's settings as the service completes them: what was typed, and what only it remembers."""

import math
from dataclasses import asdict, fields
from typing import Any

from pydantic import TypeAdapter, ValidationError

from calibration.errors import CellError
from procedures.catalogue import entry_named
from service.config import CellConfig
from service.watch import LastHealthyCounts


def build_spec(config: CellConfig, robot: str, procedure: str, settings: dict[str, Any]) -> Any:
    """Return the procedure's spec.

    Raises
    ------
    CellError
        A setting is unknown or out of its type; every fault is named.
    """
    kind = entry_named(procedure).spec_type
    valid = {field.name for field in fields(kind)}
    unknown = sorted(set(settings) - valid)
    if unknown:
        raise CellError(
            f"{procedure} has no setting {', '.join(unknown)}.",
            remedy=f"It has: {', '.join(sorted(valid)) or 'none'}.",
            code="usage",
        )
    if "last_counts" in valid and "last_counts" not in settings:
        healthy = LastHealthyCounts(config.cell.data_dir).load(robot)
        settings = settings | {"last_counts": None if healthy is None else healthy.counts}
    try:
        spec: Any = TypeAdapter(kind).validate_python(settings)
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        raise _wrong(procedure, faults) from error
    endless = [key for key, value in asdict(spec).items() if not _is_finite(value)]
    if endless:
        raise _wrong(procedure, f"{', '.join(endless)}: not a finite number")
    return spec


def _wrong(procedure: str, faults: str) -> CellError:
    return CellError(f"{procedure} cannot be run so: {faults}.", remedy="Correct --set.", code="usage")


def _is_finite(value: Any) -> bool:
    if isinstance(value, dict):
        return all(_is_finite(part) for part in value.values())
    if isinstance(value, list | tuple):
        return all(_is_finite(part) for part in value)
    return not isinstance(value, float) or math.isfinite(value)
