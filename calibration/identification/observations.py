"""What a measuring device saw of the moving arm, and how it depends on the place of the target.

Each kind is one class with the same few verbs, so that one estimator fits any of them. All arrays have the
pose first. ``mounting`` says, row by row, which mounting of the device the row belongs to: a device that is
taken down and put up again has a new place and the same scale.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import ClassVar, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, log_rotation

Rows: TypeAlias = NDArray[np.intp]

# Tip frames of a block of rows: position (3, N), rotation (3, 3, N), components first.
TipFrames: TypeAlias = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class DevicePlacement:
    """The place of one mounting of a device: a frame for points and poses, an anchor for lengths."""

    device_base: Array  # (4, 4); identity for a length gauge
    anchor_in_base_m: Array  # (3,); used by a length gauge
    zero_m: float = 0.0
    scale: float = 1.0
    radius_m: float = 0.0  # of a wire's guide, or by how much a touched ball is larger than stated


class MeasuredRows:
    """The fields that all kinds share: every field is an array with one entry a row, joints first."""

    joints_rad: Array  # (N, n)
    sigma_m: Array  # (N,)

    def __len__(self) -> int:
        return len(self.joints_rad)

    def select_rows(self, rows: Rows) -> Self:
        """Return these rows only."""
        taken = copy(self)
        for field, values in self.__dict__.items():
            object.__setattr__(taken, field, values[rows])
        return taken

    def scale_sigma(self, factor: float, turn_factor: float = 1.0) -> Self:
        """Return the rows with standard deviations of lengths, and of attitudes, multiplied by factors."""
        scaled = copy(self)
        object.__setattr__(scaled, "sigma_m", self.sigma_m * factor)
        return scaled

    def inverse_sigmas(self, rows: Rows | slice) -> Array:
        """Return 1 / sigma of every channel (channels or 1, N)."""
        scales: Array = 1.0 / self.sigma_m[None, rows]
        return scales


@dataclass(frozen=True, eq=False)
class PointObservations(MeasuredRows):
    """Positions of one target on the end-effector in the frame of a tracker or camera [m]."""

    joints_rad: Array  # (N, n)
    positions_m: Array  # (N, 3)
    sigma_m: Array  # (N,)
    mounting: Rows  # (N,)

    kind = "point"
    channels = 3
    device_columns = 0
    needs_rotation = False
    place_axes: ClassVar[tuple[int, ...]] = (0, 1, 2, 3, 4, 5)  # of the device's frame, that the rows see
    scalars: ClassVar[tuple[str, ...]] = ()  # of the device: the last of its own columns

    def __post_init__(self) -> None:
        check_rows(self.joints_rad, self.positions_m, (3,))

    def compute_residuals(self, tip: TipFrames, device: DevicePlacement, rows: Rows | slice) -> Array:
        """Return measured minus predicted (channels, N), in units of each row's sigma."""
        residual: Array = (self.positions_m[rows].T - tip[0]) / self.sigma_m[rows]
        return residual

    def project_motions(
        self, linear: Array, angular: Array | None, tip: TipFrames, device: DevicePlacement
    ) -> Array:
        """Return how the channels follow motions of the tip: (P, 3, N) to (P, channels, N)."""
        return linear

    def own_columns(self, tip: TipFrames, device: DevicePlacement) -> Array:
        """Return how the channels follow the device's own parameters (D, channels, N)."""
        return np.empty((0, self.channels, tip[0].shape[-1]))

    def errors_m(self, residuals: Array) -> Array:
        """Return the size of the error of every row [m] from whitened residuals (channels, N)."""
        sizes: Array = np.linalg.norm(residuals[:3], axis=0) * self.sigma_m
        return sizes


@dataclass(frozen=True, eq=False)
class PoseObservations(PointObservations):
    """Full poses of one target; attitudes are compared as rotation vectors in the device's frame [rad]."""

    rotations: Array  # (N, 3, 3)
    sigma_rad: Array  # (N,)

    kind = "pose"
    channels = 6
    needs_rotation = True

    def compute_residuals(self, tip: TipFrames, device: DevicePlacement, rows: Rows | slice) -> Array:
        linear = super().compute_residuals(tip, device, rows)
        predicted = np.moveaxis(tip[1], -1, 0)
        turn = log_rotation(self.rotations[rows] @ np.swapaxes(predicted, -1, -2))
        return np.concatenate([linear, turn.T / self.sigma_rad[rows]])

    def project_motions(
        self, linear: Array, angular: Array | None, tip: TipFrames, device: DevicePlacement
    ) -> Array:
        if angular is None:
            raise CalibrationError("poses need the turning of the tip, too")
        return np.concatenate([linear, angular], axis=1)

    def scale_sigma(self, factor: float, turn_factor: float = 1.0) -> Self:
        scaled = super().scale_sigma(factor)
        object.__setattr__(scaled, "sigma_rad", self.sigma_rad * turn_factor)
        return scaled

    def inverse_sigmas(self, rows: Rows | slice) -> Array:
        position, turn = 1.0 / self.sigma_m[rows], 1.0 / self.sigma_rad[rows]
        return np.stack([position] * 3 + [turn] * 3)


class DistanceRows(MeasuredRows):
    """Rows of one distance each."""

    def errors_m(self, residuals: Array) -> Array:
        """Return the size of the error of every row [m] from whitened residuals (1, N)."""
        sizes: Array = np.abs(residuals[0]) * self.sigma_m
        return sizes


@dataclass(frozen=True, eq=False)
class LengthObservations(DistanceRows):
    """Lengths of a draw-wire between its anchor and a hook on the end-effector [m]."""

    joints_rad: Array  # (N, n)
    lengths_m: Array  # (N,)
    sigma_m: Array  # (N,)
    mounting: Rows  # (N,)

    kind = "length"
    channels = 1
    device_columns = 5  # anchor x y z, zero, scale
    needs_rotation = False
    place_axes: ClassVar[tuple[int, ...]] = (0, 1, 2)
    scalars: ClassVar[tuple[str, ...]] = ("zero_m", "scale")

    def __post_init__(self) -> None:
        check_rows(self.joints_rad, self.lengths_m, ())

    def compute_residuals(self, tip: TipFrames, device: DevicePlacement, rows: Rows | slice) -> Array:
        """Return measured minus predicted (1, N), in units of each row's sigma."""
        length = np.linalg.norm(_wires(tip, device), axis=0)
        predicted = device.zero_m + device.scale * length
        residual: Array = ((self.lengths_m[rows] - predicted) / self.sigma_m[rows])[None]
        return residual

    def project_motions(
        self, linear: Array, angular: Array | None, tip: TipFrames, device: DevicePlacement
    ) -> Array:
        """Return how the length follows motions of the tip: (P, 3, N) to (P, 1, N)."""
        direction = -device.scale * _wire_directions(tip, device)
        along: Array = np.einsum("pcn,cn->pn", linear, direction)[:, None]
        return along

    def own_columns(self, tip: TipFrames, device: DevicePlacement) -> Array:
        """Return how the length follows anchor, zero and scale (5, 1, N)."""
        away = _wires(tip, device)
        length = np.linalg.norm(away, axis=0)
        columns = np.empty((5, 1, away.shape[-1]))
        np.multiply(device.scale, away / length, out=columns[:3, 0])
        columns[3], columns[4] = 1.0, length
        return columns


Observations: TypeAlias = PointObservations | PoseObservations | LengthObservations


def pose_from_points(points: PointObservations, rotations: Array, sigma_rad: Array) -> PoseObservations:
    """Return the same rows with their attitudes."""
    return PoseObservations(
        points.joints_rad, points.positions_m, points.sigma_m, points.mounting, rotations, sigma_rad
    )


def points_of_poses(poses: PoseObservations) -> PointObservations:
    """Return the same rows without their attitudes."""
    return PointObservations(poses.joints_rad, poses.positions_m, poses.sigma_m, poses.mounting)


def with_mounting(observations: Observations, mounting: Rows) -> Observations:
    """Return the rows with another assignment to mountings of the device."""
    return replace(observations, mounting=np.asarray(mounting, dtype=np.intp))


def with_joints(observations: Observations, joints_rad: Array) -> Observations:
    """Return the rows with other joint angles (rounding removed, say)."""
    return replace(observations, joints_rad=joints_rad)


def join_gauges(devices: Sequence[DevicePlacement], rows: Sequence[int]) -> DevicePlacement | None:
    """Return the mountings of one length gauge, each for so many rows, as one: its anchor is (3, N).

    None if zero or scale differ. A length gauge has no frame of its own.
    """
    first = devices[0]
    alike = all(
        (each.zero_m, each.scale, each.radius_m) == (first.zero_m, first.scale, first.radius_m)
        for each in devices
    )
    if not alike:
        return None
    anchors = np.repeat(np.stack([each.anchor_in_base_m for each in devices], axis=1), rows, axis=1)
    return replace(first, anchor_in_base_m=anchors)


def _wires(tip: TipFrames, device: DevicePlacement) -> Array:
    """Return the wire (3, N) from the hook to the anchor, which is one for all rows or one a row."""
    wires: Array = device.anchor_in_base_m.reshape(3, -1) - tip[0]
    return wires


def _wire_directions(tip: TipFrames, device: DevicePlacement) -> Array:
    away = _wires(tip, device)
    unit: Array = away / np.linalg.norm(away, axis=0)
    return unit


def check_rows(joints_rad: Array, values: Array, shape: tuple[int, ...]) -> None:
    """Refuse values that do not belong to the joints, or are not finite."""
    if joints_rad.ndim != 2 or values.shape != (len(joints_rad), *shape):
        raise CalibrationError(
            f"observations of shape {values.shape} do not belong to joints {joints_rad.shape}"
        )
    if not (np.isfinite(joints_rad).all() and np.isfinite(values).all()):
        raise CalibrationError("joints and observations must be finite")
