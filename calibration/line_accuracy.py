"""Accuracy and repeatability in one direction, by a draw-wire: what ISO 9283 measures in three."""

import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.accuracy import refuse_fitted
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array

TITLE = "accuracy and repeatability along a draw-wire, one direction only; not a test to ISO 9283"


@dataclass(frozen=True, slots=True)
class LinePose:
    """One pose: mean length minus the one that the model says, and three standard deviations to either side."""

    ap_m: float
    signed_m: float
    ap_sigma_m: float
    rp_m: float
    rp_sigma_m: float


@dataclass(frozen=True, slots=True)
class LineTest:
    """All poses; the totals are the worst pose's."""

    title: str
    poses: tuple[LinePose, ...]
    cycles: int

    @property
    def ap_m(self) -> float:
        """The largest error along the wire."""
        return max(pose.ap_m for pose in self.poses)

    @property
    def rp_m(self) -> float:
        """The largest scatter along the wire."""
        return max(pose.rp_m for pose in self.poses)


def evaluate_lengths(
    commanded_m: Array,
    lengths_m: Array,
    joints_rad: Array,
    *,
    device_sigma_m: float | Array,
    fitted_joints_rad: Array,
) -> LineTest:
    """Evaluate error and scatter along the wire at poses that took no part in a fit.

    Parameters
    ----------
    commanded_m : (P,)
        Lengths that the model says for the commanded joints [m].
    lengths_m : (P, n)
        Lengths found, n cycles [m].
    joints_rad, fitted_joints_rad : (P, axes), (F, axes)
        Of the test poses, and of every row that was fitted [rad].
    device_sigma_m : float or (P,)
        What wire and model lengths get wrong every time [m].

    Raises
    ------
    CalibrationError
        A test pose was fitted; fewer than two cycles; numbers that are not finite.
    """
    refuse_fitted(joints_rad, fitted_joints_rad)
    lengths, commanded = np.asarray(lengths_m, dtype=float), np.asarray(commanded_m, dtype=float)
    if (
        lengths.ndim != 2
        or commanded.shape != lengths.shape[:1]
        or not np.isfinite([*lengths.ravel(), *commanded]).all()
    ):
        raise CalibrationError("lengths (P, n) need P finite lengths commanded")
    cycles = lengths.shape[1]
    if cycles < 2:
        raise CalibrationError(
            "one cycle says nothing about repeatability.", remedy="Go round five times or more."
        )
    poses = []
    every_time = np.broadcast_to(device_sigma_m, commanded.shape)
    for found, goal, device_m in zip(lengths, commanded, every_time, strict=True):
        off, spread = float(found.mean() - goal), float(found.std(ddof=1))
        sigma = math.hypot(spread / math.sqrt(cycles), device_m)
        poses.append(
            LinePose(abs(off), off, sigma, 3.0 * spread, 3.0 * spread / math.sqrt(2.0 * (cycles - 1)))
        )
    return LineTest(TITLE, tuple(poses), cycles)
