"""Which way to read attitudes makes the tool sit still in the flange."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, log_rotation, mean_rotation
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.observations import PointObservations

_CONSISTENT_RAD = float(np.deg2rad(2.0))
_EQUAL = 1.001
_DISTINCT = 0.5  # the best orientation convention must be twice as consistent as the next


@dataclass(frozen=True, eq=False)
class FittingWay:
    """A way to read attitudes, and how much the tool then turns in the flange."""

    name: str
    rotations: Array  # (N, 3, 3)
    wobble_rad: float
    fits: bool  # and no other way does nearly as well


def fitting_way(expected: Array, ways: Mapping[str, Array]) -> FittingWay:
    """Return the way whose rotations (N, 3, 3) turn least against the expected flange, and whether it fits."""
    wobble = {name: _wobble_rad(expected, rotations) for name, rotations in ways.items()}
    best = min(wobble, key=lambda name: wobble[name])
    rivals = [value for value in wobble.values() if value > wobble[best] * _EQUAL]
    fits = wobble[best] <= _CONSISTENT_RAD and not (rivals and wobble[best] > _DISTINCT * min(rivals))
    return FittingWay(best, ways[best], wobble[best], fits)


def expected_attitudes(model: RobotModel, points: PointObservations) -> Array:
    """Return the attitudes (N, 3, 3) of the nominal flange in the frame of the device."""
    start = first_guess(model, points)[0]
    expected: Array = start.devices[0].device_base[:3, :3] @ model.base_flange(points.joints_rad)[:, :3, :3]
    return expected


def _wobble_rad(expected: Array, measured: Array) -> float:
    """Return how much the tool turns in the flange, median over the rows [rad]."""
    relative = np.swapaxes(expected, 1, 2) @ measured
    try:
        mean = mean_rotation(relative)
    except CalibrationError:
        return float(np.pi)
    return float(np.median(np.linalg.norm(log_rotation(mean.T @ relative), axis=1)))
