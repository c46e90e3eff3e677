"""What a controller whose encoders cannot be read shows of its position, and lengths taken while it is healthy."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord

UNITS_PER_TURN = (
    1 << 16
)  # shown joints in whole units of this share of a motor turn: under 1e-5 rad of any joint


@dataclass(frozen=True, slots=True)
class ShownValue:
    """One value as the controller shows it, in its own text."""

    name: str  # as the maker calls it
    value: str
    axis: int | None = None  # 0-based, where it belongs to one
    unit: str = ""
    is_constant: bool = False  # a datum of the machine, which no motion and no cure changes
    is_zero: bool = False  # a datum of the zero position, which only making that zero anew changes
    is_set: bool = False  # a datum that changes only when a person brings the position back at the pendant


@dataclass(frozen=True, slots=True)
class ArmPositionRecord:
    """Lengths over the reach of a healthy robot, with what its controller showed. Never changed.

    The counts of ``measured`` are no encoder counts: they are the joints that the controller shows, in units of
    1/65536 motor turn, with joint zero at zero.
    """

    measured: MasteringRecord
    shown: tuple[ShownValue, ...]


def drive_of_ratios(motor_turns: Sequence[float]) -> DriveTrain:
    """Return the drive of shown joints, from the motor turns of one turn of each joint (signed).

    Raises
    ------
    CalibrationError
        A ratio that is no ratio of a robot's joint.
    """
    ratios = np.asarray(motor_turns, dtype=float)
    if ratios.ndim != 1 or not np.isfinite(ratios).all() or (np.abs(ratios) < 1.0).any():
        raise CalibrationError("the motor turns of a joint turn must be finite, and 1 or more each")
    matrix = np.diag(2.0 * np.pi / ratios / UNITS_PER_TURN)
    return DriveTrain(tuple(tuple(float(v) for v in row) for row in matrix), (UNITS_PER_TURN,) * len(ratios))
