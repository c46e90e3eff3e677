"""Where an arm's flange is: the world's own arithmetic, shared with no other package.

Imitates
    The steel of an arm: rigid links between turning axes.
Source
    Denavit and Hartenberg's convention, Paul (1981): Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha),
    followed by Hayati's Rot(y, beta) for an axis parallel to its predecessor.
Modelled
    Any number of poses at once; coupling of the controller's joints (FANUC's J2/J3).
Not modelled
    Closed chains, prismatic axes.

It must stay apart from the product's kinematics: a world that shared a wrong convention with the product
would prove it right.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def link_frames(dh: Array, axis_angles_rad: Array, base: Array | None = None) -> Array:
    """Return base_link_i for i = 0..n, (N, n + 1, 4, 4); ``dh`` is (n, 5): theta, d, a, alpha, beta."""
    poses, axes = axis_angles_rad.shape
    frames = np.empty((poses, axes + 1, 4, 4))
    frames[:, 0] = np.eye(4) if base is None else base
    for i in range(axes):
        frames[:, i + 1] = frames[:, i] @ _link_matrix(dh[i], axis_angles_rad[:, i] + dh[i, 0])
    return frames


def _link_matrix(row: Array, theta_rad: Array) -> Array:
    _, d, a, alpha, beta = (float(value) for value in row)
    c, s = np.cos(theta_rad), np.sin(theta_rad)
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    turn = np.zeros((theta_rad.size, 4, 4))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, -s, s, c
    turn[:, 2, 2] = turn[:, 3, 3] = 1.0
    shape = np.array(
        [[cb, 0.0, sb, a], [sa * sb, ca, -sa * cb, 0.0], [-ca * sb, sa, ca * cb, d], [0.0, 0.0, 0.0, 1.0]]
    )
    return np.asarray(turn @ shape)


def flange_poses(dh: Array, axis_angles_rad: Array) -> Array:
    """Return base_flange (N, 4, 4)."""
    return link_frames(dh, axis_angles_rad)[:, -1]


def transform_point(pose: Array, point: ArrayLike) -> Array:
    """Return a point (3,) seen through poses (…, 4, 4), as (…, 3)."""
    return np.asarray(pose[..., :3, :3] @ np.asarray(point, dtype=float) + pose[..., :3, 3])


def invert_pose(pose: Array) -> Array:
    """Return the inverse of one rigid pose (4, 4)."""
    back = np.eye(4)
    back[:3, :3] = pose[:3, :3].T
    back[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return back


def wpr_from_matrix(rotation: Array) -> tuple[float, float, float]:
    """Return W, P, R [deg] of rotation = Rz(R) Ry(P) Rx(W): about the fixed axes X, Y, Z in this order."""
    across = float(np.hypot(rotation[0, 0], rotation[1, 0]))
    p = np.arctan2(-rotation[2, 0], across)
    if across < 1e-9:  # P = +-90 deg: only W -+ R is defined; the convention takes R = 0 on a zero column
        return float(np.degrees(np.arctan2(-rotation[1, 2], rotation[1, 1]))), float(np.degrees(p)), 0.0
    w = np.arctan2(rotation[2, 1], rotation[2, 2])
    r = np.arctan2(rotation[1, 0], rotation[0, 0])
    return float(np.degrees(w)), float(np.degrees(p)), float(np.degrees(r))


def matrix_from_xyzwpr(values: ArrayLike) -> Array:
    """Return the pose of X, Y, Z [mm], W, P, R [deg]; lengths in metres."""
    x, y, z, w, p, r = (float(value) for value in np.asarray(values, dtype=float))
    (cw, cp, cr), (sw, sp, sr) = np.cos(np.radians([w, p, r])), np.sin(np.radians([w, p, r]))
    pose = np.eye(4)
    pose[:3, :3] = [
        [cr * cp, cr * sp * sw - sr * cw, cr * sp * cw + sr * sw],
        [sr * cp, sr * sp * sw + cr * cw, sr * sp * cw - cr * sw],
        [-sp, cp * sw, cp * cw],
    ]
    pose[:3, 3] = np.array([x, y, z]) * 1e-3
    return pose
