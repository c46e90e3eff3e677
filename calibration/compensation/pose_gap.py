"""How far many postures of an arm are from the poses they shall reach, components first and the pose last."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.arm.kinematics import RobotModel, chain_frames, cross_product
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, is_rigid
from cellcal.calibration.identification.parameters import ArmState
from cellcal.calibration.message import make_message

JointExtra: TypeAlias = Callable[[Array], Array]
Flags: TypeAlias = NDArray[np.bool_]

LEVER_M = 0.3  # what a radian weighs against metres: a hand's breadth, so that neither is drowned


@dataclass(frozen=True, eq=False)
class TipArm:
    """An arm with the tip that shall be in place, and what its joints do beside turning by their angle."""

    model: RobotModel
    flange_tip: Array = field(default_factory=lambda: np.eye(4))
    extra_joints: JointExtra | None = None  # controller joints (N, n) -> what sag and ripple add (N, n) [rad]

    def __post_init__(self) -> None:
        if np.shape(self.flange_tip) != (4, 4) or not is_rigid(self.flange_tip):
            raise CalibrationError(
                make_message("{label}: the tip is not a rigid transform (4, 4)", label=self.model.label)
            )

    @classmethod
    def of_state(cls, state: ArmState) -> Self:
        """Return an identified arm with its identified tool, sag and ripple; the base is the robot's own."""

        def extra_rotation(joints_rad: Array) -> Array:
            values = term_values(state.nominal, joints_rad, state.terms)
            return state.moved_joints(joints_rad, values) - joints_rad

        return cls(state.arm_model, state.flange_tool, extra_rotation if len(state.terms) else None)

    @cached_property
    def tip_chain(self) -> RobotModel:
        """The arm whose flange is the tip."""
        placements = self.model.placements.copy()
        placements[-1] = placements[-1] @ self.flange_tip
        return replace(self.model, dh=None, placements=placements)

    @cached_property
    def joint_coupling(self) -> Array | None:
        """The joints' coupling, or None where each joint turns alone."""
        coupling = self.model.joint_coupling
        return None if np.array_equal(coupling, np.eye(self.model.axis_count)) else coupling

    def compute_frames(self, joints_rad: Array) -> tuple[Array, Array]:
        """Return the frames of `chain_frames` for joints (n, N), sag and ripple included."""
        angles = joints_rad.T
        return chain_frames(
            self.tip_chain, angles if self.extra_joints is None else angles + self.extra_joints(angles)
        )


@dataclass(frozen=True, eq=False)
class TargetPoses:
    """Poses to reach: columns of the rotation (3, 3, N), and places (3, N) [m]."""

    axes: Array
    place_m: Array

    @classmethod
    def from_joints(cls, arm: TipArm, joints_rad: Array) -> Self:
        """Return where an arm's tip is for joints (n, N)."""
        rotations, origins = arm.compute_frames(joints_rad)
        return cls(rotations[-1].swapaxes(0, 1), origins[-1])

    def select_poses(self, chosen: Flags) -> Self:
        """Return these poses only."""
        return type(self)(self.axes[:, :, chosen], self.place_m[:, chosen])


@dataclass(frozen=True, eq=False)
class PoseGap:
    """Target minus tip, and the frames that it was seen with."""

    error: Array  # (6, N) [m]: place, and sine of the turn times `LEVER_M`
    cosine: Array  # (N,) of the turn
    rotations: Array
    origins: Array

    def select_poses(self, chosen: Flags) -> Self:
        """Return these poses only."""
        rotations, origins = self.rotations[..., chosen], self.origins[..., chosen]
        return type(self)(self.error[:, chosen], self.cosine[chosen], rotations, origins)

    def copy_frames(self) -> Self:
        """Return it with frames of its own, which may be written to: those of an arm are read-only."""
        return type(self)(
            self.error, self.cosine, self.rotations.copy(order="K"), self.origins.copy(order="K")
        )

    @cached_property
    def position_m(self) -> Array:
        """Distances (N,)."""
        return _vector_lengths(self.error[:3])

    @cached_property
    def angle_sine(self) -> Array:
        """Sines of the angles (N,)."""
        return _vector_lengths(self.error[3:]) / LEVER_M

    @property
    def angle_rad(self) -> Array:
        """Angles (N,)."""
        angle: Array = np.arctan2(self.angle_sine, self.cosine)
        return angle

    @property
    def squared_size(self) -> Array:
        """Squared size (N,) [m^2]; an angle beyond a right one counts as a right one and more."""
        turn = np.where(self.cosine < 0, 2.0 - self.angle_sine, self.angle_sine) * LEVER_M
        cost: Array = self.position_m**2 + turn**2
        return cost

    def is_reached(self, position_m: float, angle_rad: float) -> Flags:
        """Return which poses are reached."""
        reached: Flags = (self.position_m <= position_m) & (self.angle_sine <= angle_rad) & (self.cosine > 0)
        return reached

    def tip_jacobian(self, arm: TipArm) -> Array:
        """Return d tip / d controller joint (n, 6, N) in the units of ``error``."""
        axes = self.rotations[:-1, :, 2]
        columns = np.empty((len(axes), 6, axes.shape[-1]))
        cross_product(axes, self.origins[-1] - self.origins[:-1], out=columns[:, :3])
        np.multiply(axes, LEVER_M, out=columns[:, 3:])
        slides = arm.model.sliding
        if slides is not None:
            columns[slides, :3], columns[slides, 3:] = axes[slides], 0.0
        if arm.joint_coupling is None:
            return columns
        return (arm.joint_coupling.T @ columns.reshape(len(columns), -1)).reshape(columns.shape)


def refuse_few_joints(model: RobotModel) -> None:
    """Refuse an arm that keeps no whole pose: `other_joint_counts.approach_poses` comes as near as it can.

    Raises
    ------
    CalibrationError
        Fewer than six joints.
    """
    if model.axis_count < 6:
        raise CalibrationError(
            make_message(
                "{label} has {axis_count} joints: a whole pose is kept by six or more only.",
                label=model.label,
                axis_count=model.axis_count,
            ),
            remedy="Give joints in place of poses. `cellcal program` takes its programs as far as its joints follow.",
        )


def gap_between(arm: TipArm, joints_rad: Array, target: TargetPoses) -> PoseGap:
    """Return how far an arm at joints (n, N) is from the target.

    The sine of a turn is exact where it vanishes, and points the right way for any turn below pi.
    """
    rotations, origins = arm.compute_frames(joints_rad)
    axes = rotations[-1].swapaxes(0, 1)
    error = np.empty((6, joints_rad.shape[1]))
    np.subtract(target.place_m, origins[-1], out=error[:3])
    np.sum(cross_product(axes, target.axes), axis=0, out=error[3:])
    error[3:] *= 0.5 * LEVER_M
    cosine = 0.5 * (np.einsum("ijn,ijn->n", axes, target.axes) - 1.0)
    return PoseGap(error, cosine, rotations, origins)


def _vector_lengths(vectors: Array) -> Array:
    size: Array = np.sqrt(np.einsum("in,in->n", vectors, vectors))
    return size
