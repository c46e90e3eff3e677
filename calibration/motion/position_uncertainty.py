"""How far parts of an arm may be from where they are computed, while its joints are known to within a doubt only.

Joints j = a + 1 .. b are each off by at most d_j, all at once. A point beyond, r_j from joint j's axis, is then
off by at most D, where D = 0 and, from joint b to joint a + 1, D <- D + 2 sin(d_j / 2) (r_j + D): the chord of the
largest turn about that axis, from anywhere that the joints beyond it may have brought the point. No linearisation,
no sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel, chain_frames, cross_product
from cellcal.calibration.geometry import Array


@dataclass(frozen=True, slots=True)
class PositionUncertainty:
    """By how much each joint may stand elsewhere than thought [rad], all at once."""

    bodies_rad: tuple[float, ...]  # for whatever is solid, and the workspace
    wire_rad: tuple[float, ...]  # for the draw-wire: who touches it bends nothing, and reads a wrong length


@dataclass(frozen=True, eq=False)
class AxisUncertainty:
    """The frames of postures, and how far each axis may be turned from where it is thought."""

    axes: Array  # (n, 3, N): direction of each joint's axis
    origins: Array  # (n, 3, N): a point on it
    chords: Array  # (n,): 2 sin(d / 2); of a joint that slides, how far it may be elsewhere [m]
    slides: NDArray[np.bool_] | None = None  # (n,)

    @classmethod
    def from_joints(
        cls, model: RobotModel, joints_rad: Array, uncertainty_rad: Sequence[float]
    ) -> "AxisUncertainty":
        """Return it for postures (N, n), doubts (n,) of the controller's joints [rad]."""
        rotations, origins = chain_frames(model, joints_rad)
        angles = np.abs(model.joint_coupling) @ np.abs(np.asarray(uncertainty_rad, dtype=float))
        chords = 2.0 * np.sin(np.minimum(angles, np.pi) / 2.0)
        if model.sliding is not None:
            chords = np.where(model.sliding, angles, chords)
        return cls(rotations[:-1, :, 2], origins[:-1], chords, model.sliding)

    def displacement_between(self, points: Sequence[Array], inner: int, outer: int) -> Array:
        """Return (N,): how far points (3, N) on link ``outer`` may be displaced, seen from link ``inner`` [m]."""
        displaced: Array = self.displacements_from_links(points, outer)[inner]
        return displaced

    def displacements_from_links(self, points: Sequence[Array], outer: int) -> Array:
        """Return (outer + 1, N): the same, seen from each link up to ``outer`` itself, from where it is zero."""
        levers = self._point_levers(points, outer)
        found = np.zeros((outer + 1, levers.shape[1]))
        for joint in range(outer - 1, -1, -1):
            found[joint] = found[joint + 1] + self._joint_displacement(joint, levers, found[joint + 1])
        return found

    def _joint_displacement(self, joint: int, levers: Array, further_m: Array) -> Array:
        """Return (N,): what one joint's uncertainty adds at points that are displaced ``further_m`` already [m]."""
        slides = self.slides is not None and bool(self.slides[joint])
        displaced: Array = self.chords[joint] * (1.0 if slides else levers[joint] + further_m)
        return displaced

    def base_displacements(self, point: Array) -> Array:
        """Return (n + 1, N): how far a point (3, N) of the base may be displaced, seen from each link [m]."""
        joints = len(self.axes)
        levers = self._point_levers([point], joints)
        found = np.zeros((joints + 1, levers.shape[1]))
        for joint in range(joints):
            found[joint + 1] = found[joint] + self._joint_displacement(joint, levers, found[joint])
        return found

    def _point_levers(self, points: Sequence[Array], joints: int) -> Array:
        """Return (joints, N): how far the farthest of points on one link is from each of the first axes [m].

        The distance is convex, so the ends of a body suffice.
        """
        ends = np.stack([np.broadcast_to(point, self.axes.shape[1:]) for point in points])
        away = cross_product(ends - self.origins[:joints, None], self.axes[:joints, None])
        return np.asarray(np.linalg.norm(away, axis=2).max(axis=1), dtype=np.float64)
