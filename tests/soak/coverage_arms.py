"""What simulated calibrations are made of: arms drawn from the priors, noise, postures at pins and planes, scores."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import (
    Array,
    exp_rotation,
    exp_twist,
    homogeneous_matrix,
    inverse_transform,
    log_transform,
)
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.identification.parameters import Priors

PRIORS = Priors()
SIGMA_M, SIGMA_RAD = 5e-5, 1e-4
TIP = np.array([0.06, -0.04, 0.12])
TOOL = homogeneous_matrix(np.eye(3), TIP)
TRACKER = exp_twist(np.array([1.8, -0.9, 0.3, 0.2, -0.4, 1.1]))
ANCHOR = np.array([0.9, -0.7, -0.4])
PINS = np.array([[0.45, 0.15, 0.15], [0.35, -0.25, 0.3], [0.3, 0.3, 0.45]])
CHECKED = 4  # postures at which the tip is predicted
_ROBOT = "abb_irb120"
_SPREAD = np.array([PRIORS.offset_rad, PRIORS.length_m, PRIORS.length_m, PRIORS.angle_rad, PRIORS.angle_rad])


@dataclass(frozen=True, eq=False)
class CalibrationScore:
    """Truth minus answer in standard deviations, and the factor that the interval has."""

    names: tuple[str, ...]
    parameters: Array  # (p,)
    tips: Array  # (CHECKED * 3,), or for every arm
    factor: float


Calibration = Callable[[np.random.Generator, bool], CalibrationScore]


@dataclass(frozen=True, eq=False)
class DrawnArm:
    """A real arm: the nominal one with errors as the priors expect them."""

    model: RobotModel
    real: RobotModel
    errors: Array

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "DrawnArm":
        model = load_model(_ROBOT)
        errors = rng.standard_normal((model.axis_count, 5)) * _SPREAD
        return cls(model, model.with_dh_errors(errors), errors)

    def draw_joints(self, rng: np.random.Generator, count: int) -> Array:
        low, high = np.maximum(self.model.lower_rad, -1.5), np.minimum(self.model.upper_rad, 1.5)
        return rng.uniform(low, high, (count, self.model.axis_count))

    def true_tips(self, joints: Array) -> Array:
        return self.real.tip_positions(joints, TIP)


@dataclass(frozen=True, eq=False)
class DrawnNoise:
    """Normal errors, and the sigmas that are stated for them."""

    rng: np.random.Generator
    misjudged: float  # true deviation over the stated one

    @classmethod
    def draw(cls, rng: np.random.Generator, found: bool) -> "DrawnNoise":
        """Return noise as it is stated, or, to be found, up to twice or half as large."""
        return cls(rng, float(np.exp(rng.uniform(-1, 1) * np.log(2))) if found else 1.0)

    def __call__(self, *shape: int, sigma: float = SIGMA_M) -> Array:
        return self.misjudged * sigma * self.rng.standard_normal(shape)

    def stated_rows(self, count: int) -> tuple[Array, Rows]:
        return np.full(count, SIGMA_M), np.zeros(count, dtype=np.intp)


def small_difference(answer: Array, truth: Array) -> Array:
    """Return the motion (6,) from the answer to the truth, in the answer's axes."""
    apart = log_transform(inverse_transform(answer) @ truth)
    apart[:3] = answer[:3, :3].T @ (truth[:3, 3] - answer[:3, 3])
    return apart


def shifted_pose(place_m: Array) -> Array:
    return homogeneous_matrix(np.eye(3), np.asarray(place_m, dtype=float))


def small_motion(rng: np.random.Generator) -> Array:
    return exp_twist(rng.standard_normal(6) * [0.01, 0.01, 0.01, 0.02, 0.02, 0.02])


def pick_rows(pool: Array, rng: np.random.Generator, count: int) -> Array:
    return pool[rng.choice(len(pool), count, replace=False)]


def plane_poses() -> tuple[Array, ...]:
    turns = ([0.05, -0.03, 0.0], [0.0, 1.4, 0.0], [1.5, 0.1, 0.0])
    spots = ([0.4, 0.0, 0.1], [0.5, 0.0, 0.3], [0.3, -0.3, 0.3])
    return tuple(
        homogeneous_matrix(exp_rotation(np.array(turn)), np.array(spot))
        for turn, spot in zip(turns, spots, strict=True)
    )


@cache
def at_pin(number: int, radius_m: float = 0.0) -> Array:
    """Return joints of the nominal arm with the tip at a pin, or all over a ball."""
    rng = np.random.default_rng(number)
    away = rng.standard_normal((600, 3))
    goals = PINS[number] + radius_m * away / np.linalg.norm(away, axis=1, keepdims=True)
    return _reach_joints(lambda tips: (tips - goals, np.tile(np.eye(3), (len(tips), 1, 1))), rng, len(goals))


@cache
def at_plane(number: int) -> Array:
    """Return joints of the nominal arm with the tip on a plane, within a hand's breadth or two of its origin."""
    place, rng = plane_poses()[number], np.random.default_rng(number)
    goals = rng.uniform(-0.2, 0.2, (600, 2))

    def plane_misses(tips: Array) -> tuple[Array, Array]:
        local = (tips - place[:3, 3]) @ place[:3, :3]
        local[:, :2] -= goals
        return local, np.tile(place[:3, :3].T, (len(tips), 1, 1))

    return _reach_joints(plane_misses, rng, len(goals))


def _reach_joints(
    missed: Callable[[Array], tuple[Array, Array]], rng: np.random.Generator, count: int
) -> Array:
    """Return joints at which nothing is missed, by damped Newton from random postures; those that arrive."""
    model = load_model(_ROBOT)
    joints = rng.uniform(-1.2, 1.2, (count, model.axis_count))
    for _ in range(60):
        tips, slopes = model.tip_jacobian(joints, TIP)
        miss, turned = missed(tips)
        slopes = turned @ slopes
        normal = slopes @ np.swapaxes(slopes, 1, 2) + 1e-4 * np.eye(3)
        step = np.swapaxes(slopes, 1, 2) @ np.linalg.solve(normal, miss[..., None])
        joints = joints - np.clip(step[..., 0], -0.2, 0.2)
    miss = missed(model.tip_positions(joints, TIP))[0]
    inside = ((joints > model.lower_rad) & (joints < model.upper_rad)).all(axis=1)
    return joints[inside & (np.abs(miss).max(axis=1) < 1e-4)]
