"""Nominal robots as data: one TOML file a model, each group of numbers with its source."""

from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from cellcal.calibration.arm.mounting import gravity_of
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.errors import CalibrationError

_KEYS = {
    "title", "joints", "dh_source", "theta_deg", "d_mm", "a_mm", "alpha_deg", "sign", "interaction",
    "interaction_source", "limits_source", "lower_deg", "upper_deg", "speed_source", "speed_deg_s", "mounting",
}  # fmt: skip


@cache
def model_names() -> tuple[str, ...]:
    """Return the names of the models that ship, sorted."""
    return tuple(
        sorted(f.name.removesuffix(".toml") for f in files(__package__).iterdir() if f.name.endswith(".toml"))
    )


def model_fields(name: str) -> dict[str, Any]:
    """Return the numbers of one model in SI: DH ``rows`` (n, 4) and the fields of `RobotModel`."""
    if name not in model_names():
        near = get_close_matches(name, model_names(), n=1)
        suggestion = f"Did you mean {near[0]}?" if near else f"Known: {', '.join(model_names())}."
        raise CalibrationError(f"there is no robot model {name!r}.", remedy=suggestion, code="usage")
    return parse_model(name, files(__package__).joinpath(f"{name}.toml").read_text(encoding="utf-8"))


def parse_model(name: str, text: str) -> dict[str, Any]:
    """Read the text of a model file; refuses unknown keys, missing sources and columns of another length."""
    try:
        data = parse_toml(text)
    except DocumentError as error:
        raise CalibrationError(f"robot model {name}: {error.message}", remedy=error.remedy) from error
    missing = _KEYS - {"sign", "interaction", "interaction_source", "mounting"} - data.keys()
    if missing or data.keys() - _KEYS:
        raise CalibrationError(
            f"robot model {name}: missing {sorted(missing)}, unknown {sorted(data.keys() - _KEYS)} keys"
        )
    n = len(data["joints"])
    columns = {
        key: _read_column(name, data, key, n) for key in _KEYS if key.endswith(("_deg", "_mm", "_deg_s"))
    }
    return {
        "title": data["title"],
        "rows": np.stack(
            [
                np.deg2rad(columns["theta_deg"]),
                columns["d_mm"] / 1e3,
                columns["a_mm"] / 1e3,
                np.deg2rad(columns["alpha_deg"]),
            ],
            axis=1,
        ),
        "joint_coupling": _read_coupling(name, data, n),
        "lower_rad": np.deg2rad(columns["lower_deg"]),
        "upper_rad": np.deg2rad(columns["upper_deg"]),
        "max_speed_rad_s": np.deg2rad(columns["speed_deg_s"]),
        "joint_names": tuple(data["joints"]),
        **({"gravity_in_base": gravity_of(data["mounting"])} if "mounting" in data else {}),
    }


def _read_column(name: str, data: dict[str, Any], key: str, n: int) -> Any:
    values = np.array(data[key], dtype=float)
    if values.shape != (n,) or not np.isfinite(values).all():
        raise CalibrationError(f"robot model {name}: {key} needs {n} finite numbers")
    return values


def _read_coupling(name: str, data: dict[str, Any], n: int) -> Any:
    """DH angle = sign * joint; ``interaction = [[3, 2, 1.0]]``: DH angle 3 also turns with joint 2."""
    signs = np.array(data.get("sign", [1] * n), dtype=float)
    if signs.shape != (n,) or not (np.abs(signs) == 1.0).all():
        raise CalibrationError(f"robot model {name}: sign needs {n} times 1 or -1")
    coupling = np.diag(signs)
    if "interaction" in data and "interaction_source" not in data:
        raise CalibrationError(
            f"robot model {name}: where does the interaction come from? Give interaction_source"
        )
    for angle, joint, factor in data.get("interaction", []):
        if not (1 <= angle <= n and 1 <= joint <= n):
            raise CalibrationError(f"robot model {name}: the interaction names an axis that is not there")
        coupling[angle - 1, joint - 1] += factor
    return coupling
