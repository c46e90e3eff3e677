"""Turn the tables beside this file into the catalogue that ships: ``python deploy/robot_catalogue/build.py``.

Tables hold joint angles of the sources' chains and base frames of the sources; the catalogue holds joints as the
controller shows them, seen from the controller's base where the source has one.
"""

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.geometry import Array, homogeneous_matrix, inverse_transform
from cellcal.calibration.orientation import rotation_from, values_from

HERE = Path(__file__).parent
TABLES, WITHHELD = HERE / "tables", HERE / "withheld.toml"
CATALOGUE = HERE.parents[1] / "calibration" / "arm" / "robot_models" / "catalogue"
# Arms that have a checked file of their own: listed under its name, and loaded from it.
OWN_FILES = {
    "abb_irb120_3_58": "abb_irb120",
    "fanuc_m6ib": "fanuc_m6ib",
    "fanuc_r2000ic_165f": "fanuc_r2000ic_165f",
    "kuka_kr6_r900_sixx": "kuka_kr6_r900",
    "yaskawa_ar2010": "yaskawa_ar2010",
    **{
        f"universal_robots_{ur}": ur
        for ur in ["ur3", "ur5", "ur10", "ur3e", "ur5e", "ur10e", "ur16e", "ur20", "ur30"]
    },
}
_OF_PENDANT = (
    "The source limits joint {joint} without a word whether of the controller's axis or of the angle that is "
    "coupled with axis {other}: it is taken for the controller's axis."
)
_WITH_RODS = (
    "Rods drive axis 3. The serial model is exact while they form a parallelogram; errors of rods and bearings "
    "change with the posture, no link error can hold them, and an identification leaves them over."
)
_SMALL = 1e-12


def main() -> None:
    """Write the catalogue."""
    withheld = tomllib.loads(WITHHELD.read_text(encoding="utf-8"))["robot"]
    reasons = {entry["id"]: entry for entry in withheld}
    rows: list[list[Any]] = []
    for path in sorted(TABLES.glob("*.toml")):
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        maker = document["maker"]
        taken = [catalogue_robot(maker, robot) for robot in document["robot"] if robot["id"] not in reasons]
        _write_maker(CATALOGUE / f"{path.stem}.json", maker, taken)
        rows += [_index_row(path.stem, robot) for robot in taken]
    rows += [_withheld_row(entry) for entry in withheld]
    rows.sort(key=lambda row: row[0])
    lines = ",\n".join(json.dumps(row, ensure_ascii=False, separators=(",", ":")) for row in rows)
    (CATALOGUE / "index.json").write_text(f"[\n{lines}\n]\n", encoding="utf-8")


def catalogue_robot(maker: str, robot: Mapping[str, Any]) -> dict[str, Any]:
    """Return one robot as the keys of a model file, and where it comes from."""
    own_base = _read_pose(robot["controller_base"]) if "controller_base" in robot else np.eye(4)
    base = inverse_transform(own_base) @ _read_pose(robot.get("dh_base", {}))
    rows = [list(map(float, row)) for row in robot["dh"]]
    base = _carried_into_first_row(base, rows)
    found: dict[str, Any] = {
        "name": OWN_FILES.get(robot["id"], robot["id"]),
        "title": _robot_title(maker, robot["model"]),
        "maker": maker,
        "family": robot.get("family", ""),
        "kind": robot["kind"],
        "joints": [joint["name"] for joint in robot["joint"]],
        "joint_types": [joint["type"] for joint in robot["joint"]],
        **dict(zip(("theta_deg", "d_mm", "a_mm", "alpha_deg"), _table_columns(rows), strict=True)),
    }
    if "dh_sign" in robot:
        found["sign"] = robot["dh_sign"]
    if not np.allclose(base, np.eye(4), atol=_SMALL, rtol=0):
        found["base"] = _pose_table(base)
    if "dh_flange" in robot:
        found["flange"] = _pose_table(_read_pose(robot["dh_flange"]))
    found |= _joint_limits(robot)
    tip = _read_pose(robot["tip"])
    found["tips"] = {
        name: _pose_table(inverse_transform(tip) @ _read_pose(place))
        for name, place in robot.get("other_tips", {}).items()
    }
    found["bases"] = {robot["frames"]["base"]: _pose_table(inverse_transform(own_base))}
    found |= {"tip": robot["frames"]["tip"], "source": robot["source"], "doubts": _stated_doubts(robot)}
    if "reach" in robot:
        found["reach_mm"] = robot["reach"]["in_limits_mm"]
    return found


def _robot_title(maker: str, model: str) -> str:
    short = {"Techman (Omron)": "Techman", "Yaskawa Motoman": "Yaskawa", "Mitsubishi Electric": "Mitsubishi"}
    first = short.get(maker, maker)
    return model if model.lower().startswith(first.lower()) else f"{first} {model}"


def _table_columns(rows: list[list[float]]) -> list[list[float]]:
    return [[_round_value(row[i]) for row in rows] for i in range(4)]


def _carried_into_first_row(base: Array, rows: list[list[float]]) -> Array:
    """Put a base that is turned about and shifted along the first axis only into theta and d of the first row."""
    turned_about_z = abs(base[2, 2] - 1.0) < _SMALL and np.abs(base[:2, 3]).max() < _SMALL
    if not turned_about_z:
        return base
    rows[0][0] += float(np.degrees(np.arctan2(base[1, 0], base[0, 0])))
    rows[0][1] += float(base[2, 3]) * 1e3
    return np.eye(4)


def _joint_limits(robot: Mapping[str, Any]) -> dict[str, Any]:
    """Return limits and speeds of the controller's joints, the coupling, and limits that two joints share."""
    joints = robot["joint"]
    slides = [joint["type"] == "prismatic" for joint in joints]
    scale = [1e3 if slide else float(np.degrees(1.0)) for slide in slides]
    lower, upper = (
        np.array([joint.get(side, turn * np.pi) for joint in joints]) * scale
        for side, turn in (("lower", -1.0), ("upper", 1.0))
    )
    found = _coupling_and_limits(robot, lower, upper) if "coupling" in robot else {}
    unit = "" if any(slides) else "_deg"
    found |= {
        f"{key}{unit}": [_round_limit(v) for v in side] for key, side in (("lower", lower), ("upper", upper))
    }
    if all("speed" in joint for joint in joints):
        speeds = [_round_limit(joint["speed"] * factor) for joint, factor in zip(joints, scale, strict=True)]
        found["speed" if unit == "" else "speed_deg_s"] = speeds
    return found


def _coupling_and_limits(robot: Mapping[str, Any], lower: Array, upper: Array) -> dict[str, Any]:
    """Return the coupling of two joints; where a limit is of their sum, widen the joint's own to what that allows."""
    coupled, other, factor = (robot["coupling"][key] for key in ("angle", "joint", "factor"))
    k, j = coupled - 1, other - 1
    sign = robot.get("dh_sign", [1] * len(lower))[k]
    found: dict[str, Any] = {"interaction": [[coupled, other, float(sign * factor)]]}
    if _limits_are_of_angles(robot):
        weights = [0.0] * len(lower)
        weights[k], weights[j] = 1.0, float(factor)
        ends = {"lower_deg": _round_limit(lower[k]), "upper_deg": _round_limit(upper[k])}
        found["combined_limits"] = [{"weights": weights, **ends}]
        most = sorted((factor * lower[j], factor * upper[j]))
        lower[k], upper[k] = lower[k] - most[1], upper[k] - most[0]
    return found


def _limits_are_of_angles(robot: Mapping[str, Any]) -> bool:
    """Return whether the source limits the angle of the chain: FANUC's own descriptions do."""
    return bool(robot["source"]["repo"].startswith("FANUC-CORPORATION/"))


def _stated_doubts(robot: Mapping[str, Any]) -> list[str]:
    doubts = list(robot.get("doubts", []))
    if "tip_note" in robot:
        doubts.append(robot["tip_note"])
    if any(joint["type"] == "continuous" for joint in robot["joint"]):
        doubts.append("The source gives no limits for every joint: one turn about zero stands for them.")
    if "coupling" in robot and not _limits_are_of_angles(robot):
        doubts.append(_OF_PENDANT.format(joint=robot["coupling"]["angle"], other=robot["coupling"]["joint"]))
    if robot["kind"] == "linkage":
        doubts.append(_WITH_RODS)
    return doubts


def _read_pose(table: Mapping[str, Any]) -> Array:
    rpy = np.array(table.get("rpy", [0.0] * 3), dtype=float)
    quarters = rpy / (np.pi / 12)  # the tables write multiples of 15 degrees with twelve digits
    rounded = np.round(quarters)
    exact = np.where(np.abs(quarters - rounded) < 1e-9, rounded * (np.pi / 12), rpy)
    return homogeneous_matrix(
        rotation_from("ros_rpy", exact), np.array(table.get("xyz", [0.0] * 3), dtype=float)
    )


def _pose_table(pose: Array) -> dict[str, list[float]]:
    angles = np.degrees(values_from("ros_rpy", pose[:3, :3]))
    return {
        "xyz_mm": [_round_value(v * 1e3) for v in pose[:3, 3]],
        "rpy_deg": [_round_value(v) for v in angles],
    }


def _round_value(value: float) -> float:
    return round(float(value), 9) + 0.0


def _round_limit(value: float) -> float:
    return round(float(value), 5) + 0.0


def _write_maker(path: Path, maker: str, robots: list[dict[str, Any]]) -> None:
    lines = ",\n".join(json.dumps(robot, ensure_ascii=False, separators=(",", ":")) for robot in robots)
    path.write_text(f'{{"maker":{json.dumps(maker)},"robots":[\n{lines}\n]}}\n', encoding="utf-8")


def _index_row(file: str, robot: Mapping[str, Any]) -> list[Any]:
    keys = ("name", "title", "maker", "family", "kind")
    more = [len(robot["joints"]), robot["source"]["licence"], len(robot["doubts"]), file, ""]
    return [*(robot[key] for key in keys), *more]


def _withheld_row(entry: Mapping[str, Any]) -> list[Any]:
    title = _robot_title(entry["maker"], entry["model"])
    return [
        entry["id"],
        title,
        entry["maker"],
        "",
        entry["kind"],
        entry["joints"],
        "",
        0,
        "",
        entry["reason"],
    ]


if __name__ == "__main__":
    main()
