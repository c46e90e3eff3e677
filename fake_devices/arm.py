"""A real arm: what stands between a motor that turns and a flange that moves.

Imitates
    The mechanics of a six-axis industrial robot.
Source
    calibration practice: Cheng (2008) on joint offsets and link errors; Nubiola and Bonev (2013) on joint
    compliance; data sheets of reduction gears on lost motion (under 1 arc minute) and transmission error.
Modelled
    Geometry errors of this one arm (theta, d, a, alpha, and beta of parallel axes), joint compliance under
    gravity, backlash (unloaded axes lag behind the approach direction, loaded axes lie on the flank gravity
    chooses), two harmonics of every gear, a small residue after each move that settles, less after a slow one.
Not modelled
    Thermal growth, link bending, vibration, the pull of the measuring wire, payload changes.

``joints_rad`` is the motor side: what a perfect encoder with perfect mastering would say. The flange follows
with the errors above. Positions are closed formulas of the clock's time: nothing has to be stepped at rest.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from cellcal.fake_devices.arm_models import MODELS, ArmModel
from cellcal.fake_devices.clock import WorldClock
from cellcal.fake_devices.kinematics import Array, flange_poses, link_frames
from cellcal.fake_devices.motion import ArmMotion, RescaledMotion, SpeedChange, Standstill, TrapezoidMotion

GRAVITY_M_S2 = 9.81
_SETTLE_TIME_S = 0.08
_SHAKING_RAD_S = 0.02  # a motion slower than that leaves less of a residue
_LOADED_NM = 3.0
_GRAVITY_AXES = (1, 2, 4)


def make_generator(seed: int, *labels: str) -> np.random.Generator:
    """Return a generator of its own for every named purpose, so that new draws never shift old ones."""
    return np.random.default_rng([seed, *(zlib.crc32(label.encode()) for label in labels)])


@dataclass(frozen=True)
class ArmDeviations:
    """The deviations of this arm from the maker's drawing."""

    dh_errors: Array  # (n, 5)
    compliance_rad_nm: Array  # (n,)
    backlash_rad: Array  # (n,) full width
    ripple_rad: Array  # (n, 2) amplitudes
    ripple_per_turn: Array  # (2,) periods per joint turn
    ripple_phase_rad: Array  # (n, 2)
    residue_rad: float  # size of what is left right after a move

    @classmethod
    def no_deviations(cls, model: ArmModel) -> Self:
        """Describe a perfect arm, for tests of the arithmetic."""
        n = len(model.dh)
        zero = np.zeros
        return cls(zero((n, 5)), zero(n), zero(n), zero((n, 2)), np.array([13.0, 80.0]), zero((n, 2)), 0.0)

    @classmethod
    def draw_deviations(cls, model: ArmModel, rng: np.random.Generator) -> Self:
        """Describe an arm as it leaves the factory."""
        n = len(model.dh)
        errors = rng.normal(size=(n, 5)) * np.array([3.5e-4, 3.5e-4, 3.5e-4, 3.5e-4, 0.0])
        for (
            row
        ) in model.parallel_axes:  # d of a parallel axis cannot be told from the next one's; its tilt can
            errors[row, 1], errors[row, 4] = 0.0, rng.normal() * 3.5e-4
        return cls(
            dh_errors=errors,
            compliance_rad_nm=rng.uniform(0.7, 1.3, n) / np.array(model.stiffness_nm_rad),
            backlash_rad=rng.uniform(0.3, 1.0, n) * 2.4e-4,
            ripple_rad=rng.uniform(0.3, 1.0, (n, 2)) * np.array([5.0e-5, 2.5e-5]),
            ripple_per_turn=np.array([13.0, 80.0]),
            ripple_phase_rad=rng.uniform(0.0, 2.0 * np.pi, (n, 2)),
            residue_rad=1.5e-4,
        )


class SimulatedArm:
    """One arm of the world. Angles are controller-style joints, in rad, unless a name says otherwise."""

    def __init__(
        self,
        name: str,
        model: ArmModel,
        hidden: ArmDeviations,
        clock: WorldClock,
        known_dh: Array | None = None,
    ) -> None:
        self.name, self.model, self.clock = name, model, clock
        self.hidden = hidden
        self.coupling = model.joint_coupling()
        self._base = np.array(model.base) if model.base else np.eye(4)
        self._flange = np.array(model.flange) if model.flange else np.eye(4)
        self.nominal_dh = model.dh_table()
        self.known_dh = self.nominal_dh if known_dh is None else known_dh
        self._base_dh = self.known_dh
        self.lower_rad, self.upper_rad = np.radians(model.lower_deg), np.radians(model.upper_deg)
        self.max_speed_rad_s = np.radians(model.max_speed_deg_s)
        self.convert_to_shown: Callable[[Array], Array] = lambda joints: joints.copy()
        start = np.radians(model.park_deg)
        self._motion: ArmMotion = Standstill(start, clock.now_s())
        self._lag, self._lag_at = np.zeros(len(start)), start
        self._direction = np.zeros(len(start))
        self._vibration = 0.0
        self._loaded = np.isin(np.arange(len(start)), _GRAVITY_AXES)
        self._factory = hidden
        self._commanded: tuple[float, Array, Array] | None = None
        self._stood: tuple[ArmDeviations, Array, Array] | None = (
            None  # where it was last seen: it is asked often
        )

    @classmethod
    def from_model(
        cls,
        model_name: str | ArmModel,
        seed: int,
        hidden: bool = True,
        *,
        name: str = "arm",
        clock: WorldClock | None = None,
    ) -> Self:
        """Build an arm by its model, or the model's name, its hidden errors drawn from the seed.

        A Universal Robots arm has large factory deltas which its controller knows but for a small rest
        (``known_dh``); a FANUC's controller knows the drawing only.
        """
        model = MODELS[model_name] if isinstance(model_name, str) else model_name
        rng = make_generator(seed, name, "arm")
        drawn = ArmDeviations.draw_deviations(model, rng) if hidden else ArmDeviations.no_deviations(model)
        frozen_deviations = None
        if hidden and model.gears is None:
            frozen_deviations = model.dh_table() + 1.5 * drawn.dh_errors
            drawn = replace(drawn, dh_errors=rng.normal(size=drawn.dh_errors.shape) * 6e-5)
        return cls(name, model, drawn, clock or WorldClock(), frozen_deviations)

    # what is

    @property
    def true_dh(self) -> Array:
        """True geometry, (n, 5): theta, d, a, alpha, beta."""
        return np.asarray(self._base_dh + self.hidden.dh_errors)

    @property
    def joints_rad(self) -> Array:
        """True joints on the motor side now."""
        return self._motion.position_at(self.clock.now_s())

    @property
    def controller_joints_rad(self) -> Array:
        """The joints that the controller assumes, from encoders and mastering; the truth where these are absolute."""
        return self.convert_to_shown(self.joints_rad)

    @property
    def joint_velocity(self) -> Array:
        """Joint velocity now [rad/s]."""
        return self._motion.velocity_at(self.clock.now_s())

    @property
    def is_moving(self) -> bool:
        """Whether the set point still travels. A followed set point travels until it is held for 20 ms."""
        now = self.clock.now_s()
        if self._commanded is not None:
            return bool(np.abs(self._commanded[2]).max() > 1e-9) and now - self._commanded[0] < 0.02
        return now < self._motion.end_s

    @property
    def settled_at_s(self) -> float:
        """World time at which the present motion ends; infinite for a speed without an end."""
        return self._motion.end_s

    def base_flange(self) -> Array:
        """Return the true flange pose (4, 4) now, with backlash and what has not settled yet."""
        now = self.clock.now_s()
        joints = self._motion.position_at(now)
        lag = self._lag_at_joints(joints)
        rest = 0.0 if self._commanded else self.hidden.residue_rad * self._ringing_at(now)
        posture = joints + lag + rest
        if self._stood is None or self._stood[0] is not self.hidden or (self._stood[1] != posture).any():
            self._stood = (self.hidden, posture, np.asarray(self.flange_at(posture)[0]))
        return self._stood[2].copy()

    def flange_at(self, joints_rad: ArrayLike, *, as_delivered: bool = False) -> Array:
        """Return true flange poses (N, 4, 4) at motor-side joints, backlash excluded."""
        hidden = self._factory if as_delivered else self.hidden
        dh = self._base_dh + hidden.dh_errors
        angles = self._link_angles(np.atleast_2d(np.asarray(joints_rad, dtype=float)), dh)
        return np.asarray(self._base @ flange_poses(dh, angles) @ self._flange)

    def believed_flange(self, joints_rad: ArrayLike) -> Array:
        """Return the flange poses (N, 4, 4) that the controller computes with the geometry it knows."""
        joints = np.atleast_2d(np.asarray(joints_rad, dtype=float))
        return np.asarray(self._base @ flange_poses(self.known_dh, joints @ self.coupling.T) @ self._flange)

    # what moves it

    def start_move(self, target_rad: ArrayLike, speed: float, acceleration: float) -> None:
        """Begin a point-to-point move; the axis with the longest way runs at ``speed`` [rad/s]."""
        self._begin_motion(
            TrapezoidMotion(self.joints_rad, np.asarray(target_rad), speed, acceleration, self.clock.now_s())
        )

    def change_pace(self, pace: float) -> None:
        """Let the motion that is under way go on so many times as fast."""
        now = self.clock.now_s()
        if self._commanded is None and now < self._motion.end_s < np.inf:
            self._begin_motion(RescaledMotion(self._motion, pace, now))

    def stop(self, deceleration: float, at_s: float | None = None) -> None:
        """Brake to standstill; ``at_s`` dates it back, for a controller whose watchdog is looked at late."""
        when = self.clock.now_s() if at_s is None else at_s
        if self._commanded is None and when >= self._motion.end_s:
            return
        position, velocity = self._motion.position_at(when), self._motion.velocity_at(when)
        self._begin_motion(SpeedChange(position, velocity, np.zeros_like(velocity), deceleration, when), when)

    def follow_set_point(self, joints_rad: ArrayLike) -> None:
        """Follow a set point streamed by a controller that plans by itself."""
        now, joints = self.clock.now_s(), np.array(joints_rad, dtype=float)
        before = self._commanded
        passed = now - before[0] if before is not None else 0.0
        velocity = (
            (joints - before[1]) / passed if before is not None and passed > 1e-6 else np.zeros_like(joints)
        )
        self._begin_motion(_FollowedMotion(joints, velocity, now), now)
        self._commanded = (now, joints, velocity)

    def put_joints(self, joints_rad: ArrayLike) -> None:
        """Put the arm somewhere by other means than its motors: a person, gravity, a released brake."""
        self._begin_motion(Standstill(np.asarray(joints_rad, dtype=float), self.clock.now_s()))

    def update_backlash(self, dt_s: float = 0.0) -> None:
        """Fold the path so far into the backlash, for controllers with a cycle; needs no regularity."""
        joints = self._motion.position_at(self.clock.now_s())
        self._lag = self._lag_at_joints(joints)
        self._lag_at = joints

    def bend_links(self, dh_changes: Array) -> None:
        """Deform the links for good, as a crash does."""
        self.hidden = replace(self.hidden, dh_errors=self.hidden.dh_errors + dh_changes)

    # inside

    def _begin_motion(self, motion: ArmMotion, when_s: float | None = None) -> None:
        joints = self._motion.position_at(self.clock.now_s() if when_s is None else when_s)
        self._lag = self._lag_at_joints(joints)
        self._lag_at = joints
        self._motion, self._commanded = motion, None
        ahead_s = motion.end_s if np.isfinite(motion.end_s) else self.clock.now_s() + 1.0
        self._direction = np.sign(motion.position_at(ahead_s) - joints)
        begin_s = self.clock.now_s() if when_s is None else when_s
        speeds = [np.abs(motion.velocity_at(at_s)).max() for at_s in (begin_s, (begin_s + ahead_s) / 2.0)]
        self._vibration = min(1.0, float(max(speeds)) / _SHAKING_RAD_S)

    def _lag_at_joints(self, joints: Array) -> Array:
        """Return how far the joint side lags: a play of the backlash's width, exact on monotone paths."""
        half = self.hidden.backlash_rad / 2.0
        lag = np.clip(self._lag - (joints - self._lag_at), -half, half)
        return np.where(self._loaded, 0.0, lag)

    def _ringing_at(self, now: float) -> Array:
        gone = max(now - self._motion.end_s, 0.0) if np.isfinite(self._motion.end_s) else 0.0
        return np.asarray(
            self._vibration * self._direction * np.exp(-gone / _SETTLE_TIME_S) * np.cos(60.0 * gone)
        )

    def _link_angles(self, joints: Array, dh: Array) -> Array:
        """Return the links' axis angles (N, n) for motor-side joints: ripple, flank, compliance added."""
        hidden = self.hidden
        phase = joints[:, :, None] * hidden.ripple_per_turn + hidden.ripple_phase_rad
        real = joints + np.sum(hidden.ripple_rad * np.sin(phase), axis=2)
        angles = real @ self.coupling.T
        torque = self._gravity_nm(angles, dh)
        flank = np.where(self._loaded, np.tanh(torque / _LOADED_NM) * hidden.backlash_rad / 2.0, 0.0)
        return np.asarray(angles + torque * hidden.compliance_rad_nm + flank)

    def _gravity_nm(self, angles: Array, dh: Array) -> Array:
        """Return the torque of gravity about every axis, (N, n)."""
        frames = link_frames(dh, angles, self._base)
        torque = np.zeros_like(angles)
        for mass in self.model.masses:
            place = frames[:, mass.link, :3, 3] + frames[:, mass.link, :3, :3] @ np.array(mass.at_m)
            for axis in range(mass.link):
                arm = place - frames[:, axis, :3, 3]
                turn = frames[:, axis, :3, 2]
                rise = turn[:, 0] * arm[:, 1] - turn[:, 1] * arm[:, 0]
                torque[:, axis] -= mass.kg * GRAVITY_M_S2 * rise
        return torque


class _FollowedMotion:
    """A streamed set point: position as last commanded."""

    def __init__(self, joints: Array, velocity: Array, now: float) -> None:
        self._joints, self._velocity, self.end_s = joints, velocity, now

    def position_at(self, world_s: float) -> Array:
        return self._joints.copy()

    def velocity_at(self, world_s: float) -> Array:
        return self._velocity.copy() if world_s - self.end_s < 0.02 else np.zeros_like(self._velocity)
