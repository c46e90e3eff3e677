"""Encoder counts, turns and zero offsets, both ways; and what must be stored before they are lost."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.metres import MOST_OF_TOOL_M, refuse_not_metres
from cellcal.calibration.wires.model import WirePrior
from cellcal.calibration.wires.reference import WireReference


@dataclass(frozen=True, slots=True)
class DriveTrain:
    """The relation of motors and joints: ``joint = interaction . (count - count_at_zero)``.

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

    def to_joints(self, counts: Array, counts_at_zero: Array) -> Array:
        """Return joint angles (…, n) [rad] from counts (…, n) and the counts at joint angle zero (n,)."""
        moved = np.asarray(counts, dtype=float) - np.asarray(counts_at_zero, dtype=float)
        joints: Array = moved @ np.array(self.radians_per_count).T
        return joints

    def to_counts(self, joints_rad: Array, counts_at_zero: Array) -> Array:
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
class PlaceCapture:
    """The tool at a place that stays where it is, with the motor counts read at standstill.

    ``kind`` is "point" (a tip touches it), "seat" (a keyed seat holds the tool in all six directions), "target"
    (an instrument saw a target on the flange at ``seen_m``) or "nest" (it saw a fixed target there; the counts
    then mean nothing). ``place`` numbers places: the same number is the same place, before the loss and after.
    """

    kind: str
    place: int
    counts: tuple[int, ...]
    sigma_m: float
    sigma_rad: float = 0.0  # of a seat's attitude
    seen_m: tuple[float, float, float] | None = None  # in the instrument's own frame
    label: str = ""

    def __post_init__(self) -> None:
        if self.kind not in ("point", "seat", "target", "nest"):
            raise CalibrationError(f"capture {self.label!r}: there is no kind {self.kind!r} of place")
        position_m = (0.0, 0.0, 0.0) if self.seen_m is None else self.seen_m
        if not np.isfinite([self.sigma_m, self.sigma_rad, *position_m]).all() or self.sigma_m <= 0:
            raise CalibrationError(f"capture {self.label!r}: numbers must be finite, the deviation > 0")
        if self.kind == "seat" and self.sigma_rad <= 0:
            raise CalibrationError(f"capture {self.label!r}: a seat needs a deviation of its attitude > 0")
        if (self.kind in ("target", "nest")) != (self.seen_m is not None):
            raise CalibrationError(
                f"capture {self.label!r}: an instrument's capture says where it saw its target"
            )


@dataclass(frozen=True, slots=True)
class RecoveryKit:
    """Places measured while the robot was healthy, any of which tells lost turns again without a draw-wire."""

    tip_in_flange_m: tuple[float, float, float]  # touching tip, or the instrument's target
    places: tuple[PlaceCapture, ...]
    sigma_tip_m: float = 0.001
    sigma_length_m: float = 0.0005  # of each link length and offset
    sigma_angle_rad: float = 0.0005236  # of each link angle
    sigma_flex_rad: float = 0.00015  # joints under gravity, smooth over the postures
    sigma_joint_rad: float = (
        0.0002  # gear ripple, and a joint that comes to rest by hand on either tooth flank
    )

    def __post_init__(self) -> None:
        sigmas = [self.sigma_tip_m, self.sigma_length_m, self.sigma_angle_rad]
        sigmas += [self.sigma_flex_rad, self.sigma_joint_rad]
        if not np.isfinite([*self.tip_in_flange_m, *sigmas]).all() or min(sigmas) <= 0:
            raise CalibrationError(
                "the tip and the deviations of a recovery kit must be finite, deviations > 0"
            )
        refuse_not_metres(self.tip_in_flange_m, "tip of the recovery kit", MOST_OF_TOOL_M)


@dataclass(frozen=True, slots=True)
class MasteringRecord:
    """Data stored while the robot is healthy, so that lost turns can be found again. Never changed.

    One taken without a draw-wire has a kit of places, and no wire, prior or captures. A controller's backup tells
    counts at zero and drives only: such a record has not even a kit, and where its quick-master reference is void no
    reference pose either.
    """

    robot_serial: str
    model: str
    epoch: int
    drive: DriveTrain
    counts_at_zero: tuple[int, ...]
    reference_joints_rad: tuple[float, ...]
    reference_counts: tuple[int, ...]
    captures: tuple[WireCapture, ...]
    wire: WireReference | None
    prior: WirePrior | None
    taken_by: str
    sha256: str
    kit: RecoveryKit | None = None  # None in records older than kits

    @property
    def is_measured(self) -> bool:
        """Return whether it holds lengths or places, so that lost turns can be found with it."""
        return self.wire is not None or self.kit is not None

    def wire_lengths(self) -> tuple[WireReference, WirePrior]:
        """Return what its wire lengths say, and what was known before.

        Raises
        ------
        CalibrationError
            It is from a controller's backup, or was taken without a draw-wire, and holds none.
        """
        if self.kit is not None and (self.wire is None or self.prior is None):
            raise CalibrationError(
                "the mastering record was taken without a draw-wire: it holds places, and no lengths.",
                remedy="Recover by its places, or take a new record with the draw-wire while the robot is healthy.",
            )
        if self.wire is None or self.prior is None:
            raise CalibrationError(
                "the mastering record is from a controller's backup: it holds counts, and no lengths.",
                remedy="Type its counts in if only the controller's memory was lost; else master by marks or pins.",
            )
        return self.wire, self.prior

    def capture_joints_rad(self) -> Array:
        """Return (N, n): the joints at the record's captures [rad]."""
        self.wire_lengths()
        return self.drive.to_joints(
            np.array([c.counts for c in self.captures]), np.array(self.counts_at_zero)
        )


def provisional_turns(
    drive: DriveTrain, healthy_counts: Sequence[int], read_counts: Sequence[int]
) -> tuple[int, ...]:
    """Return the whole turns that bring the counts read now nearest to the last healthy ones, per motor.

    Exact if the arm stood still while off; a few turns out if it sagged or was moved.
    """
    triples = zip(healthy_counts, read_counts, drive.counts_per_turn, strict=True)
    return tuple(round((healthy - read) / per_turn) for healthy, read, per_turn in triples)
