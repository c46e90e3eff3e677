"""Pulses and angles, and the orders that move and hold the robot."""

import math
import struct
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.drivers.yaskawa.hses_frames import HsesRequest
from cellcal.drivers.yaskawa.state import AXES

_LINK_MOVE, _ROBOT, _PERCENT_CLASS = 1, 1, 0
_ORDER = struct.Struct("<4I8i10i")
_PERCENT_STEPS = 100  # the speed is written in hundredths of a per cent
_LARGEST_PULSE = 2**31 - 1


@dataclass(frozen=True, slots=True)
class PulseScale:
    """The relation of pulses and angles: signed pulses per degree of each axis."""

    pulses_per_degree: tuple[float, ...]

    def to_joints(self, pulses: tuple[int, ...]) -> tuple[float, ...]:
        """Return joint angles [rad]."""
        return tuple(
            math.radians(count / per_degree)
            for count, per_degree in zip(pulses, self.pulses_per_degree, strict=True)
        )

    def to_pulses(self, joints_rad: Array) -> tuple[int, ...]:
        """Return the nearest whole pulses.

        Raises
        ------
        ValueError
            More than the controller's number holds.
        """
        pulses = np.rint(np.degrees(joints_rad) * np.array(self.pulses_per_degree))
        if not (np.isfinite(pulses).all() and float(np.abs(pulses).max()) < _LARGEST_PULSE):
            raise ValueError("a joint angle is beyond the controller's range of pulses")
        return tuple(int(count) for count in pulses)


def speed_share(speed_rad_s: float, fastest_axis_rad_s: float) -> int:
    """Return the speed in hundredths of a per cent, rounded down, never 0.

    It is the share of each axis' own largest speed; by the fastest axis' speed no axis can exceed ``speed_rad_s``.
    """
    share = math.floor(100 * _PERCENT_STEPS * speed_rad_s / fastest_axis_rad_s)
    return max(1, min(100 * _PERCENT_STEPS, share))


def move_order(pulses: tuple[int, ...], share: int, tool_number: int) -> HsesRequest:
    """Return the order to move robot 1 to pulses, axis by axis (command 0x8B)."""
    axes = (*pulses, *(0,) * (8 - AXES))
    data = _ORDER.pack(_ROBOT, 0, _PERCENT_CLASS, share, *axes, tool_number, *(0,) * 9)
    return HsesRequest(0x8B, _LINK_MOVE, 1, 0x02, data, repeatable=False)


def hold_order(*, on: bool) -> HsesRequest:
    """Return the order to hold the robot, or to release the hold of an earlier order (command 0x83)."""
    return HsesRequest(0x83, 1, 1, 0x10, struct.pack("<I", 1 if on else 2))
