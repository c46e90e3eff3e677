"""Tag paths of a real cell and of its simulation, with a truth that no procedure sees."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array, exp_twist
from cellcal.calibration.points.tag_points import TagPath, Triple

FIXTURE_BASE = exp_twist(np.array([1.2, -0.3, 0.4, 0.2, -0.1, 0.7]))  # the robot's base in the fixture
DEVICE_BASE = exp_twist(np.array([2.0, 0.5, 0.3, 0.1, 0.2, 1.9]))
TIP = np.array([0.01, -0.02, 0.15])
OFFSETS_DEG = (0.07, 0.16, -0.05, -0.26, 0.18, 0.09)


@dataclass(frozen=True)
class RobotTags:
    """What a robot thought and a device measured."""

    model: RobotModel
    robot: TagPath
    device: TagPath


def make_tag_path(source: str, positions_m: Array, **more: object) -> TagPath:
    """Return a path of these places (n, 3) [m]; its tags are called P1, P2 …"""
    names = tuple(f"P{k + 1}" for k in range(len(positions_m)))
    return TagPath(source, to_triples(positions_m), **({"names": names} | more))  # type: ignore[arg-type]


def to_triples(positions_m: Array) -> tuple[Triple, ...]:
    """Return rows as tuples."""
    return tuple((float(x), float(y), float(z)) for x, y, z in positions_m)


def two_paths(
    outer_inner: Array, count: int = 8, *, sigma_m: float = 1e-4, seed: int = 1
) -> tuple[TagPath, TagPath]:
    """Return the same tags in two frames."""
    random = np.random.default_rng(seed)
    inner = random.uniform(-0.5, 0.5, (count, 3))
    outer = (
        inner @ outer_inner[:3, :3].T + outer_inner[:3, 3] + random.normal(scale=sigma_m, size=inner.shape)
    )
    return make_tag_path("robot.csv", inner), make_tag_path("fixture.csv", outer)


def robot_tags(
    count: int = 30, *, sigma_m: float = 1e-4, seed: int = 1, name: str = "fanuc_m6ib"
) -> RobotTags:
    """Return the two paths of a robot whose zeros are off."""
    random, model = np.random.default_rng(seed), load_model(name)
    errors = np.zeros((6, 5))
    errors[:, 0] = np.radians(OFFSETS_DEG)
    joints = random.uniform(-1.2, 1.2, (count, 6))
    tips = model.with_dh_errors(errors).tip_positions(joints, TIP)
    measured_m = (
        tips @ DEVICE_BASE[:3, :3].T + DEVICE_BASE[:3, 3] + random.normal(scale=sigma_m, size=tips.shape)
    )
    controller_joints = tuple(tuple(float(q) for q in row) for row in joints)
    thought = make_tag_path("robot.csv", model.base_flange(joints)[:, :3, 3], joints_rad=controller_joints)
    return RobotTags(model, thought, make_tag_path("device.csv", measured_m))
