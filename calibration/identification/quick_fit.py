"""Residuals of many readings of one file at once, by fits of base and tool alone: quick, for ranking hypotheses.

A reading is the same rows understood in another way: other joint angles, another unit, a mirrored axis. The arrays
have the reading first and the row second.
"""

from collections.abc import Callable, Sequence

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.first_guess import START_OFF_AXIS, stand_still
from cellcal.calibration.identification.observations import Rows

_KEPT_SHARE = 0.75  # of the rows: the others may be outliers
_UNTURNED = 1e-10
_ROUNDS = 12  # of the alternation between base and tool
_LENGTH_UNKNOWNS = 17
_BLOCK = 400  # readings at once


def point_scores(
    base_flange: Array, positions_m: Array, mirrored: Array, weights: Array | None = None
) -> Array:
    """Return the RMS residual [m] of the best rows of each reading (H,), base and tool fitted.

    Parameters
    ----------
    base_flange : (H, N, 4, 4)
        Flange poses of each reading.
    positions_m : (H, N, 3)
        Measured positions of each reading.
    mirrored : (H,) of bool
        Whether the base may only be a mirror image.
    weights : (H, N) or None
        Which rows take part.
    """
    sizes = np.linalg.norm(point_residuals(base_flange, positions_m, mirrored, weights), axis=2)
    scores: Array = trimmed_rms(sizes) / np.sqrt(max(1.0 - 3.0 / sizes.shape[1], 0.1))
    return scores


def trimmed_point_scores(base_flange: Array, positions_m: Array, mirrored: Array, rounds: int = 3) -> Array:
    """Return the same after fits to the rows that fitted best: outliers have no weight (H,)."""
    weights = None
    for _ in range(rounds):
        sizes = np.linalg.norm(point_residuals(base_flange, positions_m, mirrored, weights), axis=2)
        weights = (sizes <= np.quantile(sizes, _KEPT_SHARE, axis=1, keepdims=True)).astype(float)
    return point_scores(base_flange, positions_m, mirrored, weights)


def trimmed_joint_scores(model: RobotModel, joints_rad: Array, positions_m: Array) -> Array:
    """Return the same of one series of positions (N, 3) with joints of each reading (H, N, n)."""
    readings, rows = joints_rad.shape[:2]
    flanges = model.base_flange(joints_rad.reshape(-1, model.axis_count)).reshape(readings, rows, 4, 4)
    positions = np.broadcast_to(positions_m, (readings, rows, 3))
    return trimmed_point_scores(flanges, positions, np.zeros(readings, dtype=bool))


def refine_number(
    scores_of: Callable[[Array], Array], width: float, steps: Sequence[float], *, spread: float = 1.0
) -> float:
    """Return the number about zero with the least score.

    It is looked for within the width in the first step, then in each finer one within ``spread`` of the step before.
    """
    best = 0.0
    for step in steps:
        numbers = best + np.arange(-width, width + step / 2, step)
        best, width = float(numbers[int(np.argmin(scores_of(numbers)))]), spread * step
    return best


def point_residuals(
    base_flange: Array, positions_m: Array, mirrored: Array, weights: Array | None = None
) -> Array:
    """Return computed minus measured place of every row of every reading (H, N, 3) [m]."""
    parts = [
        _fit_residuals(
            base_flange[at : at + _BLOCK],
            positions_m[at : at + _BLOCK],
            mirrored[at : at + _BLOCK],
            None if weights is None else weights[at : at + _BLOCK],
        )
        for at in range(0, len(base_flange), _BLOCK)
    ]
    return np.concatenate(parts)


def _fit_residuals(base_flange: Array, positions_m: Array, mirrored: Array, weights: Array | None) -> Array:
    readings, rows = base_flange.shape[:2]
    turns, origins = base_flange[..., :3, :3], base_flange[..., :3, 3]
    if weights is None:
        weights = np.ones((readings, rows))
    share = weights / weights.sum(axis=1, keepdims=True)
    turn, origin, goal = (
        (share[:, None, :] @ values.reshape(readings, rows, -1))[:, 0]
        for values in (turns, origins, positions_m)
    )
    turn = turn.reshape(-1, 3, 3)
    moved, away = (
        (positions_m - goal[:, None]) * share[..., None],
        (origins - origin[:, None]) * share[..., None],
    )
    with_origins = np.swapaxes(moved, 1, 2) @ origins
    with_turns = (np.swapaxes(moved, 1, 2) @ turns.reshape(readings, rows, 9)).reshape(readings, 9, 3)
    turned_origins = (away.reshape(readings, 1, -1) @ turns.reshape(readings, -1, 3))[:, 0]
    inverse = np.linalg.pinv(np.eye(3) - np.swapaxes(turn, 1, 2) @ turn, rcond=_UNTURNED, hermitian=True)
    tip = np.where(stand_still(origins)[:, None], START_OFF_AXIS, np.zeros((readings, 3)))
    rotation = np.zeros((readings, 3, 3))
    for _ in range(_ROUNDS):
        spread = (with_turns @ tip[..., None]).reshape(readings, 3, 3) + with_origins
        rotation = _nearest_rotations(spread, mirrored)
        rotated_origins = (rotation.reshape(readings, 1, 9) @ with_turns)[:, 0] - turned_origins
        tip = (inverse @ rotated_origins[..., None])[..., 0]
    arm = (turns @ tip[:, None, :, None])[..., 0] + origins
    centre = (turn @ tip[..., None])[..., 0] + origin
    predicted = (arm - centre[:, None]) @ np.swapaxes(rotation, 1, 2) + goal[:, None]
    residuals: Array = predicted - positions_m
    return residuals


def _nearest_rotations(spread: Array, mirrored: Array) -> Array:
    """Return the rotation, or the rotation with a mirror, nearest to each matrix (H, 3, 3)."""
    left, _, right = np.linalg.svd(spread)
    sign = np.linalg.det(left) * np.linalg.det(right)
    left[..., 2] *= (sign * np.where(mirrored, -1.0, 1.0))[:, None]
    nearest: Array = left @ right
    return nearest


def length_scores(base_flange: Array, lengths_m: Array, *, free_zero: bool = False) -> Array:
    """Return the RMS residual [m] of the best rows of each reading (H,), anchor and tool fitted.

    ``l^2 = |F x + c - a|^2`` is linear in x, a, their products and one constant, and in the wire's zero if that is
    free: one linear solution each, whatever the tool is. Needs more than 17 rows.
    """
    parts = [
        trimmed_rms(
            _length_residuals(base_flange[at : at + _BLOCK], lengths_m[at : at + _BLOCK], free_zero=free_zero)
        )
        for at in range(0, len(base_flange), _BLOCK)
    ]
    share = 1.0 - _LENGTH_UNKNOWNS / base_flange.shape[1]
    scores: Array = np.concatenate(parts) / np.sqrt(max(share, 0.1))
    return scores


def _length_residuals(base_flange: Array, lengths_m: Array, *, free_zero: bool) -> Array:
    readings, rows = base_flange.shape[:2]
    turns, origins = base_flange[..., :3, :3], base_flange[..., :3, 3]
    columns = [
        2.0 * np.einsum("hnji,hnj->hni", turns, origins),
        -2.0 * origins,
        -2.0 * turns.reshape(readings, rows, 9),
        np.ones((readings, rows, 1)),
    ]
    if free_zero:
        columns.append(2.0 * lengths_m[..., None])
    weight = 0.5 / np.maximum(np.abs(lengths_m), 1e-3)  # of a square's residual as one of a length
    design = np.concatenate(columns, axis=2) * weight[..., None]
    goal = (lengths_m**2 - (origins**2).sum(axis=2)) * weight
    solution = np.linalg.pinv(design, rcond=1e-9) @ goal[..., None]
    sizes: Array = np.abs((design @ solution)[..., 0] - goal)
    return sizes


def has_enough_lengths(rows: int) -> bool:
    """Return whether so many lengths carry the linear solution, with some to judge by."""
    return rows >= _LENGTH_UNKNOWNS + 6


def trimmed_rms(sizes: Array) -> Array:
    """Return the RMS over the smallest three quarters of the rows (..., N)."""
    count = max(int(np.ceil(_KEPT_SHARE * sizes.shape[-1])), 1)
    best = np.partition(sizes, count - 1, axis=-1)[..., :count]
    rms: Array = np.sqrt((best**2).mean(axis=-1))
    return rms


def spread_rows(count: int, most: int) -> Rows:
    """Return rows spread evenly over a series."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))
