"""Encoder counts, turns and zero offsets, both ways; and what must be stored before they are lost."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.errors import CalibrationError
from calibration.geometry import Array
from calibration.wire_model import WirePrior
from calibration.wire_reference import WireReference


@dataclass(frozen=True, slots=True)
class DriveTrain:
    """How motors turn joints: ``joint = interaction . (count - count_at_zero)``.

    ``radians_per_count`` is the interaction matrix, row-major; off-diagonal terms are the wrist coupling.
    ``counts_per_turn`` is the smallest count step after which the surviving single-turn reading repeats.
    """

    radians_per_count: tuple[tuple[float, ...], ...]
    counts_per_turn: tuple[int, ...]

    def __post_init__(self) -> None:
        matrix = np.array(self.radians_per_count, dtype=float)
        n = len(self.counts_per_turn)
        if matrix.shape != (n, n) or not np.isfinite(matrix).all() or min(self.counts_per_turn) <= 0:
            raise CalibrationError(f"a drive train of {n} axes needs a finite {n} x {n} interaction matrix")
        if np.linalg.matrix_rank(matrix) < n:
            raise CalibrationError("the interaction matrix is singular: some joint would not turn at all")

    def joints(self, counts: Array, counts_at_zero: Array) -> Array:
        """Return joint angles (…, n) [rad] from counts (…, n) and the counts at joint angle zero (n,)."""
        moved = np.asarray(counts, dtype=float) - np.asarray(counts_at_zero, dtype=float)
        joints: Array = moved @ np.array(self.radians_per_count).T
        return joints

    def counts(self, joints_rad: Array, counts_at_zero: Array) -> Array:
        """Return the whole counts (…, n) nearest to joint angles (…, n) [rad]."""
        inverse = np.linalg.inv(np.array(self.radians_per_count))
        moved = np.asarray(joints_rad, dtype=float) @ inverse.T
        counts: Array = np.rint(moved + np.asarray(counts_at_zero, dtype=float))
        return counts

    def radians_per_turn(self) -> Array:
        """Return (n, n): column j is the joint motion [rad] of one whole turn of motor j."""
        turns: Array = np.array(self.radians_per_count) * np.array(self.counts_per_turn, dtype=float)
        return turns

    def shifted_zero(self, counts_at_zero: Sequence[int], offset_turns: Sequence[float]) -> tuple[int, ...]:
        """Return the counts at zero that make up for a loss: true count = read + turns x counts per turn.

        Whole turns move the zero by whole turns, so the old mastering's accuracy comes back exactly.
        """
        pairs = zip(counts_at_zero, self.counts_per_turn, offset_turns, strict=True)
        return tuple(int(zero) - round(per_turn * turns) for zero, per_turn, turns in pairs)


@dataclass(frozen=True, slots=True)
class WireCapture:
    """One wire length with the motor counts read at standstill.

    ``settled_from`` is "record" where every joint came to rest from the side the record used, anything else
    where it may lie on either tooth flank.
    """

    counts: tuple[int, ...]
    length_m: float
    sigma_m: float
    settled_from: str = "record"
    label: str = ""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.length_m) and np.isfinite(self.sigma_m) and self.sigma_m > 0):
            raise CalibrationError(
                f"capture {self.label!r}: length and deviation must be finite, deviation > 0"
            )


@dataclass(frozen=True, slots=True)
class MasteringRecord:
    """What is stored while the robot is healthy, so that lost turns can be found again. Never changed."""

    robot_serial: str
    model: str
    epoch: int
    drive: DriveTrain
    counts_at_zero: tuple[int, ...]
    reference_joints_rad: tuple[float, ...]
    reference_counts: tuple[int, ...]
    captures: tuple[WireCapture, ...]
    wire: WireReference
    prior: WirePrior
    taken_by: str
    sha256: str

    def capture_joints_rad(self) -> Array:
        """Return (N, n): the joints at the record's captures [rad]."""
        return self.drive.joints(np.array([c.counts for c in self.captures]), np.array(self.counts_at_zero))


def provisional_turns(
    drive: DriveTrain, healthy_counts: Sequence[int], read_counts: Sequence[int]
) -> tuple[int, ...]:
    """Return the whole turns that bring the counts read now nearest to the last healthy ones, per motor.

    Exact if the arm stood still while off; a few turns out if it sagged or was moved.
    """
    triples = zip(healthy_counts, read_counts, drive.counts_per_turn, strict=True)
    return tuple(round((healthy - read) / per_turn) for healthy, read, per_turn in triples)
