"""How an arm of six axes stands, as makers ask it: overhead or not, elbow up or down, from any model of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel, chain_frames
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError


@dataclass(frozen=True, eq=False)
class ArmShape:
    """The place of the wrist's centre; both measures change sign where two postures become one."""

    forward_m: Array  # (N,) of axis 1, along the x axis of the base that turns with it
    before_arm_m: Array  # (N,) of the line from axis 2 to axis 3, on the side it is on with that line upright


def arm_shape(model: RobotModel, joints: Array) -> ArmShape:
    """Return how an arm stands in postures (N, 6) [rad].

    The wrist's centre is the point of axis 5 nearest to axis 4, so that identified models, whose axes do not
    quite meet, are asked like nominal ones.

    Raises
    ------
    ProgramFileError
        The arm has not six axes.
    """
    if model.axis_count != 6:
        raise ProgramFileError(
            model.name,
            make_message(
                "flags and turns are known for six axes, not {axis_count}.", axis_count=model.axis_count
            ),
            remedy="Give the nominal or identified model of the robot that runs the program.",
        )
    rotations, origins = chain_frames(model, np.vstack([np.zeros(6), joints]))
    turned = np.einsum("ijn,kj->nik", rotations[1], rotations[1, :, :, 0])[1:]  # by axis 1 since zero
    forward, side = turned[:, :, 0], turned[:, :, 1]
    axes, points = rotations[:6, :, 2, 1:].transpose(0, 2, 1), origins[:6, :, 1:].transpose(0, 2, 1)
    wrist = _nearest_point(points[4], axes[4], points[3], axes[3])
    lower, upper = points[2] - points[1], wrist - points[2]
    return ArmShape(
        _dot_product(wrist - points[0], forward),
        _dot_product(np.cross(lower, upper), side)
        / np.linalg.norm(lower - _dot_product(lower, side)[:, None] * side, axis=1),
    )


def sign_options(value: Array, tolerance: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return whether values may be called at least zero, and whether they may be called negative."""
    return value >= -tolerance, value < tolerance


def _nearest_point(point: Array, axis: Array, other: Array, other_axis: Array) -> Array:
    """Return the point of each line that is nearest to another line, not parallel to it."""
    normal = np.cross(axis, other_axis)
    along = _dot_product(np.cross(other - point, other_axis), normal) / _dot_product(normal, normal)
    nearest: Array = point + along[:, None] * axis
    return nearest


def _dot_product(a: Array, b: Array) -> Array:
    product: Array = np.einsum("ni,ni->n", a, b)
    return product
