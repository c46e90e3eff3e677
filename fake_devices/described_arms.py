"""Arms that are described to the fakes from outside: the numbers of a data sheet, and generic ones for the rest.

Imitates
    Any arm of six turning axes, behind whatever controller a cell file names.
Source
    The JSON file of ``--arms``: one object a robot of the cell file, with its rows, coupling, limits, speeds and
    parking posture as the process that starts the fakes knows them. Masses, stiffnesses, gear ratios and the
    wrist's coupling are generic: those of the fakes' own FANUC M-6iB, scaled by the
    arm's reach. No maker has published them.
Modelled
    As for the arms that the fakes know by themselves.
Not modelled
    Joints that slide; arms of fewer or more axes; rods of a parallelogram as bodies of their own.
"""

import json
from collections.abc import Mapping, Sequence
from math import cos, radians, sin
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.fake_devices.arm_models import MODELS, ArmModel, GearTrain, LinkMass

GENERIC = "generic"  # how the drive of a described arm is called
_AXES = 6
_REACH_M = 1.373  # of the M-6iB, whose numbers are scaled
_KG = {2: 14.0, 3: 16.0, 4: 9.0, 6: 4.0}
_STIFFNESS_NM_RAD = (7e5, 7e5, 4.5e5, 1.5e5, 1.2e5, 1e5)
_GEARS = GearTrain(
    ratios=(121.0, 153.0, -160.5, -80.25, -80.0, -50.0),
    coupling=((4, 3, -1.58e-4), (5, 3, -1.52e-4), (5, 4, -1.53e-4)),
)
_PARALLEL = 1e-6
_APART_M = 1e-6


def read_described_arms(path: Path) -> dict[str, ArmModel]:
    """Return the arms of a file by their robots' names in the cell file.

    Raises
    ------
    ValueError
        An arm that is not of six turning axes, or lacks something.
    """
    found = json.loads(path.read_text(encoding="utf-8"))
    return {str(name): described_arm(str(name), table) for name, table in found.items()}


def described_arm(name: str, table: Mapping[str, Any]) -> ArmModel:
    """Return one arm: ``dh`` rows (theta deg, d mm, a mm, alpha deg), coupling, limits, speeds, park and frames."""
    rows = [[float(value) for value in row] for row in table["dh"]]
    if len(rows) != _AXES or any(len(row) != 4 for row in rows):
        raise ValueError(f"the fakes play arms of six axes; {name} has {len(rows)} rows")
    dh = tuple((radians(t), d / 1e3, a / 1e3, radians(alpha)) for t, d, a, alpha in rows)
    scale = _stretched_m(dh) / _REACH_M
    drive = _GEARS if table.get("drive") == GENERIC else None
    return ArmModel(
        name=name,
        dh=dh,
        coupling=(),
        lower_deg=_six(name, table, "lower_deg"),
        upper_deg=_six(name, table, "upper_deg"),
        max_speed_deg_s=_six(name, table, "speed_deg_s"),
        masses=tuple(LinkMass(link, kg * scale**3, _halfway(dh[link - 1])) for link, kg in _KG.items()),
        stiffness_nm_rad=tuple(value * scale**4 for value in _STIFFNESS_NM_RAD),
        park_deg=_six(name, table, "park_deg"),
        parallel_axes=tuple(
            i for i, row in enumerate(dh[:-1]) if abs(sin(row[3])) < _PARALLEL and abs(row[2]) > _APART_M
        ),
        gears=drive,
        title=str(table.get("title", name)),
        whole_coupling=_matrix(name, table, "joint_coupling", _AXES),
        base=_matrix(name, table, "base", 4),
        flange=_matrix(name, table, "flange", 4),
    )


def model_of(robot: str, model_name: str, described: Mapping[str, ArmModel]) -> ArmModel:
    """Return the arm that was described for a robot, or a model that the fakes know by themselves.

    Raises
    ------
    ValueError
        Neither.
    """
    if robot in described:
        return described[robot]
    if model_name in MODELS:
        return MODELS[model_name]
    raise ValueError(f"the fakes know no arm {model_name!r}, and it was not described to them")


def _stretched_m(dh: Sequence[tuple[float, float, float, float]]) -> float:
    """Return the length of the arm from its second axis to the wrist, stretched, with the offset before."""
    return max(sum(float(np.hypot(d, a)) for _, d, a, _ in dh[:4]) - abs(dh[0][1]), 0.1)


def _halfway(row: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Return the middle of a link, seen from its own frame at its end."""
    _, d, a, alpha = row
    return (-a / 2.0, -d * sin(alpha) / 2.0, -d * cos(alpha) / 2.0)


def _six(name: str, table: Mapping[str, Any], key: str) -> tuple[float, ...]:
    values = tuple(float(value) for value in table[key])
    if len(values) != _AXES or not np.isfinite(values).all():
        raise ValueError(f"{name}: {key} needs {_AXES} finite numbers")
    return values


def _matrix(name: str, table: Mapping[str, Any], key: str, size: int) -> tuple[tuple[float, ...], ...]:
    values = np.array(table.get(key, np.eye(size).tolist()), dtype=float)
    if values.shape != (size, size) or not np.isfinite(values).all():
        raise ValueError(f"{name}: {key} needs {size} times {size} finite numbers")
    return tuple(tuple(row) for row in values.tolist())
