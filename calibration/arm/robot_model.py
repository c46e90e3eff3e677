"""Serial arms: forward kinematics and its derivatives, for thousands of poses at once.

A model is a row of fixed placements with a joint between each two::

    base_flange(q) = P_0  Rz(u_1)  P_1  Rz(u_2) … Rz(u_n)  P_n        u = theta0 + joint_coupling @ q

A prismatic joint has Tz(u), metres, in place of Rz(u). ``q`` are the joint positions that the controller shows.
Signs, and joints that the controller couples (FANUC's J2 and J3), live in ``joint_coupling``; a Denavit-Hartenberg
table is one way to write the placements, a URDF another.

Inside, arrays have their components first and the pose last, so that every operation runs along memory and
the fixed placements become one matrix product per joint; at public borders the pose is first.
"""

from copy import copy
from dataclasses import dataclass, replace
from threading import local
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.chain_columns import cross_product, frames_of_placements, placement_columns
from cellcal.calibration.arm.dh_table import DhTable, read_only
from cellcal.calibration.arm.joint_kinds import (
    PRISMATIC,
    REVOLUTE,
    CombinedLimit,
    check_joint_types,
    rotations_about_z,
    sliding_joints,
)
from cellcal.calibration.arm.shown_names import shown_name
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, exp_twist, is_rigid

MODEL_TOLERANCE_M = 0.05  # no robot leaves its maker with so much; the arm of another model is further off
_MOST_REMEMBERED = 8192  # postures; of more, comparing and storing would cost memory that a fit needs
_BLOCK = 2048  # postures at once, of more than are remembered: frames of all would not stay in the cache


class _LastFrames(local):
    """The last frames of each thread: one check of a move asks for those of the same postures some ten times."""

    model: "RobotModel | None" = None
    joints_rad: Array = np.empty((0, 0))
    frames: tuple[Array, Array] = (np.empty(0), np.empty(0))


_last_frames = _LastFrames()


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A serial arm. Arrays are read-only; changed models are new models.

    Of a prismatic joint, ``theta0_rad``, limits and speed are metres and metres a second.
    """

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
    joint_types: tuple[str, ...] = ()  # revolute | continuous | prismatic; none: all revolute
    combined_limits: tuple[CombinedLimit, ...] = ()

    def __post_init__(self) -> None:
        for field in (
            "placements",
            "theta0_rad",
            "joint_coupling",
            "lower_rad",
            "upper_rad",
            "max_speed_rad_s",
        ):
            object.__setattr__(self, field, read_only(self.__dict__[field]))
        n = len(self.joint_names)
        check_joint_types(self.name, self.kinds, self.combined_limits, n)
        _refuse_table_of_slides(self.name, self.dh, self.joint_types)
        shapes = {v.shape for v in (self.theta0_rad, self.lower_rad, self.upper_rad, self.max_speed_rad_s)}
        if shapes != {(n,)} or self.joint_coupling.shape != (n, n) or self.placements.shape != (n + 1, 4, 4):
            raise CalibrationError(f"{self.label}: the arrays of the model do not fit its {n} joints")
        if not is_rigid(self.placements):
            raise CalibrationError(f"{self.label}: a placement is not a rigid transform")
        if not (np.isfinite(self.theta0_rad).all() and (self.lower_rad < self.upper_rad).all()):
            raise CalibrationError(
                f"{self.label}: joint zeros must be finite and lower limits below upper ones"
            )
        if not abs(float(np.linalg.norm(self.gravity_in_base)) - 1.0) < 1e-6:
            raise CalibrationError(f"{self.label}: the direction of gravity must be a unit vector")
        if not abs(np.linalg.det(self.joint_coupling)) > 1e-9:
            raise CalibrationError(f"{self.label}: the joint coupling is singular: some axis would not move")

    @classmethod
    def from_dh(
        cls,
        dh: DhTable,
        *,
        base: Array | None = None,
        flange: Array | None = None,
        joint_types: tuple[str, ...] = (),
        **fields: object,
    ) -> Self:
        """Build from a DH table between the frames ``base`` (before the first row) and ``flange`` (after the last).

        A table with a flange behind it, or with a prismatic joint (whose position adds to d), is turned into
        placements: the model has no ``dh`` then.
        """
        n = len(dh.theta_rad)
        slides = np.array([kind == PRISMATIC for kind in joint_types or (REVOLUTE,) * n])
        rows = dh.to_placements()
        if slides.shape == (n,):  # other numbers of types are refused below
            rows[slides] = rotations_about_z(dh.theta_rad[slides]) @ rows[slides]
        if flange is not None:
            rows[-1] = rows[-1] @ flange
        values: dict[str, object] = {
            "title": fields.get("name"),
            "joint_coupling": np.eye(n),
            "joint_names": tuple(f"joint_{i + 1}" for i in range(n)),
            "lower_rad": np.full(n, -np.pi),
            "upper_rad": np.full(n, np.pi),
            "max_speed_rad_s": np.ones(n),
            **fields,
        }
        first = np.eye(4) if base is None else np.asarray(base, dtype=float)
        return cls(
            dh=None if flange is not None or slides.any() else dh,
            placements=np.concatenate([first[None], rows]),
            theta0_rad=np.where(slides, 0.0, dh.theta_rad) if slides.shape == (n,) else dh.theta_rad,
            joint_types=joint_types,
            **values,  # type: ignore[arg-type]  # checked in __post_init__
        )

    @property
    def label(self) -> str:
        """The name for sentences: of a file without its folder and digest."""
        return shown_name(self.name)

    @property
    def axis_count(self) -> int:
        """The number of joints."""
        return len(self.joint_names)

    @property
    def kinds(self) -> tuple[str, ...]:
        """The type of every joint."""
        return self.joint_types or (REVOLUTE,) * self.axis_count

    @property
    def sliding(self) -> NDArray[np.bool_] | None:
        """Which joints are prismatic, (n,); None where none is."""
        return sliding_joints(self.joint_types)

    @property
    def joint_twists(self) -> NDArray[np.intp]:
        """Which component of a right twist of the placement before it a joint moves along, (n,): 2 or 5."""
        return np.array([2 if kind == PRISMATIC else 5 for kind in self.kinds], dtype=np.intp)

    def base_flange(self, joints_rad: Array) -> Array:
        """Return (N, 4, 4): the flange in the base for each of (N, n) joint vectors."""
        if len(joints_rad) <= _MOST_REMEMBERED:
            rotations, origins = chain_frames(self, joints_rad)
            return _stack_matrices(rotations[-1], origins[-1])
        flanges = np.empty((len(joints_rad), 4, 4))
        for first in range(0, len(joints_rad), _BLOCK):
            flanges[first : first + _BLOCK] = self.base_flange(joints_rad[first : first + _BLOCK])
        return flanges

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
        turning = rotations[:-1, :, 2]
        if self.sliding is not None:
            turning = np.where(self.sliding[:, None, None], 0.0, turning)
        angular = _by_controller_joints(self, turning)
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
        return self._with_geometry(dh, placements, dh.theta_rad)

    def with_twists(self, twists: Array) -> "RobotModel":
        """Return the model with ``P_k exp(v, w)`` in place of each ``P_k``; twists (n + 1, 6) [m, rad].

        The result has no DH table any more: apply DH errors first.
        """
        twists = np.asarray(twists, dtype=float)
        if twists.shape != (self.axis_count + 1, 6):
            raise CalibrationError(
                f"{self.label}: twists must be ({self.axis_count + 1}, 6), not {twists.shape}"
            )
        return self._with_geometry(None, self.placements @ exp_twist(twists), self.theta0_rad)

    def _with_geometry(self, dh: DhTable | None, placements: Array, theta0_rad: Array) -> "RobotModel":
        if not (np.isfinite(placements).all() and np.isfinite(theta0_rad).all()):
            return replace(self, dh=dh, placements=placements, theta0_rad=theta0_rad)  # which refuses them
        # Finite DH rows and twists are rigid, and nothing else changes: fits make thousands of such models.
        changed = copy(self)
        object.__setattr__(changed, "dh", dh)
        object.__setattr__(changed, "placements", read_only(placements))
        object.__setattr__(changed, "theta0_rad", read_only(theta0_rad))
        return changed

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
        joint k + 1 turns about, or slides along, its z axis ``rotations[k, :, 2]``; frame n is the flange.
    origins : (n + 1, 3, N)
        [m]. Each axis ``rotations[k, :, j]`` and each origin is contiguous in memory. Both are read-only.

    Raises
    ------
    CalibrationError
        Joint angles of another shape, or not finite.
    """
    joints = np.asarray(joints_rad, dtype=float)
    if _last_frames.model is model and np.array_equal(_last_frames.joints_rad, joints):
        return _last_frames.frames
    if joints.ndim != 2 or joints.shape[1] != model.axis_count:
        raise CalibrationError(f"{model.label}: joints must be (N, {model.axis_count}), not {joints.shape}")
    if not np.isfinite(joints).all():
        raise CalibrationError(f"{model.label}: joint angles must be finite")
    angles = model.joint_coupling @ joints.T + model.theta0_rad[:, None]
    rotations, origins = frames_of_placements(model.placements, angles, sliding=model.sliding)
    rotations.flags.writeable = origins.flags.writeable = False
    if len(joints) <= _MOST_REMEMBERED:
        _last_frames.model, _last_frames.joints_rad = model, joints.copy()
        _last_frames.frames = rotations, origins
    return rotations, origins


def joint_columns(model: RobotModel, rotations: Array, origins: Array, tip: Array) -> Array:
    """Return (n, 3, N): d tip / d controller joint, from the frames of `chain_frames` and tips (3, N)."""
    axes = rotations[:-1, :, 2]
    columns = cross_product(axes, tip - origins[:-1])
    if model.sliding is not None:
        columns[model.sliding] = axes[model.sliding]
    return _by_controller_joints(model, columns)


def _refuse_table_of_slides(name: str, dh: DhTable | None, types: tuple[str, ...]) -> None:
    if dh is not None and PRISMATIC in types:
        raise CalibrationError(f"{name}: a model with a prismatic joint is given by its placements")


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
    """Turn derivatives by axis positions (n, …) into derivatives by controller joints."""
    coupled = model.joint_coupling.T @ columns.reshape(len(columns), -1)
    return coupled.reshape(columns.shape)


def _stack_matrices(rotation: Array, origin: Array) -> Array:
    matrix = np.zeros((origin.shape[-1], 4, 4))
    matrix[:, :3, :3] = rotation.transpose(2, 0, 1)
    matrix[:, :3, 3] = origin.T
    matrix[:, 3, 3] = 1.0
    return matrix
