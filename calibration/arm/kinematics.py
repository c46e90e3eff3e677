"""Serial arms: forward kinematics and its derivatives, for thousands of poses at once.

A model is a row of fixed placements with a turning joint between each two::

    base_flange(q) = P_0  Rz(u_1)  P_1  Rz(u_2) … Rz(u_n)  P_n        u = theta0 + joint_coupling @ q

``q`` are the joint angles that the controller shows. Signs, and joints that the controller couples (FANUC's
J2 and J3), live in ``joint_coupling``; a Denavit-Hartenberg table is one way to write the placements, a URDF
another.

Inside, arrays have their components first and the pose last, so that every operation runs along memory and
the fixed placements become one matrix product per joint; at public borders the pose is first.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from cellcal.calibration.arm.mounting import MOUNTED, gravity_of
from cellcal.calibration.arm.robot_models import model_fields, model_names
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, exp_twist, is_rigid

__all__ = [
    "DhTable",
    "RobotModel",
    "by_independent_columns",
    "chain_frames",
    "frames_of_placements",
    "independent_columns",
    "joint_columns",
    "load_model",
    "model_names",
    "placement_columns",
]


@dataclass(frozen=True, eq=False)
class DhTable:
    """One row a joint, ``Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha) Rot(y, beta)``; fields are (n,).

    ``beta`` is Hayati's twist, for an axis (nearly) parallel to its predecessor, where ``d`` is not defined.

    References
    ----------
    S. Hayati, M. Mirmirani, Improving the absolute positioning accuracy of robot manipulators, J. Robotic
    Systems 2 (1985) 397: beta.
    """

    theta_rad: Array
    d_m: Array
    a_m: Array
    alpha_rad: Array
    beta_rad: Array

    def __post_init__(self) -> None:
        shapes = {np.shape(v) for v in (self.theta_rad, self.d_m, self.a_m, self.alpha_rad, self.beta_rad)}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise CalibrationError("the columns of a DH table must be as long as each other")

    def to_rows(self) -> Array:
        """Return (n, 5) in the order theta, d, a, alpha, beta [rad, m]."""
        return np.stack([self.theta_rad, self.d_m, self.a_m, self.alpha_rad, self.beta_rad], axis=1)

    @classmethod
    def from_rows(cls, rows: Array) -> Self:
        """Build from (n, 4) or (n, 5) rows theta, d, a, alpha[, beta]."""
        rows = np.asarray(rows, dtype=float)
        if rows.ndim != 2 or rows.shape[1] not in (4, 5):
            raise CalibrationError(f"DH rows have four or five numbers, not shape {rows.shape}")
        columns = list(rows.T) if rows.shape[1] == 5 else [*rows.T, np.zeros(len(rows))]
        return cls(*(_frozen_copy(column) for column in columns))

    def to_placements(self) -> Array:
        """Return (n, 4, 4): ``Trans(z, d) Trans(x, a) Rot(x, alpha) Rot(y, beta)`` of each row."""
        ca, sa = np.cos(self.alpha_rad), np.sin(self.alpha_rad)
        cb, sb = np.cos(self.beta_rad), np.sin(self.beta_rad)
        zero, one = np.zeros_like(ca), np.ones_like(ca)
        rows = [
            [cb, zero, sb, self.a_m],
            [sa * sb, ca, -sa * cb, zero],
            [-ca * sb, sa, ca * cb, self.d_m],
            [zero, zero, zero, one],
        ]
        return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1))


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A serial arm of turning joints. Arrays are read-only; changed models are new models."""

    name: str
    title: str
    dh: DhTable | None
    placements: Array  # (n + 1, 4, 4)
    theta0_rad: Array  # (n,)
    joint_coupling: Array  # (n, n)
    lower_rad: Array
    upper_rad: Array
    max_speed_rad_s: Array
    joint_names: tuple[str, ...]
    gravity_in_base: tuple[float, float, float] = (0.0, 0.0, -1.0)  # unit vector: where weight pulls

    def __post_init__(self) -> None:
        for field in (
            "placements",
            "theta0_rad",
            "joint_coupling",
            "lower_rad",
            "upper_rad",
            "max_speed_rad_s",
        ):
            object.__setattr__(self, field, _frozen_copy(self.__dict__[field]))
        n = len(self.joint_names)
        shapes = {v.shape for v in (self.theta0_rad, self.lower_rad, self.upper_rad, self.max_speed_rad_s)}
        if shapes != {(n,)} or self.joint_coupling.shape != (n, n) or self.placements.shape != (n + 1, 4, 4):
            raise CalibrationError(f"{self.name}: the arrays of the model do not fit its {n} joints")
        if not is_rigid(self.placements):
            raise CalibrationError(f"{self.name}: a placement is not a rigid transform")
        if not (np.isfinite(self.theta0_rad).all() and (self.lower_rad < self.upper_rad).all()):
            raise CalibrationError(
                f"{self.name}: joint zeros must be finite and lower limits below upper ones"
            )
        if not abs(float(np.linalg.norm(self.gravity_in_base)) - 1.0) < 1e-6:
            raise CalibrationError(f"{self.name}: the direction of gravity must be a unit vector")
        if not abs(np.linalg.det(self.joint_coupling)) > 1e-9:
            raise CalibrationError(f"{self.name}: the joint coupling is singular: some axis would not move")

    @classmethod
    def from_dh(cls, dh: DhTable, *, base: Array | None = None, **fields: object) -> Self:
        """Build from a DH table; ``base`` is the frame before the first joint in the controller's base."""
        n = len(dh.theta_rad)
        first = np.eye(4) if base is None else np.asarray(base, dtype=float)
        wide = {
            "lower_rad": np.full(n, -np.pi),
            "upper_rad": np.full(n, np.pi),
            "max_speed_rad_s": np.ones(n),
        }
        names = tuple(f"joint_{i + 1}" for i in range(n))
        dh_arrays = {
            "title": fields.get("name"),
            "joint_coupling": np.eye(n),
            "joint_names": names,
            **wide,
            **fields,
        }
        placements = np.concatenate([first[None], dh.to_placements()])
        return cls(dh=dh, placements=placements, theta0_rad=dh.theta_rad, **dh_arrays)  # type: ignore[arg-type]  # checked in __post_init__

    @property
    def axis_count(self) -> int:
        """The number of joints."""
        return len(self.joint_names)

    def base_flange(self, joints_rad: Array) -> Array:
        """Return (N, 4, 4): the flange in the base for each of (N, n) joint vectors."""
        rotations, origins = chain_frames(self, joints_rad)
        return _stack_matrices(rotations[-1], origins[-1])

    def tip_positions(self, joints_rad: Array, tip_in_flange_m: Array) -> Array:
        """Return (N, 3): where a point of the flange, (3,) or one per pose (N, 3), is in the base [m]."""
        rotations, origins = chain_frames(self, joints_rad)
        return _tip_positions(rotations, origins, tip_in_flange_m).T

    def tip_jacobian(self, joints_rad: Array, tip_in_flange_m: Array) -> tuple[Array, Array]:
        """Return positions (N, 3) [m] and d position / d controller joint (N, 3, n) [m/rad]."""
        rotations, origins = chain_frames(self, joints_rad)
        tip = _tip_positions(rotations, origins, tip_in_flange_m)
        columns = joint_columns(self, rotations, origins, tip)
        return tip.T, columns.transpose(2, 1, 0)

    def flange_jacobian(self, joints_rad: Array) -> tuple[Array, Array]:
        """Return base_flange (N, 4, 4) and its Jacobian (N, 6, n): linear, then angular, in base axes."""
        rotations, origins = chain_frames(self, joints_rad)
        linear = joint_columns(self, rotations, origins, origins[-1])
        angular = _by_controller_joints(self, rotations[:-1, :, 2])
        jacobian = np.concatenate([linear, angular], axis=1).transpose(2, 1, 0)
        return _stack_matrices(rotations[-1], origins[-1]), jacobian

    def placement_regressor(self, joints_rad: Array, tip_in_flange_m: Array) -> tuple[Array, Array]:
        """Return positions (N, 3) and d position / d twist (N, 3, n + 1, 6): ``P_k <- P_k exp(v, w)``."""
        rotations, origins = chain_frames(self, joints_rad)
        tip = _tip_positions(rotations, origins, tip_in_flange_m)
        columns = placement_columns(rotations, origins, tip)
        return tip.T, columns.transpose(3, 2, 0, 1)

    def dh_regressor(self, joints_rad: Array, tip_in_flange_m: Array) -> tuple[Array, Array]:
        """Return positions (N, 3) and d position / d (theta, d, a, alpha, beta) of each row (N, 3, n, 5)."""
        dh = self._dh_table()
        rotations, origins = chain_frames(self, joints_rad)
        tip = _tip_positions(rotations, origins, tip_in_flange_m)
        lever = tip - origins
        # Of the row's axes after Rot(z, theta), z is the joint's, and x the next frame's before Rot(y, beta).
        z, y = rotations[:-1, :, 2], rotations[1:, :, 1]
        x = (
            rotations[1:, :, 0] * np.cos(dh.beta_rad)[:, None, None]
            + rotations[1:, :, 2] * np.sin(dh.beta_rad)[:, None, None]
        )
        turns = [cross_product(z, lever[:-1]), z, x, cross_product(x, lever[1:]), cross_product(y, lever[1:])]
        return tip.T, np.stack(turns, axis=1).transpose(3, 2, 0, 1)

    def with_dh_errors(self, errors: Array) -> "RobotModel":
        """Return the model whose DH rows are changed by ``errors`` (n, 5) [rad, m]."""
        dh = DhTable.from_rows(self._dh_table().to_rows() + np.asarray(errors, dtype=float))
        placements = np.concatenate([self.placements[:1], dh.to_placements()])
        return replace(self, dh=dh, placements=placements, theta0_rad=dh.theta_rad)

    def with_twists(self, twists: Array) -> "RobotModel":
        """Return the model with ``P_k exp(v, w)`` in place of each ``P_k``; twists (n + 1, 6) [m, rad].

        The result has no DH table any more: apply DH errors first.
        """
        twists = np.asarray(twists, dtype=float)
        if twists.shape != (self.axis_count + 1, 6):
            raise CalibrationError(
                f"{self.name}: twists must be ({self.axis_count + 1}, 6), not {twists.shape}"
            )
        return replace(self, dh=None, placements=self.placements @ exp_twist(twists))

    def _dh_table(self) -> DhTable:
        if self.dh is None:
            raise CalibrationError(
                f"{self.name} has no DH table.",
                remedy="Use twists of the placements, or apply DH errors before twists.",
            )
        return self.dh


def chain_frames(model: RobotModel, joints_rad: Array) -> tuple[Array, Array]:
    """Return every frame of the chain, components first: the hot kernel under all of the above.

    Parameters
    ----------
    model : RobotModel
        With n joints.
    joints_rad : (N, n)
        Controller joint angles [rad].

    Returns
    -------
    rotations : (n + 1, 3, 3, N)
        ``rotations[k, row, column]`` of frame k, the one right after placement ``P_k``, seen from the base;
        joint k + 1 turns about its z axis ``rotations[k, :, 2]``; frame n is the flange.
    origins : (n + 1, 3, N)
        [m]. Each axis ``rotations[k, :, j]`` and each origin is contiguous in memory.

    Raises
    ------
    CalibrationError
        Joint angles of another shape, or not finite.
    """
    joints = np.asarray(joints_rad, dtype=float)
    if joints.ndim != 2 or joints.shape[1] != model.axis_count:
        raise CalibrationError(f"{model.name}: joints must be (N, {model.axis_count}), not {joints.shape}")
    if not np.isfinite(joints).all():
        raise CalibrationError(f"{model.name}: joint angles must be finite")
    angles = model.joint_coupling @ joints.T + model.theta0_rad[:, None]
    return frames_of_placements(model.placements, angles)


def frames_of_placements(
    placements: Array, angles_rad: Array, *, out: Array | None = None
) -> tuple[Array, Array]:
    """Return the frames of `chain_frames` for placements (n + 1, 4, 4) and their DH angles (n, N) [rad].

    ``out``, (n + 1, 4, 3, N), is where the frames are kept: iterations that give the same array again save
    touching fresh memory, which costs more than the arithmetic.
    """
    count = angles_rad.shape[1]
    # One product per placement gives the three next axes and, as fourth row, the step to the next origin.
    mixers = np.ascontiguousarray(placements[:, :3, :].transpose(0, 2, 1))
    frames = np.empty((len(placements), 4, 3, count)) if out is None else out
    frames[0] = mixers[0][:, :, None]
    turned, part = np.empty((3, 3, count)), np.empty((2, 3, count))
    for k, (cos, sin) in enumerate(zip(*cosine_and_sine(angles_rad), strict=True)):
        plane = frames[k, :2]
        np.multiply(plane, cos, out=turned[:2])
        np.multiply(plane, sin, out=part)
        turned[0] += part[1]
        turned[1] -= part[0]
        turned[2] = frames[k, 2]
        np.matmul(mixers[k + 1], turned.reshape(3, -1), out=frames[k + 1].reshape(4, -1))
        frames[k + 1, 3] += frames[k, 3]
    return frames[:, :3].swapaxes(1, 2), frames[:, 3]


def cosine_and_sine(angles_rad: Array) -> tuple[Array, Array]:
    """Return both from the tangent of half the angle, right to the last digit (3e-16) for any angle.

    numpy evaluates a tangent with vector instructions where there are any, and cosine and sine one by one.
    """
    tangent = np.tan(0.5 * angles_rad)
    versine = 2.0 / (
        1.0 + tangent * tangent
    )  # 1 + cosine; tangents of doubles end at 2e16, and do not overflow
    return versine - 1.0, tangent * versine


def joint_columns(model: RobotModel, rotations: Array, origins: Array, tip: Array) -> Array:
    """Return (n, 3, N): d tip / d controller joint, from the frames of `chain_frames` and tips (3, N)."""
    return _by_controller_joints(model, cross_product(rotations[:-1, :, 2], tip - origins[:-1]))


def placement_columns(rotations: Array, origins: Array, tip: Array, *, out: Array | None = None) -> Array:
    """Return (n + 1, 6, 3, N): d tip / d right twist (v, w) of each placement, from frames and tips (3, N).

    ``reshape(6 * (n + 1), 3 * N)`` is free and gives the rows of the transposed design matrix. Iterations may
    pass the last result as ``out``: touching fresh memory costs more than the arithmetic.
    """
    axes = rotations.swapaxes(1, 2)
    columns = np.empty((len(rotations), 6, *origins.shape[1:])) if out is None else out
    columns[:, :3] = axes
    cross_product(axes, (tip - origins)[:, None], out=columns[:, 3:])
    return columns


def independent_columns(rotations: Array, origins: Array, *, out: Array, scale: Array | None = None) -> Array:
    """Return the rows of `placement_columns` that are not combinations of others, for a tip at the last frame.

    A joint turns about the z axis of the frame before it, so that sliding along and turning about this axis
    are also twists of the next placement (`along_next`). What is left, (4 n + 3, 3, N), is x and y sliding,
    x and y turning of each frame, and the three ways of the tip; further rows of ``out`` become zero.
    ``scale`` (N,) multiplies all columns of a posture: as a part of the axes it costs nothing.
    """
    n, count = len(origins) - 1, origins.shape[-1]
    factor = np.ones(count) if scale is None else scale
    columns = out[: 4 * n].reshape(n, 4, 3, count)
    np.multiply(rotations[:-1].swapaxes(1, 2)[:, :2], factor, out=columns[:, :2])
    cross_product(columns[:, :2], (origins[-1] - origins[:-1])[:, None], out=columns[:, 2:])
    np.multiply(rotations[-1].swapaxes(0, 1), factor, out=out[4 * n : 4 * n + 3])
    out[4 * n + 3 :] = 0.0
    return out


def by_independent_columns(placements: Array) -> Array:
    """Return (6 (n + 1), 4 n + 6): every twist of a placement by those of `independent_columns`.

    Behind the tip's three ways stand its three turns, which move nothing but an attitude.
    """
    n = len(placements) - 1
    combine = np.zeros((n + 1, 6, 4 * n + 6))
    k = np.arange(n)
    for row, column in ((0, 0), (1, 1), (3, 2), (4, 3)):
        combine[k, row, 4 * k + column] = 1.0
    combine[n, :, 4 * n :] = np.eye(6)
    x, y, z = placements[1:, :3, :3].swapaxes(0, 1)  # rows: axes before a placement, seen after it
    slide_turn = np.zeros((n, 2, 6))
    slide_turn[:, 0, :3] = slide_turn[:, 1, 3:] = z
    slide_turn[:, 1, :3] = placements[1:, :1, 3] * y - placements[1:, 1:2, 3] * x
    for i in reversed(range(n)):
        combine[i, 2::3] = slide_turn[i] @ combine[i + 1]
    return combine.reshape(6 * (n + 1), -1)


def cross_product(a: Array, b: Array, *, out: Array | None = None) -> Array:
    """Return a x b for arrays (…, 3, N) whose components are next to last, without numpy's axis shuffling."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape)) if out is None else out
    part = np.empty_like(result[..., 0, :])
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[..., j, :], b[..., k, :], out=result[..., i, :])
        result[..., i, :] -= np.multiply(a[..., k, :], b[..., j, :], out=part)
    return result


def load_model(name: str) -> RobotModel:
    """Return a nominal model that ships; `model_names` lists them.

    Behind ``@`` stands how the robot is mounted, where it is not as its file says: ``ur10@ceiling``, and whatever
    else `gravity_of` reads. The mounting stays in the model's name, so that all that is kept under it is kept apart.
    """
    base, _, mounting = name.partition(MOUNTED)
    fields = model_fields(base)
    if mounting:
        fields["gravity_in_base"] = gravity_of(mounting)
    return RobotModel.from_dh(DhTable.from_rows(fields.pop("rows")), name=name, **fields)


def _tip_positions(rotations: Array, origins: Array, tip_in_flange_m: Array) -> Array:
    tip = np.asarray(tip_in_flange_m, dtype=float)
    if tip.shape not in ((3,), (origins.shape[-1], 3)) or not np.isfinite(tip).all():
        raise CalibrationError(
            f"a tip is three finite numbers, for all poses or for each, not shape {tip.shape}"
        )
    x, y, z = tip.T
    flange = rotations[-1]
    position: Array = flange[:, 0] * x + flange[:, 1] * y + flange[:, 2] * z + origins[-1]
    return position


def _by_controller_joints(model: RobotModel, columns: Array) -> Array:
    """Turn derivatives by DH angles (n, …) into derivatives by controller joints."""
    coupled = model.joint_coupling.T @ columns.reshape(len(columns), -1)
    return coupled.reshape(columns.shape)


def _stack_matrices(rotation: Array, origin: Array) -> Array:
    matrix = np.zeros((origin.shape[-1], 4, 4))
    matrix[:, :3, :3] = rotation.transpose(2, 0, 1)
    matrix[:, :3, 3] = origin.T
    matrix[:, 3, 3] = 1.0
    return matrix


def _frozen_copy(array: Array) -> Array:
    copy = np.array(array, dtype=float)
    copy.setflags(write=False)
    return copy
