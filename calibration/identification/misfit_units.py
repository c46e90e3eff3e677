"""Which unit positions or lengths are in, told by the fit: where several let the target move as far as the arm."""

from collections.abc import Mapping
from math import log

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit import fit_quickly
from cellcal.calibration.identification.observations import LengthObservations
from cellcal.calibration.identification.quick_fit import some_rows, trimmed_point_scores

_MOST_ROWS = 60
_FEWEST_POINTS, _FEWEST_LENGTHS = 8, 14
_PLAUSIBLE = log(4.0)
_CLEAR = 0.4  # of the second best: below, the fit has told
_MOST_LEFT = 0.05  # of the motion
_LONGEST_M, _SHORTEST_M = 30.0, 0.05


def unit_of_points(model: RobotModel, joints_rad: Array, values: Array, units: Mapping[str, float]) -> str:
    """Return the unit in which positions (N, 3) fit the arm; empty if the fit does not tell."""
    if len(values) < _FEWEST_POINTS:
        return ""
    rows = some_rows(len(values), _MOST_ROWS)
    flanges, some = model.base_flange(joints_rad[rows]), values[rows]
    moved, seen = _spread(flanges[:, :3, 3]), _spread(some)
    if min(moved, seen) <= 0.0:
        return ""
    names = [name for name, metres in units.items() if abs(log(seen * metres / moved)) < _PLAUSIBLE]
    if len(names) < 2:
        return "".join(names)
    scales = np.array([units[name] for name in names])
    positions = scales[:, None, None] * some
    frames = np.broadcast_to(flanges, (len(names), *flanges.shape))
    left = np.minimum(
        *(
            trimmed_point_scores(frames, positions, np.full(len(names), mirrored))
            for mirrored in (False, True)
        )
    )
    return _clearly(names, left / (seen * scales))


def unit_of_lengths(model: RobotModel, joints_rad: Array, values: Array, units: Mapping[str, float]) -> str:
    """Return the unit in which lengths (N,) fit the arm; empty if the fit does not tell."""
    if len(values) < _FEWEST_LENGTHS:
        return ""
    rows = some_rows(len(values), _MOST_ROWS)
    usual = float(np.median(np.abs(values)))
    names = [name for name, metres in units.items() if _SHORTEST_M < usual * metres < _LONGEST_M]
    left = []
    for name in names:
        metres = units[name]
        once, sigma = np.zeros(len(rows), dtype=np.intp), np.full(len(rows), 3e-4)
        seen = LengthObservations(joints_rad[rows], values[rows] * metres, sigma, once)
        left.append(fit_quickly(model, seen).score_m / max(float(np.std(values[rows])) * metres, 1e-9))
    return _clearly(names, np.array(left))


def _clearly(names: list[str], left: Array) -> str:
    """Return the unit that leaves least of the motion, if it leaves little and clearly less than the others."""
    if not len(names):
        return ""
    order = np.argsort(left)
    best = int(order[0])
    if left[best] > _MOST_LEFT or (len(names) > 1 and left[best] > _CLEAR * left[order[1]]):
        return ""
    return names[best]


def _spread(points: Array) -> float:
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
