"""A cell with known errors that devices of every kind look at; plain numpy, nothing of the fit in it."""

from dataclasses import dataclass, field

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.cells.contact_observations import (
    BarLengths,
    GuidedLengthObservations,
    PinTouches,
    PlaneContacts,
    SphereContacts,
)
from cellcal.calibration.geometry import exp_rotation, exp_twist, homogeneous_matrix, inverse_transform
from cellcal.calibration.identification.observations import (
    LengthObservations,
    PointObservations,
    PoseObservations,
)
from tests.unit.helpers.simulated_arm import dh_errors, random_joints

TOOL = homogeneous_matrix(exp_rotation(np.array([0.3, -0.2, 0.4])), np.array([0.05, -0.04, 0.12]))
TRACKER = exp_twist(np.array([2.5, -1.8, 0.3, 0.2, -0.4, 1.1]))  # in the world
REFLECTORS = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.02], [0.0, 0.12, 0.0]])


@dataclass(eq=False)
class SimulatedWorld:
    """One arm at its place in the world; rows are drawn from its own dice."""

    robot: str = "ur10"
    seed: int = 1
    base: np.ndarray = field(default_factory=lambda: np.eye(4))
    tool: np.ndarray = field(default_factory=lambda: TOOL)
    sigma_m: float = 5e-5
    exact: bool = False  # no noise
    perfect: bool = False  # no errors of the arm

    def __post_init__(self):
        self.rng = np.random.default_rng(self.seed)
        self.model: RobotModel = load_model(self.robot)
        errors = dh_errors(self.model, self.rng)
        self.real = self.model if self.perfect else self.model.with_dh_errors(errors)
        self.errors = np.zeros_like(errors) if self.perfect else errors

    def draw_joints(self, count, reach=2.0):
        return random_joints(self.model, self.rng, count, reach=reach)

    def flange_frames(self, joints, offset=(0.0, 0.0, 0.0)):
        there = self.base @ self.real.base_flange(joints) @ self.tool
        return there @ homogeneous_matrix(np.eye(3), np.asarray(offset, dtype=float))

    def tip_positions(self, joints, offset=(0.0, 0.0, 0.0)):
        return self.flange_frames(joints, offset)[:, :3, 3]

    def draw_noise(self, *shape):
        return np.zeros(shape) if self.exact else self.sigma_m * self.rng.standard_normal(shape)

    def stated_sigmas(self, joints):
        return np.full(len(joints), self.sigma_m), np.zeros(len(joints), dtype=np.intp)

    def point_rows(self, count=60, device=TRACKER, offset=(0.0, 0.0, 0.0), joints=None):
        joints = self.draw_joints(count) if joints is None else joints
        device_frames = inverse_transform(device) @ self.flange_frames(joints, offset)
        return PointObservations(
            joints, device_frames[:, :3, 3] + self.draw_noise(len(joints), 3), *self.stated_sigmas(joints)
        )

    def pose_rows(self, count=40, device=TRACKER, sigma_rad=1e-4):
        joints = self.draw_joints(count)
        device_frames = inverse_transform(device) @ self.flange_frames(joints)
        turns = np.zeros((count, 3)) if self.exact else sigma_rad * self.rng.standard_normal((count, 3))
        rotations = exp_rotation(turns) @ device_frames[:, :3, :3]
        sigma, once = self.stated_sigmas(joints)
        return PoseObservations(
            joints,
            device_frames[:, :3, 3] + self.draw_noise(count, 3),
            sigma,
            once,
            rotations,
            np.full(count, sigma_rad),
        )

    def length_rows(self, anchor, count=60, zero=0.0, scale=1.0, offset=(0.0, 0.0, 0.0)):
        joints = self.draw_joints(count)
        free = np.linalg.norm(self.tip_positions(joints, offset) - anchor, axis=1)
        return LengthObservations(
            joints, zero + scale * free + self.draw_noise(count), *self.stated_sigmas(joints)
        )

    def guided_lengths(self, exit_frame, radius, count=60):
        """The wire is bent round the lip step by step: no formula of the fit."""
        joints = self.draw_joints(count)
        tips = (inverse_transform(exit_frame) @ homogeneous_matrix(np.eye(3), self.tip_positions(joints)))[
            :, :3, 3
        ]
        lengths = np.array([shortest_wire(np.hypot(x, y), z, radius) for x, y, z in tips])
        return GuidedLengthObservations(joints, lengths + self.draw_noise(count), *self.stated_sigmas(joints))

    def touch_joints(self, residuals_of, steer, joints):
        """Return joints near ``draw_joints`` at which ``wanted(tips) == 0`` (N, c), by Newton along the real arm."""
        joints = joints.copy()
        for _ in range(40):
            miss = residuals_of(self.tip_positions(joints))
            slopes = np.stack(
                [
                    (
                        residuals_of(self.tip_positions(joints + 1e-6 * axis))
                        - residuals_of(self.tip_positions(joints - 1e-6 * axis))
                    )
                    / 2e-6
                    for axis in np.eye(joints.shape[1])
                ],
                axis=2,
            )
            step = np.linalg.pinv(slopes, rcond=1e-3) @ miss[..., None]
            joints -= steer * np.clip(step[..., 0], -0.3, 0.3)
        good = np.abs(residuals_of(self.tip_positions(joints))).max(axis=1) < 1e-9
        assert good.sum() > 0.5 * len(joints)
        return joints[good]

    def at_plane(self, frame, count=40, height=0.0):
        def plane_misses(tips):
            return (tips - frame[:3, 3]) @ frame[:3, 2:3] - height

        joints = self.touch_joints(plane_misses, 1.0, self.draw_joints(2 * count))[:count]
        sigma, once = self.stated_sigmas(joints)
        heights = np.full(len(joints), height) + self.draw_noise(len(joints))
        return PlaneContacts(joints, heights, sigma, once)

    def at_sphere(self, centre, radius, count=40):
        def sphere_misses(tips):
            return np.linalg.norm(tips - centre, axis=1)[:, None] - radius

        joints = self.touch_joints(sphere_misses, 1.0, self.draw_joints(2 * count))[:count]
        sigma, once = self.stated_sigmas(joints)
        return SphereContacts(joints, radius + self.draw_noise(len(joints)), sigma, once)

    def at_pin(self, pin, count=12):
        joints = self.touch_joints(lambda tips: tips - pin, 1.0, self.draw_joints(4 * count))[:count]
        sigma, once = self.stated_sigmas(joints)
        # The tip misses the pin a little: the same as a pin that is off.
        return PinTouches(joints, self.draw_noise(len(joints), 3), sigma, once)

    def bar_rows(self, length=None, count=60):
        first, second = self.draw_joints(count), self.draw_joints(count)
        apart = np.linalg.norm(self.tip_positions(first) - self.tip_positions(second), axis=1)
        if length is not None:
            apart = np.full(count, length)
        return BarLengths(first, apart + self.draw_noise(count), *self.stated_sigmas(first), second)


def shortest_wire(across, height, radius):
    """Return the length of wire from the touching point at the axis over a round lip to a point, by search."""
    turns = np.linspace(0.0, np.pi * 0.95, 20001)
    x, y = radius * (1 - np.cos(turns)), radius * np.sin(turns)
    way_x, way_y = across - x, height - y
    # Where it leaves, the way on is tangent: its cross product with the direction of the lip vanishes.
    off = way_x * np.cos(turns) - way_y * np.sin(turns)
    at = int(np.argmax(off <= 0)) if (off <= 0).any() else len(turns) - 1
    if at == 0:
        return float(np.hypot(across, height))
    share = off[at - 1] / (off[at - 1] - off[at])
    turn = turns[at - 1] + share * (turns[at] - turns[at - 1])
    leave = radius * (1 - np.cos(turn)), radius * np.sin(turn)
    return float(radius * turn + np.hypot(across - leave[0], height - leave[1]))
