"""How far many postures of an arm are from the poses they shall reach, components first and the pose last."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.arm.kinematics import RobotModel, chain_frames, cross
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, is_rigid
from cellcal.calibration.identification.parameters import ArmState

JointExtra: TypeAlias = Callable[[Array], Array]
Flags: TypeAlias = NDArray[np.bool_]

LEVER_M = 0.3  # what a radian weighs against metres: a hand's breadth, so that neither is drowned


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm with the tip that shall be in place, and what its joints do beside turning by their angle."""

    model: RobotModel
    flange_tip: Array = field(default_factory=lambda: np.eye(4))
    extra_joints: JointExtra | None = None  # controller joints (N, n) -> what sag and ripple add (N, n) [rad]

    def __post_init__(self) -> None:
        if np.shape(self.flange_tip) != (4, 4) or not is_rigid(self.flange_tip):
            raise CalibrationError(f"{self.model.name}: the tip is not a rigid transform (4, 4)")
        if self.model.axes < 6:
            raise CalibrationError(
                f"{self.model.name} has {self.model.axes} joints: a pose can be kept by six or more only."
            )

    @classmethod
    def of_state(cls, state: ArmState) -> Self:
        """Return an identified arm with its identified tool, sag and ripple; the base is the robot's own."""

        def extra(joints_rad: Array) -> Array:
            values = term_values(state.nominal, joints_rad, state.terms)
            return state.moved_joints(joints_rad, values) - joints_rad

        return cls(state.arm, state.flange_tool, extra if len(state.terms) else None)

    @cached_property
    def chain(self) -> RobotModel:
        """The arm whose flange is the tip."""
        placements = self.model.placements.copy()
        placements[-1] = placements[-1] @ self.flange_tip
        return replace(self.model, dh=None, placements=placements)

    @cached_property
    def coupling(self) -> Array | None:
        """The joints' coupling, or None where each joint turns alone."""
        coupling = self.model.joint_coupling
        return None if np.array_equal(coupling, np.eye(self.model.axes)) else coupling

    def frames(self, joints_rad: Array) -> tuple[Array, Array]:
        """Return the frames of `chain_frames` for joints (n, N), sag and ripple included."""
        given = joints_rad.T
        return chain_frames(
            self.chain, given if self.extra_joints is None else given + self.extra_joints(given)
        )


@dataclass(frozen=True, eq=False)
class Target:
    """Poses to reach: columns of the rotation (3, 3, N), and places (3, N) [m]."""

    axes: Array
    place_m: Array

    @classmethod
    def of(cls, arm: Arm, joints_rad: Array) -> Self:
        """Return where an arm's tip is for joints (n, N)."""
        rotations, origins = arm.frames(joints_rad)
        return cls(rotations[-1].swapaxes(0, 1), origins[-1])

    def take(self, chosen: Flags) -> Self:
        """Return these poses only."""
        return type(self)(self.axes[:, :, chosen], self.place_m[:, chosen])


@dataclass(frozen=True, eq=False)
class Gap:
    """Target minus tip, and the frames that it was seen with."""

    error: Array  # (6, N) [m]: place, and sine of the turn times `LEVER_M`
    cosine: Array  # (N,) of the turn
    rotations: Array
    origins: Array

    def take(self, chosen: Flags) -> Self:
        """Return these poses only."""
        rotations, origins = self.rotations[..., chosen], self.origins[..., chosen]
        return type(self)(self.error[:, chosen], self.cosine[chosen], rotations, origins)

    @cached_property
    def position_m(self) -> Array:
        """Distances (N,)."""
        return _size(self.error[:3])

    @cached_property
    def sine(self) -> Array:
        """Sines of the angles (N,)."""
        return _size(self.error[3:]) / LEVER_M

    @property
    def angle_rad(self) -> Array:
        """Angles (N,)."""
        angle: Array = np.arctan2(self.sine, self.cosine)
        return angle

    @property
    def cost(self) -> Array:
        """Squared size (N,) [m^2]; an angle beyond a right one counts as a right one and more."""
        turn = np.where(self.cosine < 0, 2.0 - self.sine, self.sine) * LEVER_M
        cost: Array = self.position_m**2 + turn**2
        return cost

    def met(self, position_m: float, angle_rad: float) -> Flags:
        """Tell which poses are reached."""
        reached: Flags = (self.position_m <= position_m) & (self.sine <= angle_rad) & (self.cosine > 0)
        return reached

    def columns(self, arm: Arm) -> Array:
        """Return d tip / d controller joint (n, 6, N) in the units of ``error``."""
        axes = self.rotations[:-1, :, 2]
        columns = np.empty((len(axes), 6, axes.shape[-1]))
        cross(axes, self.origins[-1] - self.origins[:-1], out=columns[:, :3])
        np.multiply(axes, LEVER_M, out=columns[:, 3:])
        if arm.coupling is None:
            return columns
        return (arm.coupling.T @ columns.reshape(len(columns), -1)).reshape(columns.shape)


def gap_between(arm: Arm, joints_rad: Array, target: Target) -> Gap:
    """Return how far an arm at joints (n, N) is from the target.

    The sine of a turn is exact where it vanishes, and points the right way for any turn below pi.
    """
    rotations, origins = arm.frames(joints_rad)
    axes = rotations[-1].swapaxes(0, 1)
    error = np.empty((6, joints_rad.shape[1]))
    np.subtract(target.place_m, origins[-1], out=error[:3])
    np.sum(cross(axes, target.axes), axis=0, out=error[3:])
    error[3:] *= 0.5 * LEVER_M
    cosine = 0.5 * (np.einsum("ijn,ijn->n", axes, target.axes) - 1.0)
    return Gap(error, cosine, rotations, origins)


def _size(vectors: Array) -> Array:
    size: Array = np.sqrt(np.einsum("in,in->n", vectors, vectors))
    return size
