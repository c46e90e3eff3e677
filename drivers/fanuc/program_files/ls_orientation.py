"""W, P, R that say a new orientation and leave of the old numbers what can stay.

R turns about z, P about y, W about x, and the rotation is Rz(R) Ry(P) Rx(W). Near P = +-90 deg only W -+ R is
defined; there the old R stays and W takes the whole turn.
"""

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array
from cellcal.calibration.orientation import elementary_rotation, values_from

_LEFT_OF_A_DIGIT = 0.1  # of the last decimal: by how much keeping R near the lock may bend the orientation


def new_coordinates(frame_tip: Array, old: Array, decimals: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return X Y Z W P R (K, 6) [mm, deg] of poses (K, 4, 4), and which of them the old ones do not say already."""
    new = np.empty_like(old)
    new[:, :3] = 1e3 * frame_tip[:, :3, 3]
    new[:, 3:] = wpr_deg(frame_tip[:, :3, :3], old[:, 3:], decimals[:, 3:])
    return new, np.abs(new - old) > 0.5 * 10.0**-decimals * (1 - 1e-9)


def wpr_deg(rotation: Array, old_deg: Array, decimals: Array) -> Array:
    """Return (K, 3) W, P, R [deg]: rotations (K, 3, 3) beside what stood there, rounded to (K, 3) decimals.

    A number that need not change is the old one exactly.
    """
    half = 0.5 * 10.0**-decimals * (1 - 1e-9)
    exact = _nearest_wpr(np.degrees(values_from("fanuc_wpr", rotation)), old_deg)
    lock = np.abs(np.cos(np.radians(exact[:, 1])))
    slack = _LEFT_OF_A_DIGIT * np.radians(10.0 ** -decimals.max(axis=1))
    turned = np.radians(np.abs(_wrap_angles(exact[:, 2] - old_deg[:, 2])))
    locked = lock * np.minimum(turned, 2.0) < slack
    is_unchanged = np.abs(_wrap_angles(exact - old_deg)) <= half
    is_unchanged[locked, 2] = True
    is_unchanged[locked, 0] = False
    r = np.where(is_unchanged[:, 2], old_deg[:, 2], _round_angles(exact[:, 2], decimals[:, 2]))
    p = np.where(is_unchanged[:, 1], old_deg[:, 1], _round_angles(exact[:, 1], decimals[:, 1]))
    w = np.where(is_unchanged[:, 0], old_deg[:, 0], _best_w(rotation, p, r))
    w = np.where(np.abs(_wrap_angles(w - old_deg[:, 0])) <= half[:, 0], old_deg[:, 0], w)
    return np.stack([w, p, r], axis=1)


def _best_w(rotation: Array, p_deg: Array, r_deg: Array) -> Array:
    """Return the W that fits best beside rounded P and R, so that their rounding is made up for."""
    outer = elementary_rotation("z", np.radians(r_deg)) @ elementary_rotation("y", np.radians(p_deg))
    rest = np.swapaxes(outer, -1, -2) @ rotation
    return np.asarray(
        np.degrees(np.arctan2(rest[:, 2, 1] - rest[:, 1, 2], rest[:, 1, 1] + rest[:, 2, 2])), dtype=float
    )


def _nearest_wpr(exact_deg: Array, old_deg: Array) -> Array:
    """Return the other way to write the same rotation where the old P lies beyond +-90 deg."""
    beyond = np.abs(_wrap_angles(old_deg[:, 1])) > 90.0
    other = _wrap_angles(np.array([180.0, 180.0, 180.0]) + exact_deg * np.array([1.0, -1.0, 1.0]))
    return np.where(beyond[:, None], other, exact_deg)


def _wrap_angles(angle_deg: Array) -> Array:
    """Return the angles in (-180, 180]."""
    return 180.0 - (180.0 - angle_deg) % 360.0


def _round_angles(angle_deg: Array, decimals: Array) -> Array:
    scale = 10.0**decimals
    return np.round(angle_deg * scale) / scale
