"""Factory calibration of Universal Robots arms, turned into a chain that is well conditioned.

Every arm leaves the factory with its own DH table. Joints 2, 3 and 4 are nearly parallel, and standard DH
has no good parameters for that: d2, d3 and d4 may be hundreds of metres that cancel. Such numbers give the
right pose and are useless as a start of an identification, so they are rewritten with Hayati's beta, where
every length is about its nominal value and the pose is the same.
"""

import ast
import itertools
import math
import re
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.dh_table import row_matrix
from cellcal.calibration.arm.kinematics import DhTable, RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.message import make_message

Six = tuple[float, float, float, float, float, float]
_MASK = (1 << 64) - 1
_NEARLY_PARALLEL = 0.1  # sine of the angle between two axes


@dataclass(frozen=True, slots=True)
class FactoryCalibration:
    """The contents of a controller's ``calibration.conf``: deltas to the nominal table, standard DH."""

    delta_theta_rad: Six
    delta_a_m: Six
    delta_d_m: Six
    delta_alpha_rad: Six
    joint_checksum: tuple[int, ...] = ()
    linearised: bool = True  # otherwise the deltas are nominal or another arm's: treat as unknown

    def to_absolute(self, nominal: DhTable) -> DhTable:
        """Return the absolute table: nominal plus deltas."""
        deltas = [self.delta_theta_rad, self.delta_d_m, self.delta_a_m, self.delta_alpha_rad]
        return DhTable.from_rows(nominal.to_rows()[:, :4] + np.array(deltas).T)


def parse_calibration_conf(text: str) -> FactoryCalibration:
    """Read the text of ``calibration.conf``, section ``[mounting]``.

    Raises
    ------
    CalibrationError
        A missing key, or a list that does not hold six finite numbers.
    """
    lines = re.findall(r"^\s*(\w+)\s*=\s*([^#\n]*?)\s*(?:#.*)?$", text, flags=re.MULTILINE)
    values = dict(lines)
    if len(lines) > len(values):
        keys = [key for key, _ in lines]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise CalibrationError(
            make_message("calibration.conf holds {twice} twice.", twice=twice),
            remedy="Two files stand in one: divide it, and take the one of this arm.",
        )
    missing = [key for key in ("delta_theta", "delta_a", "delta_d", "delta_alpha") if key not in values]
    if missing:
        raise CalibrationError(
            make_message("calibration.conf lacks {missing_text}", missing_text=", ".join(missing))
        )
    checksum = (
        _parse_numbers("joint_checksum", values["joint_checksum"]) if "joint_checksum" in values else []
    )
    return FactoryCalibration(
        delta_theta_rad=_parse_six("delta_theta", values["delta_theta"]),
        delta_a_m=_parse_six("delta_a", values["delta_a"]),
        delta_d_m=_parse_six("delta_d", values["delta_d"]),
        delta_alpha_rad=_parse_six("delta_alpha", values["delta_alpha"]),
        joint_checksum=tuple(int(v) for v in checksum),
        linearised=values.get("calibration_status", "2") == "2",
    )


def factory_model(nominal: RobotModel, absolute: DhTable, *, name: str | None = None) -> RobotModel:
    """Return the arm with its factory table, rewritten so that no length is far from its nominal value.

    Parameters
    ----------
    nominal : RobotModel
        The shipped model of the type, for limits and names.
    absolute : DhTable
        Absolute standard DH, as in sub-package 5 of the primary interface, or `FactoryCalibration.absolute`.

    Raises
    ------
    CalibrationError
        The table does not belong to this type: a rewritten length is more than 20 mm, or an angle more than
        3 degrees, away from nominal.
    """
    if nominal.dh is None or len(absolute.theta_rad) != nominal.axis_count:
        raise CalibrationError(
            make_message(
                "{label}: a factory table needs a nominal DH model with as many axes", label=nominal.label
            )
        )
    table = to_well_conditioned(absolute, nominal.dh)
    change = np.abs(table.to_rows() - nominal.dh.to_rows()).max(axis=0)
    if not (change[[1, 2]].max() <= 0.02 and change[[0, 3, 4]].max() <= math.radians(3)):
        raise CalibrationError(
            make_message("the factory table does not belong to a {title}.", title=nominal.title),
            remedy="Check the robot type; compare the link lengths.",
        )
    return RobotModel.from_dh(
        table,
        name=name or f"{nominal.name}_factory",
        title=f"{nominal.title}, factory calibration",
        base=nominal.placements[0],
        joint_coupling=nominal.joint_coupling,
        lower_rad=nominal.lower_rad,
        upper_rad=nominal.upper_rad,
        max_speed_rad_s=nominal.max_speed_rad_s,
        joint_names=nominal.joint_names,
        gravity_in_base=nominal.gravity_in_base,
    )


def to_well_conditioned(table: DhTable, nominal: DhTable) -> DhTable:
    """Rewrite rows whose axis is nearly parallel to the next with ``d = 0`` and beta; no pose changes.

    The next joint's axis pierces the plane z = 0 of the joint's own frame at a point near the arm: this
    gives theta and a; alpha and beta tilt z onto the axis. What is left, a turn about the axis and a travel
    along it, belongs to the next joint.
    """
    rows = np.zeros((len(table.theta_rad), 5))
    turn = travel = 0.0
    for i, (theta, d, a, alpha) in enumerate(table.to_rows()[:, :4]):
        row = np.array([theta + turn, d + travel, a, alpha, 0.0])
        turn = travel = 0.0
        parallel = abs(math.sin(nominal.alpha_rad[i])) < _NEARLY_PARALLEL and i + 1 < len(rows)
        if parallel:
            row, turn, travel = _to_hayati(row, backwards=bool(nominal.a_m[i] < 0))
        row[0] = nominal.theta_rad[i] + _wrap_angle(row[0] - nominal.theta_rad[i])
        rows[i] = row
    return DhTable.from_rows(rows)


def calibration_hash(absolute: DhTable) -> str:
    """Return the name by which UR's ROS driver knows a calibration: ``calib_`` and a number.

    Equal names prove that a kinematics file belongs to the connected arm. The text that is hashed holds
    theta, d, a, alpha joint by joint with six significant digits; the hash is C++'s ``std::hash``.
    """
    text = "".join(f"{value:g}" for value in absolute.to_rows()[:, :4].ravel())
    return f"calib_{_libstdcxx_hash(text.encode())}"


def table_of_hash(table: DhTable, target_hash: str) -> DhTable | None:
    """Return the same arm's table written so that its hash is the one wanted; None where no way of writing has it.

    A table has many forms: where axes are nearly parallel theta may be half a turn on, with a and alpha of the
    other sign, or whole turns. A controller keeps the form in which its factory's optimisation ended.
    """
    parallel = [i for i, row in enumerate(table.to_rows()[:-1]) if abs(math.sin(row[3])) < _NEARLY_PARALLEL]
    for halves in itertools.product((False, True), repeat=len(parallel)):
        rows = table.to_rows()[:, :4]
        for i in itertools.compress(parallel, halves):
            rows[i] *= (1.0, 1.0, -1.0, -1.0)
            rows[i : i + 2, 0] -= math.pi
        turning = sorted({j for i in parallel for j in (i, i + 1)})
        for turns in itertools.product((0, -1, 1), repeat=len(turning)):
            written = rows.copy()
            written[turning, 0] += 2.0 * math.pi * np.array(turns)
            if calibration_hash(found := DhTable.from_rows(written)) == target_hash:
                return found
    return None


def _to_hayati(row: Array, *, backwards: bool) -> tuple[Array, float, float]:
    """Return the row with d = 0 and beta, and the turn and travel left for the next joint."""
    plain = row_matrix(row)
    direction, point = plain[:3, 2], plain[:3, 3]
    crossing = point - direction * (point[2] / direction[2])
    theta, a = math.atan2(crossing[1], crossing[0]), math.hypot(crossing[0], crossing[1])
    if backwards:
        theta, a = theta + math.pi, -a
    c, s = math.cos(theta), math.sin(theta)
    x, y, z = c * direction[0] + s * direction[1], c * direction[1] - s * direction[0], direction[2]
    new = np.array([theta, 0.0, a, math.atan2(-y, z), math.asin(x)])
    rest = inverse_transform(row_matrix(new)) @ plain
    return new, math.atan2(rest[1, 0], rest[0, 0]), float(rest[2, 3])


def _wrap_angle(angle: float) -> float:
    return math.remainder(angle, 2 * math.pi)


def _parse_six(key: str, text: str) -> Six:
    values = _parse_numbers(key, text)
    if len(values) != 6 or not all(math.isfinite(v) for v in values):
        raise CalibrationError(make_message("calibration.conf: {key} needs six finite numbers", key=key))
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)


def _parse_numbers(key: str, text: str) -> list[float]:
    try:
        return [float(value) for value in ast.literal_eval(text)]
    except (ValueError, SyntaxError, TypeError) as broken:
        raise CalibrationError(
            make_message("calibration.conf: {key} is not a list of numbers", key=key)
        ) from broken


def _libstdcxx_hash(data: bytes) -> int:
    """MurmurHash2 for 64 bit as libstdc++ has it, seed 0xc70f6907 (gcc, libsupc++/hash_bytes.cc)."""
    multiplier = 0xC6A4A7935BD1E995
    value = 0xC70F6907 ^ (len(data) * multiplier & _MASK)
    whole = len(data) & ~7
    for start in range(0, whole, 8):
        word = int.from_bytes(data[start : start + 8], "little") * multiplier & _MASK
        word = (word ^ word >> 47) * multiplier & _MASK
        value = (value ^ word) * multiplier & _MASK
    if len(data) > whole:
        value = (value ^ int.from_bytes(data[whole:], "little")) * multiplier & _MASK
    value = (value ^ value >> 47) * multiplier & _MASK
    return value ^ value >> 47
