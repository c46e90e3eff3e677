"""How the controller moves its set point: one object per motion, advanced once per controller step.

Imitates
    movej, movel, servoj, speedj, speedl, stopj, stopl of URScript.
Source
    The maker's script manual.
Modelled
    Trapezoidal speed of the leading axis or of the tool, exact arrival, joint speed limits, straight lines.
Not modelled
    Jerk limits, blending between waypoints, the speed a motion had when a new one begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import exp, sqrt
from typing import Protocol

import numpy as np

from cellcal.fake_devices.universal_robots.frames import (
    Frame,
    Vector,
    frame_difference,
    move_frame,
    multiply_frames,
    origin_of,
)
from cellcal.fake_devices.universal_robots.kinematics import UrArmKinematics

_STILL = (0.0,) * 6
_STRIDE_M = 0.02  # a straight line is followed in steps of at most this, also when time runs fast


class NoSolutionError(Exception):
    """The arm cannot be where the program wants it."""


@dataclass
class SetPoint:
    """The joints that the controller wants at this moment."""

    joints_rad: Vector
    velocity_rad_s: Vector = _STILL

    def move_to(self, joints_rad: Vector, velocity_rad_s: Vector = _STILL) -> None:
        """Take a new place and speed."""
        self.joints_rad, self.velocity_rad_s = joints_rad, velocity_rad_s


class SetPointMotion(Protocol):
    """Something that moves the set point for a while."""

    def advance(self, point: SetPoint, dt_s: float) -> bool:
        """Move on by world seconds; return whether the motion has ended."""
        ...


@dataclass
class _DistanceProfile:
    """Distance along a path that starts and ends at rest."""

    length: float
    speed: float
    acceleration: float
    duration_s: float = field(init=False)
    _ramp_s: float = field(init=False)

    def __post_init__(self) -> None:
        acceleration, speed = max(self.acceleration, 1e-6), max(self.speed, 1e-9)
        if self.length <= speed * speed / acceleration:
            self._ramp_s = sqrt(max(self.length, 0.0) / acceleration)
            self.speed, self.duration_s = acceleration * self._ramp_s, 2.0 * self._ramp_s
        else:
            self.speed, self._ramp_s = speed, speed / acceleration
            self.duration_s = self._ramp_s + self.length / speed

    def distance_and_speed(self, t_s: float) -> tuple[float, float]:
        """Return distance and speed after a time."""
        if t_s >= self.duration_s:
            return self.length, 0.0
        left_s = self.duration_s - t_s
        if t_s < self._ramp_s:
            return 0.5 * self.speed * t_s * t_s / self._ramp_s, self.speed * t_s / self._ramp_s
        if left_s < self._ramp_s:
            return (
                self.length - 0.5 * self.speed * left_s * left_s / self._ramp_s,
                self.speed * left_s / self._ramp_s,
            )
        return self.speed * (t_s - 0.5 * self._ramp_s), self.speed


class JointMove:
    """movej: all joints arrive together, the one with the longest way runs at the given speed."""

    def __init__(
        self,
        start: Vector,
        end: Sequence[float],
        speed: float,
        acceleration: float,
        limits_rad_s: Sequence[float],
    ) -> None:
        self._start, self._end = start, tuple(end)
        self._way = tuple(e - s for s, e in zip(start, self._end, strict=True))
        longest = max(map(abs, self._way))
        allowed = min(
            (limit * longest / abs(way) for way, limit in zip(self._way, limits_rad_s, strict=True) if way),
            default=speed,
        )
        self._profile = _DistanceProfile(longest, min(speed, allowed), acceleration)
        self._t_s = 0.0

    def advance(self, point: SetPoint, dt_s: float) -> bool:
        self._t_s += dt_s
        if self._t_s >= self._profile.duration_s:
            point.move_to(self._end)
            return True
        travelled, speed = self._profile.distance_and_speed(self._t_s)
        part, rate = travelled / self._profile.length, speed / self._profile.length
        joints = tuple(s + part * w for s, w in zip(self._start, self._way, strict=True))
        point.move_to(joints, tuple(rate * w for w in self._way))
        return False


class LinearMove:
    """movel: the active TCP travels on a straight line and turns about one axis."""

    def __init__(
        self,
        arm: UrArmKinematics,
        line: tuple[Frame, Frame],
        tool_flange: Frame,
        speed: float,
        acceleration: float,
    ) -> None:
        self._arm, self._start, self._tool = arm, line[0], tool_flange
        self._by = frame_difference(*line)
        distance = sqrt(sum(value * value for value in self._by[:3]))
        angle = sqrt(sum(value * value for value in self._by[3:]))
        self._length = max(distance, angle * 0.2)  # a pure turn runs as if the tool were 0.2 m long
        self._profile = _DistanceProfile(self._length, speed, acceleration)
        self._t_s, self._part = 0.0, 0.0

    def advance(self, point: SetPoint, dt_s: float) -> bool:
        self._t_s += dt_s
        travelled, _ = self._profile.distance_and_speed(self._t_s)
        end = travelled / self._length if self._length > 0.0 else 1.0
        before = point.joints_rad
        strides = max(1, int((end - self._part) * self._length / _STRIDE_M) + 1)
        joints, first = before, self._part
        for k in range(1, strides + 1):
            part = first + (end - first) * k / strides
            goal = multiply_frames(move_frame(self._start, self._by, part), self._tool)
            found = self._arm.solve_nearby(goal, joints)
            if found is None:
                raise NoSolutionError
            joints = found
        self._part = end
        done = self._t_s >= self._profile.duration_s
        speed = _STILL if done or dt_s <= 0.0 else _rate_of(before, joints, dt_s)
        point.move_to(joints, speed)
        return done


class BrakeMove:
    """stopj, stopl: come to rest in a given time."""

    def __init__(self, duration_s: float) -> None:
        self._left_s = max(duration_s, 0.0)

    @classmethod
    def of_joints(cls, point: SetPoint, deceleration: float) -> "BrakeMove":
        """Brake with a joint deceleration [rad/s2]."""
        return cls(max(map(abs, point.velocity_rad_s)) / max(deceleration, 1e-3))

    def advance(self, point: SetPoint, dt_s: float) -> bool:
        if self._left_s <= dt_s:
            half = 0.5 * self._left_s
            point.move_to(_joints_along(point.joints_rad, point.velocity_rad_s, half))
            return True
        keep = 1.0 - dt_s / self._left_s
        after = tuple(keep * v for v in point.velocity_rad_s)
        mean = tuple(0.5 * (a + b) for a, b in zip(point.velocity_rad_s, after, strict=True))
        point.move_to(_joints_along(point.joints_rad, mean, dt_s), after)
        self._left_s -= dt_s
        return False


@dataclass
class JointSpeedMove:
    """speedj: joint velocities, approached with an acceleration, kept until stopped."""

    target_rad_s: Vector
    acceleration: float

    def advance(self, point: SetPoint, dt_s: float) -> bool:
        after = _approach_velocity(point.velocity_rad_s, self.target_rad_s, self.acceleration * dt_s)
        point.move_to(_joints_along(point.joints_rad, after, dt_s), after)
        return False


@dataclass
class ToolSpeedMove:
    """speedl: a tool velocity in base axes, kept until stopped."""

    arm: UrArmKinematics
    target: Vector
    acceleration: float
    flange_tool: Frame
    _now: Vector = _STILL

    def advance(self, point: SetPoint, dt_s: float) -> bool:
        self._now = _approach_velocity(self._now, self.target, self.acceleration * dt_s)
        tip = origin_of(multiply_frames(self.arm.base_flange(point.joints_rad), self.flange_tool))
        jacobian = self.arm.tip_jacobian(point.joints_rad, tip)
        damped = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-9 * np.eye(6), np.array(self._now))
        velocity = tuple(float(value) for value in damped)
        point.move_to(_joints_along(point.joints_rad, velocity, dt_s), velocity)
        return False


@dataclass
class ServoMove:
    """servoj: follow a target that the client keeps moving, smoothed by the lookahead time."""

    target_rad: Vector
    lookahead_s: float
    limits_rad_s: Sequence[float]

    def advance(self, point: SetPoint, dt_s: float) -> bool:
        if dt_s <= 0.0:
            return False
        part = 1.0 - exp(-dt_s / max(0.3 * self.lookahead_s, 1e-3))
        speeds = (part * (t - q) / dt_s for q, t in zip(point.joints_rad, self.target_rad, strict=True))
        velocity = tuple(max(-m, min(m, v)) for v, m in zip(speeds, self.limits_rad_s, strict=True))
        point.move_to(_joints_along(point.joints_rad, velocity, dt_s), velocity)
        return False


def _joints_along(joints: Sequence[float], velocity: Sequence[float], dt_s: float) -> Vector:
    return tuple(q + v * dt_s for q, v in zip(joints, velocity, strict=True))


def _rate_of(before: Sequence[float], after: Sequence[float], dt_s: float) -> Vector:
    return tuple((b - a) / dt_s for a, b in zip(before, after, strict=True))


def _approach_velocity(now: Sequence[float], target: Sequence[float], change: float) -> Vector:
    gap = max(abs(t - v) for v, t in zip(now, target, strict=True))
    part = 1.0 if gap <= change else change / gap
    return tuple(v + part * (t - v) for v, t in zip(now, target, strict=True))
