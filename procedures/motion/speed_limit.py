"""How fast an arm goes along a way: as fast as no part of it exceeds a cap, on that leg and not on every other."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.motion.motion_check import MotionLimits, check_moves
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.motion.approach import axis_by_axis, from_below

_MARGIN = 1.02  # a way is looked at in samples, and gone from where the arm really stands


@dataclass(frozen=True, slots=True)
class SpeedLimit:
    """The speed limit of every leg of a series; hashable, so that a leg is checked once."""

    model: str
    tip_in_flange_m: tuple[float, float, float]
    joint_speed_rad_s: float
    tip_speed_m_s: float  # of tip, flange and every joint's centre

    def leg_speeds(self, here_rad: Sequence[float], way_rad: Sequence[Sequence[float]]) -> tuple[float, ...]:
        """Return the speed of the fastest joint on the leg to each corner of a way [rad/s].

        Raises
        ------
        CalibrationError
            The corners are not of this arm's axes.
        """
        return _leg_speeds(self, tuple(here_rad), tuple(tuple(corner) for corner in way_rad))

    def jogging_s(self, here_rad: Joints, there_rad: Joints) -> float:
        """Return how long it takes to bring one joint after the other there, each to its end from below."""
        corners = axis_by_axis(np.array(here_rad), np.array(there_rad))
        turns = np.abs(np.diff(np.vstack([np.array(here_rad), corners]), axis=0)).max(axis=1)
        return float((turns / np.array(self.leg_speeds(here_rad, corners.tolist()))).sum())

    def time_ways(self, here_rad: Joints, ways_rad: Iterable[Sequence[Joints]]) -> "TimedMotion":
        """Return how long ways take that are gone one after the other, each to its end from below."""
        travel_rad = moving_s = fastest_rad_s = 0.0
        for way in ways_rad:
            corners = (*way[:-1], *from_below(way[-2] if len(way) > 1 else here_rad, way[-1]))
            turns = np.abs(np.diff(np.array([here_rad, *corners]), axis=0)).max(axis=1)
            speeds = np.array(self.leg_speeds(here_rad, corners))
            travel_rad += float(turns.sum())
            moving_s += float((turns / speeds).sum())
            fastest_rad_s = max(fastest_rad_s, float(speeds[turns > 0].max(initial=0.0)))
            here_rad = way[-1]
        return TimedMotion(travel_rad, moving_s, fastest_rad_s)


@dataclass(frozen=True, slots=True)
class TimedMotion:
    """Ways at their pace: the way of the slowest joint in all, the time, and the fastest that a joint turns."""

    travel_rad: float
    moving_s: float
    fastest_rad_s: float

    def __add__(self, other: "TimedMotion") -> "TimedMotion":
        fastest_rad_s = max(self.fastest_rad_s, other.fastest_rad_s)
        return TimedMotion(self.travel_rad + other.travel_rad, self.moving_s + other.moving_s, fastest_rad_s)

    def repeat_motion(self, count: int) -> "TimedMotion":
        """Return the same ways so many times."""
        return TimedMotion(
            count * self.travel_rad, count * self.moving_s, self.fastest_rad_s if count else 0.0
        )


@lru_cache(maxsize=8192)
def _leg_speeds(pace: SpeedLimit, here_rad: Joints, way_rad: tuple[Joints, ...]) -> tuple[float, ...]:
    model = load_model(pace.model)
    speed_rad_s = min(pace.joint_speed_rad_s, float(np.min(model.max_speed_rad_s)))
    limits = MotionLimits(joint_speed_rad_s=speed_rad_s, tip_speed_m_s=pace.tip_speed_m_s)
    verdict = check_moves(
        model, here_rad, np.array(way_rad), limits,
        speed_rad_s=speed_rad_s, tip_in_flange_m=pace.tip_in_flange_m,
    )  # fmt: skip
    return tuple(float(v) for v in speed_rad_s / verdict.times_too_fast(len(way_rad), _MARGIN))
