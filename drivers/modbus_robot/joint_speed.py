"""Joint speed as a whole per cent of each axis' own speed limit, as a TP program states it: rounded down, never 0."""

import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.modbus_robot.register_client import RegisterClient

_LIMITS = "speed_limits"
_ROUNDING = 1e-9  # of a per cent: a whole number stays what it is


@dataclass(frozen=True, slots=True)
class SpeedShare:
    """The share of the speed limits, a whole per cent, and the speed of the fastest joint with it [rad/s]."""

    share: float
    speed_rad_s: float


async def read_speed_share(panel: RegisterClient, way_rad: Array, speed_rad_s: float) -> SpeedShare | None:
    """Return the share at which no joint is faster than a speed; None where the controller takes a speed.

    Raises
    ------
    RefusedError
        One per cent of the axes' speed limits is faster than that.
    """
    if _LIMITS not in panel.profile.registers:
        return None
    limits = np.array((await panel.read_registers(_LIMITS)).numbers_of(_LIMITS))
    if not (limits > 0).all():
        raise panel.refused_error("the controller states no speed limit of an axis ($JNTVELLIM).")
    longest_rad = float(np.abs(way_rad).max())
    if longest_rad == 0.0:
        return SpeedShare(0.01, speed_rad_s)
    at_limit_rad_s = longest_rad / float(np.max(np.abs(way_rad) / limits))
    percent = min(100, math.floor(100.0 * speed_rad_s / at_limit_rad_s + _ROUNDING))
    if percent < 1:
        raise panel.refused_error(
            make_message(
                "{speed_rad_s:.2f} deg/s is less than 1 % of the axes' speed limits, its slowest speed.",
                speed_rad_s=math.degrees(speed_rad_s),
            )
        )
    return SpeedShare(percent / 100.0, percent / 100.0 * at_limit_rad_s)
