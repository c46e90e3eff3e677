"""Readings of a robot that was known to be healthy, at a few poses, twice: what later ones are compared with."""

import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class DriftReference:
    """Two rounds of readings at the same poses. They hold for the mastering and the device they were taken with."""

    robot_serial: str
    model: str
    method: str  # wire | tracker
    counts_at_zero: tuple[int, ...]  # empty where the robot keeps none
    station: int  # of the tracker; 0 for a wire
    rest_rad: tuple[float, ...]  # from where every pose is gone to, always the same way
    poses_rad: Rows  # as commanded
    joints_rad: Rows  # as shown
    first_m: Rows  # lengths or places
    again_m: Rows
    noise_m: float  # standard deviation of one coordinate of one reading, stated

    def __post_init__(self) -> None:
        tables = (self.poses_rad, self.joints_rad, self.first_m, self.again_m)
        sizes = {len(table) for table in tables}
        finite = all(math.isfinite(value) for table in tables for row in table for value in row)
        if len(sizes) != 1 or 0 in sizes or not finite or not self.noise_m > 0:
            raise CalibrationError("a drift reference has finite readings at each of its poses, twice")

    def values_m(self) -> Array:
        """Return the mean of both rounds (N, channels) [m]."""
        mean: Array = (np.array(self.first_m) + np.array(self.again_m)) / 2.0
        return mean

    def sigma_m(self, repeat_m: float) -> float:
        """Return the standard deviation [m] of one coordinate of that mean: stated, or as the rounds differ if more.

        ``repeat_m`` is how well such an arm comes back to a pose.
        """
        gaps = np.array(self.again_m) - np.array(self.first_m)
        shown = float(np.sqrt(np.mean(gaps**2) / 2.0))  # of one reading, from the difference of two
        return max(shown, math.hypot(self.noise_m, repeat_m)) / math.sqrt(2.0)
