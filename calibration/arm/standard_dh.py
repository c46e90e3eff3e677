"""Denavit-Hartenberg rows of any chain: four numbers a joint, as controllers keep them, or with Hayati's beta.

Where two axes are nearly parallel the common normal lies far away, and lengths of hundreds of metres cancel.
That is what a controller expects of a standard table;
`calibration.arm.ur_factory.to_well_conditioned` is the way back.
With Hayati's rule such a row has no d of its own, but a turn beta about y, and every number stays near nominal.
"""

import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.dh_table import row_matrix
from cellcal.calibration.arm.kinematics import DhTable, RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix, inverse_transform
from cellcal.calibration.orientation import elementary_rotation

_PARALLEL = 1e-9  # sine of the angle between two axes, below which they have no common normal of their own
_NEARLY = 0.1
_APART_M = 1e-3


@dataclass(frozen=True, eq=False)
class StandardTable:
    """A table of four numbers a joint, and what it cannot hold: ``base_flange = table @ rest``."""

    table: DhTable
    flange_rest: Array  # (4, 4): a correction of the flange, to be kept in the tool


def standard_dh(model: RobotModel, nominal: RobotModel) -> StandardTable:
    r"""Write a chain in standard DH, close to a nominal table.

    Each axis is a line; the row between two lines is their common normal. A turn about the next axis and a
    travel along it are left for the next row. The last row keeps its nominal a and alpha: what they cannot say
    about the flange is the rest.

    Parameters
    ----------
    model : RobotModel
        Any placements; same base frame and joint coupling as the nominal model.
    nominal : RobotModel
        With a DH table, for the signs where both are possible.

    Raises
    ------
    CalibrationError
        Another base frame or coupling, or a nominal model without a table.

    References
    ----------
    J. Denavit, R. S. Hartenberg, A kinematic notation for lower-pair mechanisms based on matrices, 1955.
    """
    return _standard_table(model, nominal, frozenset())


def hayati_dh(model: RobotModel, nominal: RobotModel) -> StandardTable:
    """Write a chain in DH, with Hayati's beta instead of d wherever the nominal axes are parallel.

    The origin of such a row is where the next axis pierces the plane across the axis before, at the nominal d.

    Parameters
    ----------
    model, nominal : RobotModel
        As for `standard_dh`.

    References
    ----------
    S. Hayati, Robot arm geometric link parameter estimation, 1983, IEEE CDC.
    """
    return _standard_table(model, nominal, frozenset(parallel_rows(nominal)))


def parallel_rows(nominal: RobotModel) -> tuple[int, ...]:
    """Return the rows (0-based) whose axis and the next are parallel, but not one line, in a table."""
    if nominal.dh is None:
        return ()
    rows = nominal.dh.to_rows()[:-1]
    return tuple(
        i for i, row in enumerate(rows) if abs(math.sin(row[3])) < _NEARLY and abs(row[2]) > _APART_M
    )


def _standard_table(model: RobotModel, nominal: RobotModel, hayati: frozenset[int]) -> StandardTable:
    same_base = np.allclose(model.placements[0], nominal.placements[0], rtol=0, atol=1e-12)
    if nominal.dh is None or model.axis_count != nominal.axis_count or not same_base:
        raise CalibrationError(f"{model.label}: a table needs a nominal model with a table and the same base")
    if not np.allclose(model.joint_coupling, nominal.joint_coupling):
        raise CalibrationError(f"{model.label} couples its joints in another way than {nominal.label}")
    expected = nominal.dh.to_rows()
    rows = np.zeros((model.axis_count, 5))
    carried = np.eye(4)
    for i in range(model.axis_count):
        step = _turn_about_z(float(model.theta0_rad[i])) @ carried @ model.placements[i + 1]
        if i + 1 < model.axis_count:
            if i in hayati:
                rows[i] = _row_from_plane(step, expected[i])
            else:
                rows[i, :4] = _common_normal(step, expected[i])
            carried = inverse_transform(row_matrix(rows[i])) @ step
            carried[:3, :2], carried[:2, 3] = (
                _turn_about_z(math.atan2(carried[1, 0], carried[0, 0]))[:3, :2],
                0.0,
            )
            carried[:3, 2] = (0.0, 0.0, 1.0)
        else:
            rows[i] = _last_row(step, expected[i])
    rest = inverse_transform(row_matrix(rows[-1])) @ step
    rows[:, 0] = [
        t + math.remainder(v - t, 2 * math.pi) for v, t in zip(rows[:, 0], expected[:, 0], strict=True)
    ]
    return StandardTable(DhTable.from_rows(rows if hayati else rows[:, :4]), rest)


def _common_normal(step: Array, expected: Array) -> Array:
    """Return theta, d, a, alpha of the common normal from the z axis to the axis of ``step``."""
    axis, point = step[:3, 2], step[:3, 3]
    across = math.hypot(axis[0], axis[1])
    if across < _PARALLEL:
        sign = -1.0 if expected[2] < 0 else 1.0
        far = math.hypot(point[0], point[1]) > _PARALLEL
        theta = math.atan2(sign * point[1], sign * point[0]) if far else float(expected[0])
        return np.array([theta, point[2], sign * math.hypot(point[0], point[1]), math.acos(np.sign(axis[2]))])
    # alpha is positive where the nominal axes are parallel, else of the nominal sign
    sign = -1.0 if abs(math.sin(expected[3])) > _NEARLY and math.sin(expected[3]) < 0 else 1.0
    normal = sign * np.array([-axis[1], axis[0], 0.0]) / across
    d, a, _ = np.linalg.solve(np.column_stack([[0.0, 0.0, 1.0], normal, axis]), point)
    return np.array([math.atan2(normal[1], normal[0]), d, a, math.atan2(sign * across, axis[2])])


def _row_from_plane(step: Array, expected: Array) -> Array:
    """Return theta, the nominal d, a, alpha, beta: where the axis of ``step`` meets the plane at d, and its tilt."""
    axis, point = step[:3, 2] * np.sign(step[2, 2]) * np.sign(math.cos(expected[3])), step[:3, 3]
    point = point + axis * (expected[1] - point[2]) / axis[2]
    sign = -1.0 if expected[2] < 0 else 1.0
    theta = math.atan2(sign * point[1], sign * point[0])
    x, y, z = _turn_about_z(-theta)[:3, :3] @ axis
    length = sign * math.hypot(point[0], point[1])
    alpha = expected[3] + math.remainder(math.atan2(-y, z) - expected[3], 2 * math.pi)
    return np.array([theta, expected[1], length, alpha, math.asin(x)])


def _last_row(step: Array, expected: Array) -> Array:
    tilted = step[:3, :3] @ elementary_rotation("x", -expected[3])
    theta = math.atan2(tilted[1, 0] - tilted[0, 1], tilted[0, 0] + tilted[1, 1])
    return np.array([theta, step[2, 3], expected[2], expected[3], 0.0])


def _turn_about_z(angle: float) -> Array:
    return homogeneous_matrix(elementary_rotation("z", np.array(angle)), np.zeros(3))
