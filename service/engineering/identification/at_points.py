"""The points of ``--at``: postures as joints, or as poses of the flange that are brought to joints first."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.joint_kinds import joint_columns_of, shown_units
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.compensation.posture_of_pose import postures_of_poses
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.csv_text import parse_rows
from cellcal.calibration.documents.plain_files import describe_unreadable, read_plain_text
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS, rotation_from
from cellcal.service.engineering.measured.cell_numbers import number_in
from cellcal.service.engineering.measured.headings import unit_of
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.measured.units import ANGLE_UNITS, LENGTH_UNITS
from cellcal.service.unexpected_errors import explain_os_error

_PLACE = ("x_mm", "y_mm", "z_mm")
_QUATERNION = ("qw", "qx", "qy", "qz")


@dataclass(frozen=True, slots=True)
class AtOptions:
    """The postures at which to predict the target's place, and how poses are meant."""

    path: Path
    convention: str = ""  # of the poses' attitude; none: quaternion qw, qx, qy, qz
    identified: bool = (
        False  # poses that the identified arm shall reach; else those that a controller is told
    )


@dataclass(frozen=True, eq=False)
class AtPoints:
    """The rows of such a file."""

    joints_rad: Array  # (N, n); of poses, once solved
    base_flange: Array | None  # (N, 4, 4) of a file of poses
    words: dict[str, tuple[str, ...]]  # columns that are no numbers, such as target


def read_points(options: AtOptions, arm: RobotModel | int) -> AtPoints:
    """Read joints of an arm, or of one with so many that turn.

    Joints are columns q1_deg, q2_deg, q3_mm of one that slides …; else they are flange poses in the robot's base
    (x_mm, y_mm, z_mm and an attitude).

    The attitude is qw, qx, qy, qz, or with a convention its own fields in degrees (``W_deg``, ``P_deg``, ``R_deg``).

    Raises
    ------
    MeasurementError
        The file is not there, lacks the columns, or holds what is no finite number.
    """
    try:
        text = read_plain_text(options.path)
        rows = parse_rows(text, _separator_of(text))
    except OSError as broken:
        why, cure = explain_os_error(broken)
        raise MeasurementError(why, remedy=cure) from broken
    except DocumentError as broken:
        raise MeasurementError(describe_unreadable(options.path, broken)) from broken
    if not rows:
        raise MeasurementError(
            make_message("{path} holds no rows.", path=options.path), remedy="Write one point a row."
        )
    axes = arm if isinstance(arm, int) else arm.axis_count
    names = joint_columns_in(arm)[0]
    attitude = _attitude_columns(options)
    words = {key: tuple(str(row.get(key) or "") for row in rows) for key in ("target",) if key in rows[0]}
    if set(names) <= rows[0].keys():
        return AtPoints(read_joint_rows(options.path, rows, arm), None, words)
    if not {*_PLACE, *attitude} <= rows[0].keys():
        raise MeasurementError(
            f"{options.path} holds neither joints nor poses.",
            remedy=f"Joints are columns {', '.join(names)}; poses {', '.join((*_PLACE, *attitude))}.",
        )
    places = _read_numbers(options.path, rows, _PLACE) * 1e-3
    turns = _read_numbers(options.path, rows, attitude)
    turns = turns if len(attitude) == len(_QUATERNION) else np.deg2rad(turns)
    try:
        rotations = rotation_from(options.convention or "abb_quaternion", turns)
    except CalibrationError as broken:
        raise MeasurementError(make_message("{path}: {broken}", path=options.path, broken=broken)) from broken
    return AtPoints(np.zeros((len(rows), axes)), homogeneous_matrix(rotations, places), words)


def _separator_of(text: str) -> str:
    """Return what stands between the names of the first line."""
    heading = text.partition("\n")[0]
    return next((mark for mark in (";", "\t") if mark in heading), ",")


def joint_columns_in(arm: RobotModel | int) -> tuple[tuple[str, ...], Array]:
    """Return the names of an arm's columns of joints, and what SI is multiplied with to be written there."""
    if isinstance(arm, int):
        return tuple(f"q{i + 1}_deg" for i in range(arm)), np.full(arm, np.degrees(1.0))
    return joint_columns_of(arm), shown_units(arm)[0]


def solve_joints(points: AtPoints, arm: TipArm, known_rad: Array) -> Array:
    """Return the joints (N, n) of all points; an arm reaches poses with its flange.

    Raises
    ------
    MeasurementError
        Poses that are out of reach, named.
    """
    if points.base_flange is None:
        return points.joints_rad
    found = postures_of_poses(arm, points.base_flange, known_rad)
    if not found.reached.all():
        lost = np.flatnonzero(~found.reached)
        some = ", ".join(str(int(i)) for i in lost[:8]) + (" …" if len(lost) > 8 else "")
        raise MeasurementError(
            f"{len(lost)} poses of {len(found.reached)} cannot be reached with the flange (rows {some}, counted "
            f"from 0; the first misses by {found.position_m[lost[0]] * 1e3:.1f} mm).",
            remedy="Poses are of the flange in the robot's base, without a tool. See `--at-convention`.",
        )
    return found.joints_rad


def _attitude_columns(options: AtOptions) -> tuple[str, ...]:
    if not options.convention:
        return _QUATERNION
    if options.convention not in CONVENTIONS:
        raise MeasurementError(
            make_message("no orientation is called {name!r}.", name=options.convention),
            remedy=make_message("There are {names}.", names=", ".join(CONVENTIONS)),
        )
    fields = CONVENTIONS[options.convention].fields
    return fields if len(fields) == len(_QUATERNION) else tuple(f"{field}_deg" for field in fields)


def _read_numbers(path: Path, rows: list[dict[str, str]], names: list[str] | tuple[str, ...]) -> Array:
    return np.array([_read_row(path, row, names, at) for at, row in enumerate(rows)])


def _read_row(path: Path, row: dict[str, str], names: list[str] | tuple[str, ...], at: int) -> list[float]:
    numbers = []
    for name in names:
        unit = unit_of(name)
        try:
            numbers.append(
                number_in(row.get(name) or "", unit, ANGLE_UNITS if unit in ANGLE_UNITS else LENGTH_UNITS)
            )
        except ValueError as broken:
            raise MeasurementError(
                make_message(
                    "{path}, point {point} (counted from 1), column {column}: {broken}.",
                    path=path,
                    point=at + 1,
                    column=name,
                    broken=str(broken),
                ),
                remedy="Write a number with a decimal point, in the unit of the column's name.",
            ) from broken
    return numbers


def read_joint_rows(path: Path, rows: list[dict[str, str]], arm: RobotModel | int) -> Array:
    """Return the joints (N, n) [rad, m] of rows with columns such as q1_deg, or q2_mm of a slide.

    Raises
    ------
    MeasurementError
        A cell holds no number in the unit of its column.
    """
    names, factors = joint_columns_in(arm)
    return _read_numbers(path, rows, names) / factors
