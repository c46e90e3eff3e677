"""Poses of the device seen from its target: a camera on the flange that looks at a board in the cell."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.observations import PointObservations
from cellcal.service.engineering.measured.attitude_fit import expected_attitudes, fitting_way
from cellcal.service.engineering.measured.attitudes import attitude_ways

_INVERSE_POSE = "_inverse_pose"
_BETTER = 0.25  # of the distances that the rows leave as they are written
_FEWEST = 8  # rows, or inverting explains too much


@dataclass(frozen=True, eq=False)
class InvertedPoses:
    """The target seen from the device, and the convention of the attitudes that were inverted."""

    points: PointObservations
    rotations: Array  # (N, 3, 3)
    convention: str


def is_inverse_pose(convention: str) -> bool:
    """Return whether a convention says that whole poses are to be inverted."""
    return convention.endswith(_INVERSE_POSE)


def invert_poses(
    model: RobotModel, points: PointObservations, turns: Array, fields: Sequence[str], convention: str
) -> InvertedPoses | None:
    """Invert whole poses, if the target then sits still on the flange as it does not in the rows as written.

    Parameters
    ----------
    points : PointObservations
        Positions as written.
    turns : (N, k)
        Attitudes as written [rad or 1].
    fields : sequence of str
        What the numbers of an attitude are called.
    convention : str
        One that `is_inverse_pose`, or none: then each is tried.
    """
    if len(points) < _FEWEST:
        return None
    named = convention.removesuffix(_INVERSE_POSE)
    found: list[tuple[float, InvertedPoses]] = []
    try:
        for name, rotations in attitude_ways(turns, fields, named).items():
            # The inverse of an inverse is another way of writing the same.
            back = np.swapaxes(rotations, 1, 2)
            inverted = replace(points, positions_m=-np.einsum("nij,nj->ni", back, points.positions_m))
            way = fitting_way(expected_attitudes(model, inverted), {name: back})
            if way.fits:
                pose = InvertedPoses(inverted, way.rotations, f"{name}{_INVERSE_POSE}")
                found.append((_left_m(model, inverted), pose))
        limit_m = np.inf if convention else _BETTER * _left_m(model, points)
    except CalibrationError:
        return None
    left_m, best = min(found, key=lambda each: each[0], default=(np.inf, None))
    return best if left_m <= limit_m else None


def _left_m(model: RobotModel, points: PointObservations) -> float:
    """Return how far (median) the target stays from one place on the flange of the nominal arm [m]."""
    start = first_guess(model, points)[0]
    reached = start.devices[0].device_base @ model.base_flange(points.joints_rad) @ start.flange_tool
    return float(np.median(np.linalg.norm(reached[:, :3, 3] - points.positions_m, axis=1)))
