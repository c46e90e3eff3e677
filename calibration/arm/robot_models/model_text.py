"""One robot as data: the keys of a model file, checked and turned into SI."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import radians
from typing import Any

import numpy as np

from cellcal.calibration.arm.joint_kinds import JOINT_TYPES, PRISMATIC, CombinedLimit
from cellcal.calibration.arm.model_scale import refuse_radians
from cellcal.calibration.arm.mounting import gravity_of
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from

UNKNOWN_SPEED = (1.0, 0.1)  # rad/s and m/s, where nothing is stated: slow enough for any arm
_NEEDED = {"title", "joints", "dh_source", "theta_deg", "d_mm", "a_mm", "alpha_deg", "limits_source"}
_OPTIONAL = {
    "sign", "interaction", "interaction_source", "mounting", "speed_source", "speed_deg_s", "lower_deg", "upper_deg",
    "joint_types", "lower", "upper", "speed", "base", "flange", "combined_limits", "tips", "bases", "maker", "family",
    "doubts",
}  # fmt: skip
# Of a model with a prismatic joint a number is degrees or millimetres, as its joint is.
_PLAIN = {"lower": "lower_deg", "upper": "upper_deg", "speed": "speed_deg_s"}


@dataclass(frozen=True, eq=False)
class ModelText:
    """The contents of a model file."""

    fields: dict[str, Any]  # of `RobotModel.from_dh`, with DH ``rows`` (n, 4)
    tips: dict[str, Array] = field(default_factory=dict)  # (4, 4): further frames at the flange, seen from it
    bases: dict[str, Array] = field(
        default_factory=dict
    )  # (4, 4): further base frames, seen from the model's base


def read_model_text(name: str, text: str) -> ModelText:
    """Read the text of a model file; refuses unknown keys, missing sources and columns of another length.

    Raises
    ------
    CalibrationError
        With the name of the model and what is wrong.
    """
    try:
        data = parse_toml(text)
    except DocumentError as error:
        raise CalibrationError(
            make_message("robot model {name}: {message}", name=name, message=error.message),
            remedy=error.remedy,
        ) from error
    needed_keys = _NEEDED | ({"speed_source"} & _sourced_keys(data))
    missing, unknown = needed_keys - data.keys(), data.keys() - _NEEDED - _OPTIONAL
    if missing or unknown:
        raise CalibrationError(
            make_message(
                "robot model {name}: missing {missing}, unknown {unknown} keys",
                name=name,
                missing=sorted(missing),
                unknown=sorted(unknown),
            ),
            remedy="calibration/arm/robot_models/README.md lists the keys of a model file.",
        )
    if "interaction" in data and "interaction_source" not in data:
        raise CalibrationError(
            make_message(
                "robot model {name}: where does the interaction come from? Give interaction_source", name=name
            )
        )
    return model_of_data(name, data)


def model_of_data(name: str, data: Mapping[str, Any]) -> ModelText:
    """Return the numbers of one robot in SI.

    Raises
    ------
    CalibrationError
        A column of another length, a number that is not finite, a type of joint that is none.
    """
    n = len(data["joints"])
    types = tuple(data.get("joint_types", ()))
    if types and (len(types) != n or not set(types) <= set(JOINT_TYPES)):
        raise CalibrationError(
            make_message(
                "robot model {name}: joint_types needs {n} of {joint_types_text}",
                name=name,
                n=n,
                joint_types_text=", ".join(JOINT_TYPES),
            )
        )
    _refuse_names(name, data["joints"])
    for key in ("theta_deg", "alpha_deg"):
        refuse_radians(name, key, _read_column(name, data, key, n))
    slides = np.array([kind == PRISMATIC for kind in types or ("",) * n])
    fields: dict[str, Any] = {
        "title": data["title"],
        "rows": np.stack(
            [
                np.deg2rad(_read_column(name, data, "theta_deg", n)),
                _read_column(name, data, "d_mm", n) / 1e3,
                _read_column(name, data, "a_mm", n) / 1e3,
                np.deg2rad(_read_column(name, data, "alpha_deg", n)),
            ],
            axis=1,
        ),
        "joint_coupling": _read_coupling(name, data, n),
        "lower_rad": _of_joints(name, data, "lower", slides),
        "upper_rad": _of_joints(name, data, "upper", slides),
        "max_speed_rad_s": _read_speeds(name, data, slides),
        "joint_names": tuple(data["joints"]),
    }
    if "mounting" in data:
        fields["gravity_in_base"] = gravity_of(data["mounting"])
    if types:
        fields["joint_types"] = types
    if "combined_limits" in data:
        fields["combined_limits"] = _read_combined_limits(name, data["combined_limits"], slides)
    fields |= {key: _read_frame(name, key, data[key]) for key in ("base", "flange") if key in data}
    further = {key: _read_frames(name, key, data.get(key, {})) for key in ("tips", "bases")}
    return ModelText(fields, further["tips"], further["bases"])


def _refuse_names(name: str, joints: Any) -> None:
    """Refuse names of joints that are no texts, empty, or given twice: columns and results go by them."""
    texts = isinstance(joints, list | tuple) and all(
        isinstance(joint, str) and joint.strip() for joint in joints
    )
    if not texts or len(set(joints)) < len(joints):
        raise CalibrationError(
            make_message(
                "robot model {name}: joints needs a name for each joint, and no name twice.", name=name
            ),
            remedy='Write them as texts: joints = ["J1", "J2"].',
        )


def _sourced_keys(data: Mapping[str, Any]) -> set[str]:
    return {"speed_source"} if {"speed", "speed_deg_s"} & data.keys() else set()


def _read_column(name: str, data: Mapping[str, Any], key: str, n: int) -> Array:
    try:
        values = np.array(data[key], dtype=float)
    except (TypeError, ValueError) as broken:
        raise CalibrationError(
            make_message("robot model {name}: {key} needs {n} finite numbers", name=name, key=key, n=n)
        ) from broken
    if values.shape != (n,) or not np.isfinite(values).all():
        raise CalibrationError(
            make_message("robot model {name}: {key} needs {n} finite numbers", name=name, key=key, n=n)
        )
    return values


def _of_joints(name: str, data: Mapping[str, Any], key: str, slides: Any) -> Array:
    """Return a column in rad, or metres of the joints that slide."""
    plain = _PLAIN[key]
    if slides.any() and plain in data:
        raise CalibrationError(
            make_message(
                "robot model {name}: {plain} cannot hold a joint that slides.", name=name, plain=plain
            ),
            remedy=make_message("Write {key}, in degrees, and in millimetres of a prismatic joint.", key=key),
        )
    used = key if key in data else plain
    if used not in data:
        raise CalibrationError(
            make_message("robot model {name}: missing ['{plain}'], unknown [] keys", name=name, plain=plain)
        )
    values = _read_column(name, data, used, len(slides))
    return np.where(slides, values / 1e3, np.deg2rad(values))


def _read_speeds(name: str, data: Mapping[str, Any], slides: Any) -> Array:
    if not {"speed", "speed_deg_s"} & data.keys():
        return np.where(slides, UNKNOWN_SPEED[1], UNKNOWN_SPEED[0])
    speeds = _of_joints(name, data, "speed", slides)
    if (speeds <= 0.0).any():
        raise CalibrationError(
            make_message("robot model {name}: a speed is not above zero", name=name),
            remedy="Write the greatest speed of each joint as a positive number, or leave the line of speeds out.",
        )
    return speeds


def _read_coupling(name: str, data: Mapping[str, Any], n: int) -> Array:
    """DH angle = sign * joint; ``interaction = [[3, 2, 1.0]]``: DH angle 3 also turns with joint 2."""
    signs = np.array(data.get("sign", [1] * n), dtype=float)
    if signs.shape != (n,) or not (np.abs(signs) == 1.0).all():
        raise CalibrationError(
            make_message("robot model {name}: sign needs {n} times 1 or -1", name=name, n=n)
        )
    coupling = np.diag(signs)
    for row in data.get("interaction", []):
        if not isinstance(row, list | tuple) or len(row) != 3:
            raise CalibrationError(
                make_message(
                    "robot model {name}: a row of interaction is [DH angle, joint, factor], such as [3, 2, 1.0]",
                    name=name,
                )
            )
        angle, joint, factor = row
        if not (1 <= angle <= n and 1 <= joint <= n):
            raise CalibrationError(
                make_message("robot model {name}: the interaction names an axis that is not there", name=name)
            )
        coupling[angle - 1, joint - 1] += factor
    return coupling


def _read_combined_limits(
    name: str, tables: Sequence[Mapping[str, Any]], slides: Any
) -> tuple[CombinedLimit, ...]:
    """Read ``{weights = [0, 1, 1, 0, 0, 0], lower_deg = -79, upper_deg = 180}``: limits of a sum of joints."""
    found = []
    for table in tables:
        if set(table) != {"weights", "lower_deg", "upper_deg"}:
            raise CalibrationError(
                make_message(
                    "robot model {name}: a combined limit has weights, lower_deg and upper_deg", name=name
                )
            )
        weights = _read_column(name, table, "weights", len(slides))
        if weights[slides].any():
            raise CalibrationError(
                make_message("robot model {name}: a combined limit is of joints that turn", name=name)
            )
        ends = (radians(table["lower_deg"]), radians(table["upper_deg"]))
        found.append(CombinedLimit(tuple(float(w) for w in weights), *ends))
    return tuple(found)


def _read_frame(name: str, key: str, table: Any) -> Array:
    """Read ``{xyz_mm = [x, y, z], rpy_deg = [r, p, y]}``, as a description of ROS writes an origin."""
    if not isinstance(table, Mapping) or not set(table) <= {"xyz_mm", "rpy_deg"}:
        raise CalibrationError(
            make_message("robot model {name}: {key} has xyz_mm and rpy_deg", name=name, key=key)
        )
    where = {"xyz_mm": [0.0] * 3, "rpy_deg": [0.0] * 3} | dict(table)
    angles = np.deg2rad(_read_column(f"{name}, {key}", where, "rpy_deg", 3))
    return homogeneous_matrix(
        rotation_from("ros_rpy", angles), _read_column(f"{name}, {key}", where, "xyz_mm", 3) / 1e3
    )


def _read_frames(name: str, key: str, table: Any) -> dict[str, Array]:
    if not isinstance(table, Mapping):
        raise CalibrationError(make_message("robot model {name}: {key} names frames", name=name, key=key))
    return {str(frame): _read_frame(name, f"{key}.{frame}", place) for frame, place in table.items()}
