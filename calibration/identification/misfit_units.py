"""Which unit positions or lengths are in, told by the fit: where several let the target move as far as the arm."""

from collections.abc import Mapping
from math import log

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_fit import fit_quickly
from cellcal.calibration.identification.observations import LengthObservations
from cellcal.calibration.identification.quick_fit import spread_rows, trimmed_point_scores

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
    rows = spread_rows(len(values), _MOST_ROWS)
    flanges, some = model.base_flange(joints_rad[rows]), values[rows]
    moved, target_spread = _rms_spread(flanges[:, :3, 3]), _rms_spread(some)
    if min(moved, target_spread) <= 0.0:
        return ""
    names = [name for name, metres in units.items() if abs(log(target_spread * metres / moved)) < _PLAUSIBLE]
    if len(names) < 2:
        return "".join(names)
    scales = np.array([units[name] for name in names])
    positions = scales[:, None, None] * some
    frames = np.broadcast_to(flanges, (len(names), *flanges.shape))
    remaining = np.minimum(
        *(
            trimmed_point_scores(frames, positions, np.full(len(names), mirrored))
            for mirrored in (False, True)
        )
    )
    return _clearly_best(names, remaining / (target_spread * scales))


def unit_of_lengths(model: RobotModel, joints_rad: Array, values: Array, units: Mapping[str, float]) -> str:
    """Return the unit in which lengths (N,) fit the arm; empty if the fit does not tell."""
    if len(values) < _FEWEST_LENGTHS:
        return ""
    rows = spread_rows(len(values), _MOST_ROWS)
    usual = float(np.median(np.abs(values)))
    names = [name for name, metres in units.items() if _SHORTEST_M < usual * metres < _LONGEST_M]
    remaining: list[float] = []
    for name in names:
        lengths_m = values[rows] * units[name]
        once, sigma = np.zeros(len(rows), dtype=np.intp), np.full(len(rows), 3e-4)
        observations = LengthObservations(joints_rad[rows], lengths_m, sigma, once)
        spread_m = max(float(np.std(lengths_m)), 1e-9)
        # One that leaves clearly more than another is not wanted more exactly.
        limit_m = min(remaining, default=np.inf) / _CLEAR * spread_m
        remaining.append(fit_quickly(model, observations, limit_m=limit_m).score_m / spread_m)
    return _clearly_best(names, np.array(remaining))


def _clearly_best(names: list[str], remaining: Array) -> str:
    """Return the unit that leaves least of the motion, if it leaves little and clearly less than the others."""
    if not len(names):
        return ""
    order = np.argsort(remaining)
    best = int(order[0])
    if remaining[best] > _MOST_LEFT or (len(names) > 1 and remaining[best] > _CLEAR * remaining[order[1]]):
        return ""
    return names[best]


def _rms_spread(points: Array) -> float:
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
