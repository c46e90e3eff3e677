"""What a project file writes in millimetres and degrees: poses, limits, and the words around them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS, rotation_from

Table = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class ProjectTool:
    """A tool as the controller has it, and as it really is."""

    entered: Array  # (4, 4) flange_tip in the controller
    real: Array  # (4, 4), the same where it was not measured
    sigma_m: float = 0.0  # of one coordinate of the real tip
    measured: bool = False


class ProjectError(CellError):
    """A project file cannot be used; the user can mend it."""

    code = "usage"


def refuse_keys(table: Table, valid_keys: set[str], where: str) -> None:
    """Refuse a key that is not read: a misspelled limit is no limit.

    Raises
    ------
    ProjectError
        With all keys that are known here.
    """
    unknown = sorted(set(table) - valid_keys)
    if unknown:
        raise ProjectError(
            f"{where}: unknown {', '.join(unknown)}.", remedy=f"Known here: {', '.join(sorted(valid_keys))}."
        )


def sub_table(data: Table, key: str, where: str) -> dict[str, Any]:
    """Return a table inside another, empty where it is not there."""
    found = data.get(key, {})
    if not isinstance(found, dict):
        raise ProjectError(f"{where}: {key} is a table, written [{key}]")
    return found


def read_text(table: Table, key: str, where: str) -> str | None:
    """Return a text, or None where it is not there."""
    found = table.get(key)
    if found is not None and not (isinstance(found, str) and found):
        raise ProjectError(f"{where}: {key} is a text in quotes")
    return found


def read_number(table: Table, key: str, where: str) -> float | None:
    """Return a finite number not below zero, or None where it is not there."""
    found = table.get(key)
    if found is None:
        return None
    if type(found) not in (int, float) or not 0 <= found < np.inf:
        raise ProjectError(f"{where}: {key} is a finite number, not below zero")
    return float(found)


def read_numbers(table: Table, key: str, count: int, where: str) -> Array:
    """Return a list of so many finite numbers."""
    found = table[key]
    right = isinstance(found, list) and len(found) == count and all(type(v) in (int, float) for v in found)
    if not right or not np.isfinite(np.asarray(found, dtype=float)).all():
        raise ProjectError(f"{where}: {key} is a list of {count} finite numbers")
    return np.asarray(found, dtype=float)


def pose_keys() -> set[str]:
    """Return the keys of a pose: the place, and an orientation by the name of its convention and its unit."""
    return {"position_mm", *(_convention_key(name) for name in CONVENTIONS)}


def pose_of(table: Table, where: str) -> Array:
    """Return (4, 4) from ``position_mm`` and at most one orientation; without one the axes are parallel.

    ``fanuc_wpr_deg``, ``kuka_abc_deg``, ``abb_quaternion``, ``ur_rotation_vector_rad`` … are the conventions of
    `calibration.orientation` with the unit behind them.

    Raises
    ------
    ProjectError
        A number that is missing or not finite, two orientations, or a quaternion that is not of unit length.
    """
    if "position_mm" not in table:
        raise ProjectError(f"{where}: position_mm is missing")
    named = [name for name in CONVENTIONS if _convention_key(name) in table]
    if len(named) > 1:
        raise ProjectError(f"{where}: one orientation is enough: {', '.join(map(_convention_key, named))}")
    rotation = np.eye(3)
    if named:
        key = _convention_key(named[0])
        values = read_numbers(table, key, len(CONVENTIONS[named[0]].fields), where)
        try:
            rotation = rotation_from(named[0], np.deg2rad(values) if key.endswith("_deg") else values)
        except CalibrationError as refused:
            raise ProjectError(
                make_message(
                    "{where}: {key}: {refused_message}",
                    where=where,
                    key=key,
                    refused_message=refused.message,
                )
            ) from refused
    return homogeneous_matrix(rotation, read_numbers(table, "position_mm", 3, where) / 1e3)


def _convention_key(convention: str) -> str:
    if convention.endswith("quaternion"):
        return convention
    return f"{convention}_rad" if convention.endswith("vector") else f"{convention}_deg"
