"""Frames of a cell, and how well each is known before anything is measured."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import (
    Array,
    exp_twist,
    homogeneous_matrix,
    is_rigid,
    log_rotation,
    skew_matrix,
)
from cellcal.calibration.message import make_message

AXES = ("x", "y", "z", "rx", "ry", "rz")
_FREE = (np.inf,) * 3


@dataclass(frozen=True, eq=False)
class FramePrior:
    """A frame in another frame: where it is, and one standard deviation along and about each of its own axes.

    A deviation of zero keeps it there, an infinite one leaves it to the measurements, one between is a Gaussian
    prior around ``pose``. Without a pose, the fit looks for a start itself.
    """

    pose: Array | None  # (4, 4)
    sigma: Array  # (6,): x y z [m], rx ry rz [rad]

    def __post_init__(self) -> None:
        if self.pose is not None and not is_rigid(self.pose):
            raise CalibrationError("a place is a rigid transform (4, 4) of finite numbers")
        if self.sigma.shape != (6,) or np.isnan(self.sigma).any() or (self.sigma < 0).any():
            raise CalibrationError("a place has six standard deviations, zero or larger, or infinite")
        looked_for = np.isinf(self.sigma[:3])
        if self.pose is None and not (looked_for.any() and (looked_for | (self.sigma[:3] == 0)).all()):
            raise CalibrationError("a place that is known to some deviation needs its pose, too")

    @classmethod
    def without_prior(cls, rough: Array | None = None) -> Self:
        """Return a frame that the measurements shall find, looked for from a rough pose (4, 4) if there is one."""
        return cls(rough, np.full(6, np.inf))

    @classmethod
    def point_without_prior(cls, rough_m: ArrayLike | None = None) -> Self:
        """Return a point that the measurements shall find; its axes are those of the outer frame."""
        pose = None if rough_m is None else _translation(rough_m)
        return cls(pose, np.array([*_FREE, 0.0, 0.0, 0.0]))

    @classmethod
    def from_pose(cls, pose: Array, sigma_m: float = 0.0, sigma_rad: float = 0.0) -> Self:
        """Return a frame (4, 4) that is known to these deviations."""
        return cls(np.asarray(pose, dtype=float), np.repeat([sigma_m, sigma_rad], 3).astype(float))

    @classmethod
    def from_point(cls, position_m: ArrayLike, sigma_m: float = 0.0) -> Self:
        """Return a point (3,) that is known to a deviation; its axes are those of the outer frame."""
        return cls.from_pose(_translation(position_m), sigma_m)

    @property
    def has_position_prior(self) -> bool:
        """Whether something is known of the position."""
        return self.pose is not None and bool(np.isfinite(self.sigma[:3]).any())

    def free_axes_only(self, axes: tuple[int, ...]) -> "FramePrior":
        """Return the place with every axis fixed that is not among these."""
        sigma = np.zeros(6)
        sigma[list(axes)] = self.sigma[list(axes)]
        pose = np.eye(4) if self.pose is None and not np.isinf(sigma[:3]).any() else self.pose
        return FramePrior(pose, sigma)

    def deviation_of(self, pose: Array) -> tuple[Array, Array]:
        """Return how far a pose is from this one (6,), by its axes, and how that follows a right twist (6, 6)."""
        if self.pose is None:
            return np.zeros(6), np.eye(6)
        turn = self.pose[:3, :3].T @ pose[:3, :3]
        shift = self.pose[:3, :3].T @ (pose[:3, 3] - self.pose[:3, 3])
        angle = log_rotation(turn)
        follows = np.zeros((6, 6))
        follows[:3, :3], follows[3:, 3:] = turn, _inverse_right_jacobian(angle)
        return np.concatenate([shift, angle]), follows


def _translation(position_m: ArrayLike) -> Array:
    position = np.asarray(position_m, dtype=float)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise CalibrationError(
            make_message("a point is three finite numbers, not {position_m!r}", position_m=position_m)
        )
    return homogeneous_matrix(np.eye(3), position)


def _inverse_right_jacobian(vector: Array) -> Array:
    """Return (3, 3): how a rotation vector follows a small turn from the right.

    References: G. S. Chirikjian, Stochastic Models, Information Theory, and Lie Groups 2 (2012), eq. 10.86.
    """
    angle = float(np.linalg.norm(vector))
    cross = skew_matrix(vector)
    factor = 1 / 12  # for small angles
    if angle > 1e-4:
        factor = 1 / angle**2 - (1 + np.cos(angle)) / (2 * angle * np.sin(angle))
    inverse: Array = np.eye(3) + 0.5 * cross + factor * cross @ cross
    return inverse


def move_frames(poses: Array, twists: Array) -> Array:
    """Return poses (M, 4, 4) after small motions (M, 6) in their own axes."""
    there: Array = poses @ exp_twist(twists)
    return there
