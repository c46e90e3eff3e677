"""Motions of all axes together, as functions of world time.

Imitates
    The set-point generator of a robot controller.
Source
    Trapezoidal point-to-point motion, every axis ending together, as in any controller's joint move.
Modelled
    Standstill, synchronised trapezoids at a pace that may change (at once, without a ramp), braking to standstill,
    speeding up to a constant joint speed.
Not modelled
    Jerk limits, path blending. Motions are closed formulas, so a clock that leaps costs nothing.
"""

from typing import Protocol

import numpy as np

from cellcal.fake_devices.kinematics import Array


class ArmMotion(Protocol):
    """The set point as a function of the world's time; monotone in every axis."""

    end_s: float

    def position_at(self, world_s: float) -> Array: ...
    def velocity_at(self, world_s: float) -> Array: ...


class Standstill:
    """Nothing moves."""

    def __init__(self, joints_rad: Array, since_s: float) -> None:
        self._joints = np.array(joints_rad, dtype=float)
        self.end_s = since_s

    def position_at(self, world_s: float) -> Array:
        return self._joints.copy()

    def velocity_at(self, world_s: float) -> Array:
        return np.zeros_like(self._joints)


class TrapezoidMotion:
    """From standstill to a target; the axis with the longest way runs at ``speed_rad_s``."""

    def __init__(
        self, start: Array, target: Array, speed_rad_s: float, acceleration_rad_s2: float, begin_s: float
    ) -> None:
        self._start = np.array(start, dtype=float)
        self._way = np.asarray(target, dtype=float) - self._start
        longest = float(np.abs(self._way).max())
        self._longest = max(longest, 1e-15)
        self._acceleration = acceleration_rad_s2
        self._speed = min(speed_rad_s, float(np.sqrt(longest * acceleration_rad_s2)))
        self._ramp_s = self._speed / acceleration_rad_s2
        cruise_s = longest / self._speed - self._ramp_s if self._speed > 0.0 else 0.0
        self._begin_s = begin_s
        self._total_s = 2.0 * self._ramp_s + max(cruise_s, 0.0)
        self.end_s = begin_s + self._total_s

    def _distance_at(self, t: float) -> float:
        if t >= self._total_s:
            return self._longest
        if t < self._ramp_s:
            return 0.5 * self._acceleration * t * t
        remaining_s = self._total_s - t
        if remaining_s < self._ramp_s:
            return self._longest - 0.5 * self._acceleration * remaining_s * remaining_s
        return self._speed * (t - 0.5 * self._ramp_s)

    def position_at(self, world_s: float) -> Array:
        t = max(world_s - self._begin_s, 0.0)
        if t >= self._total_s:
            return np.asarray(self._start + self._way)
        return np.asarray(self._start + self._way * (self._distance_at(t) / self._longest))

    def velocity_at(self, world_s: float) -> Array:
        t = max(world_s - self._begin_s, 0.0)
        speed = min(self._acceleration * t, self._speed, self._acceleration * max(self._total_s - t, 0.0))
        return np.asarray(self._way * (speed / self._longest))


class SpeedChange:
    """From one joint velocity to another at constant acceleration, then on at that velocity."""

    def __init__(
        self,
        start: Array,
        velocity: Array,
        target_velocity: Array,
        acceleration_rad_s2: float,
        begin_s: float,
    ) -> None:
        self._start = np.array(start, dtype=float)
        self._from = np.array(velocity, dtype=float)
        self._to = np.array(target_velocity, dtype=float)
        self._begin_s = begin_s
        self._ramp_s = float(np.abs(self._to - self._from).max()) / acceleration_rad_s2
        self.end_s = begin_s + self._ramp_s if not self._to.any() else float("inf")

    def position_at(self, world_s: float) -> Array:
        t = max(world_s - self._begin_s, 0.0)
        ramp = min(t, self._ramp_s)
        mean = self._from + (self._to - self._from) * (ramp / self._ramp_s / 2.0 if self._ramp_s else 0.5)
        return np.asarray(self._start + mean * ramp + self._to * (t - ramp))

    def velocity_at(self, world_s: float) -> Array:
        t = max(world_s - self._begin_s, 0.0)
        if t >= self._ramp_s:
            return self._to.copy()
        return np.asarray(self._from + (self._to - self._from) * (t / self._ramp_s))


class RescaledMotion:
    """Another motion, which goes on faster or slower from a moment on."""

    def __init__(self, motion: ArmMotion, pace: float, from_s: float) -> None:
        self._motion, self._pace, self._from_s = motion, pace, from_s
        self.end_s = from_s + (motion.end_s - from_s) / pace

    def position_at(self, world_s: float) -> Array:
        return self._motion.position_at(self._motion_time(world_s))

    def velocity_at(self, world_s: float) -> Array:
        return np.asarray(self._pace * self._motion.velocity_at(self._motion_time(world_s)))

    def _motion_time(self, world_s: float) -> float:
        return self._from_s + (world_s - self._from_s) * self._pace
