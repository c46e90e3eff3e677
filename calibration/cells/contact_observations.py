"""Kinds of observation that only a cell with several series can use: contacts, guided wires, bars.

The verbs are those of `calibration.identification.observations`; the tip is given in the frame of the device,
whose own geometry is fixed there: a plane is its x-y plane, a ball and a pin
sit at its origin, a wire leaves along its z axis.
"""

from dataclasses import dataclass
from typing import ClassVar, Self, TypeAlias

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import (
    DevicePlacement,
    DistanceRows,
    LengthObservations,
    PointObservations,
    PoseObservations,
    Rows,
    TipFrames,
    check_rows,
)
from cellcal.calibration.message import make_message

_NEAREST_M = 1e-6  # nearer, a direction is noise


@dataclass(frozen=True, eq=False)
class PinTouches(PointObservations):
    """The tip stood at one fixed point; the positions (N, 3) are zero, or offsets from it in the world's axes [m]."""

    kind = "pin"
    place_axes: ClassVar[tuple[int, ...]] = (0, 1, 2)

    @classmethod
    def on_pin(cls, joints_rad: Array, sigma_m: Array, mounting: Rows) -> Self:
        """Build for rows that all put the tip on their mounting's pin."""
        return cls(joints_rad, np.zeros((len(joints_rad), 3)), sigma_m, mounting)


@dataclass(frozen=True, eq=False)
class PlaneContacts(DistanceRows):
    """The tip stood at a known height above a plane [m]: zero, its ball's radius, or the reading of a dial gauge."""

    joints_rad: Array  # (N, n)
    heights_m: Array  # (N,)
    sigma_m: Array  # (N,)
    mounting: Rows  # (N,)

    kind = "plane"
    channels = 1
    device_columns = 0
    needs_rotation = False
    place_axes: ClassVar[tuple[int, ...]] = (2, 3, 4)  # distance and tilt
    scalars: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        check_rows(self.joints_rad, self.heights_m, ())

    def compute_residuals(self, tip: TipFrames, device: DevicePlacement, rows: Rows | slice) -> Array:
        """Return measured minus predicted (1, N), in units of each row's sigma."""
        residual: Array = ((self.heights_m[rows] - tip[0][2]) / self.sigma_m[rows])[None]
        return residual

    def project_motions(
        self, linear: Array, angular: Array | None, tip: TipFrames, device: DevicePlacement
    ) -> Array:
        """Return how the height follows motions of the tip: (P, 3, N) to (P, 1, N)."""
        return linear[:, 2:]

    def own_columns(self, tip: TipFrames, device: DevicePlacement) -> Array:
        """Return how the height follows the device's own parameters: it has none."""
        return np.empty((0, 1, tip[0].shape[-1]))


@dataclass(frozen=True, eq=False)
class SphereContacts(DistanceRows):
    """The tip stood on a ball: its distances from the ball's centre [m], ball's radius plus that of the tip."""

    joints_rad: Array  # (N, n)
    radii_m: Array  # (N,)
    sigma_m: Array  # (N,)
    mounting: Rows  # (N,)

    kind = "sphere"
    channels = 1
    device_columns = 1
    needs_rotation = False
    place_axes: ClassVar[tuple[int, ...]] = (0, 1, 2)
    scalars: ClassVar[tuple[str, ...]] = ("radius_m",)  # by how much the ball is larger than stated

    def __post_init__(self) -> None:
        check_rows(self.joints_rad, self.radii_m, ())

    def compute_residuals(self, tip: TipFrames, device: DevicePlacement, rows: Rows | slice) -> Array:
        """Return measured minus predicted (1, N), in units of each row's sigma."""
        distance = np.linalg.norm(tip[0], axis=0) - device.radius_m
        residual: Array = ((self.radii_m[rows] - distance) / self.sigma_m[rows])[None]
        return residual

    def project_motions(
        self, linear: Array, angular: Array | None, tip: TipFrames, device: DevicePlacement
    ) -> Array:
        """Return how the distance follows motions of the tip: (P, 3, N) to (P, 1, N)."""
        along: Array = np.einsum("pcn,cn->pn", linear, _unit_vectors(tip[0]))[:, None]
        return along

    def own_columns(self, tip: TipFrames, device: DevicePlacement) -> Array:
        """Return how the distance follows the unknown part of the radius (1, 1, N)."""
        return -np.ones((1, 1, tip[0].shape[-1]))


@dataclass(frozen=True, eq=False)
class GuidedLengthObservations(LengthObservations):
    r"""Lengths of a wire that leaves along an axis over a rounded guide or a swivelling pulley of radius r [m].

    The wire comes along z of the device's frame to its origin and lies round a circle of radius r that touches z
    there, in the plane of z and the tip: the lip of an eyelet all round, or a pulley that swivels about z. It
    turns by ``phi`` and leaves in a straight line of length s::

        L = zero + scale (s + r phi)        rho = r (1 - cos phi) + s sin phi,   h = r sin phi + s cos phi

    for a tip at height h and distance rho from the axis. Derivatives are short, because wire under tension takes
    the shortest way: by the tip, the direction in which the wire leaves; by r, ``phi - sin phi``. With r = 0 it is
    the wire of `LengthObservations`. Lengths count from the origin.

    References
    ----------
    Derived here. To first order in r it is the ``r (phi - sin phi)`` of draw-wire makers' error budgets.
    """

    kind = "guided length"
    device_columns = 3
    place_axes: ClassVar[tuple[int, ...]] = (0, 1, 2, 3, 4)
    scalars: ClassVar[tuple[str, ...]] = ("zero_m", "scale", "radius_m")

    def compute_residuals(self, tip: TipFrames, device: DevicePlacement, rows: Rows | slice) -> Array:
        """Return measured minus predicted (1, N), in units of each row's sigma."""
        predicted = device.zero_m + device.scale * _guided_lengths(tip[0], device.radius_m)[0]
        residual: Array = ((self.lengths_m[rows] - predicted) / self.sigma_m[rows])[None]
        return residual

    def project_motions(
        self, linear: Array, angular: Array | None, tip: TipFrames, device: DevicePlacement
    ) -> Array:
        """Return how the length follows motions of the tip: (P, 3, N) to (P, 1, N)."""
        direction = device.scale * _guided_lengths(tip[0], device.radius_m)[1]
        along: Array = np.einsum("pcn,cn->pn", linear, direction)[:, None]
        return along

    def own_columns(self, tip: TipFrames, device: DevicePlacement) -> Array:
        """Return how the length follows zero, scale and radius (3, 1, N)."""
        length, _, turn = _guided_lengths(tip[0], device.radius_m)
        return np.stack([np.ones_like(length), length, device.scale * (turn - np.sin(turn))])[:, None]


@dataclass(frozen=True, eq=False)
class BarLengths(LengthObservations):
    """Distances between the places of one target in two postures [m]: a ballbar, two marks of a gauge of length.

    The "tip" of the verbs is the way from the second place to the first, in any axes.
    """

    other_joints_rad: Array  # (N, n)

    kind = "bar"
    device_columns = 2
    place_axes: ClassVar[tuple[int, ...]] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if (
            self.other_joints_rad.shape != self.joints_rad.shape
            or not np.isfinite(self.other_joints_rad).all()
        ):
            raise CalibrationError(
                make_message(
                    "the second postures of a bar must be finite and of shape {shape}, not {other_shape}",
                    shape=self.joints_rad.shape,
                    other_shape=self.other_joints_rad.shape,
                )
            )

    def own_columns(self, tip: TipFrames, device: DevicePlacement) -> Array:
        """Return how the length follows zero and scale (2, 1, N)."""
        return super().own_columns(tip, device)[3:]


CellObservations: TypeAlias = (
    PointObservations | PoseObservations | LengthObservations | PlaneContacts | SphereContacts
)


def _unit_vectors(way: Array) -> Array:
    unit: Array = way / np.maximum(np.linalg.norm(way, axis=0), _NEAREST_M)
    return unit


def _guided_lengths(tip: Array, radius_m: float) -> tuple[Array, Array, Array]:
    """Return length (N,), direction of the free wire (3, N) and angle turned (N,) for tips (3, N)."""
    across = np.hypot(tip[0], tip[1])
    sideways, height = across - radius_m, tip[2]
    distance = np.hypot(sideways, height)
    free = np.sqrt(np.maximum(distance**2 - radius_m**2, _NEAREST_M**2))
    # Of -(rho - r) cos phi + h sin phi = r, the root that is zero straight ahead.
    turn = np.arctan2(height, -sideways) - np.arccos(np.clip(radius_m / distance, -1.0, 1.0))
    turn = np.where(turn < -np.pi / 2, turn + 2 * np.pi, turn)  # behind the guide
    out = np.sin(turn) / np.maximum(across, _NEAREST_M)
    direction = np.stack([tip[0] * out, tip[1] * out, np.cos(turn)])
    return free + radius_m * turn, direction, turn
