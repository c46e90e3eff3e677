"""The fake world's arm, wire and fixture without sockets, for the mathematics of alignments and for campaigns."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Pose, log_transform
from cellcal.calibration.mastering.pose_design import candidate_joints, kit_poses
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath
from cellcal.calibration.points.fixture import PlacedPoints, place_points
from cellcal.calibration.wires.design import best_order, with_poses
from cellcal.calibration.wires.model import WirePrior
from cellcal.calibration.wires.network import WireMounting, WireNetworkPrior, WirePlace
from cellcal.calibration.wires.network_fit import WireNetwork, fit_network
from cellcal.fake_devices.wire_gauge import WireGauge
from cellcal.fake_devices.world import World
from tests.unit.helpers.recovery_cases import DRIVE

MODEL = load_model("fanuc_m6ib")
ANCHOR, HOOK = (0.9, -0.7, -0.45), (0.06, 0.05, 0.12)
MOUTH = (0.75, 0.0, 0.55)
PRIOR = WirePrior(ANCHOR, HOOK)
READING_SIGMA_M, SAMPLES = 1e-4, 5
CAPTURE_SIGMA_M = READING_SIGMA_M / SAMPLES**0.5

POINTS = ((-0.35, -0.45, 0.0), (0.35, -0.45, 0.0), (-0.35, 0.45, 0.0), (0.35, 0.45, 0.25))
ROUGH = Pose((0.85, 0.0, -0.2))
TARGETS = ((0.0, 0.0, 0.0), (0.16, 0.0, -0.05), (0.0, 0.16, -0.05))
ROUGH_TOOL = Pose((0.0, 0.0, 0.2))
FAKE: dict[str, Any] = {
    "fixture": {
        "points_mm": [[1e3 * v for v in point] for point in POINTS],
        "seen_from": {"fanuc": [850.0, 0.0, -200.0, 0.0, 0.0, 0.0]},
    },
    "end_effector": {
        "targets_mm": [[1e3 * v for v in target] for target in TARGETS],
        "flange_tool": [0.0, 0.0, 200.0, 0.0, 0.0, 0.0],
    },
}


@dataclass
class FixtureWorld:
    """One robot, one wire, one fixture, one end-effector; everything hidden is drawn from the seed."""

    seed: int

    def __post_init__(self) -> None:
        self.world = World(self.seed, 0.0)
        self.world.add_fixtures(FAKE)
        self.arm = self.world.add_arm("fanuc", MODEL.name)
        self.gauge = WireGauge(self.world, {"name": "wire", "robot": "fanuc"})

    def measure_lengths(self, joints_rad: np.ndarray) -> np.ndarray:
        """Measure at these joints, each reached from below, as the mean of several readings."""
        lengths = []
        for joints in joints_rad:
            self.arm.put_joints(joints - 0.02)
            self.arm.put_joints(joints)
            self.world.clock.advance(1.0)  # it settles
            lengths.append(np.mean([self.gauge.read_m()[0] for _ in range(SAMPLES)]))
        return np.array(lengths)

    def true_fixture(self) -> np.ndarray:
        """Return the true pose of the fixture in the robot's own base."""
        return self.gauge.fixture_in_base()

    def true_tool(self) -> np.ndarray:
        """Return the true pose of the tool in the robot's own flange."""
        return self.gauge.tool_in_flange()


def wire_mounting(
    exit_: int, hook: int, joints: np.ndarray, lengths: np.ndarray, mouth=None, **more: Any
) -> WireMounting:
    """Put captures into the form of the mathematics."""
    poses = tuple(tuple(float(q) for q in pose) for pose in joints)
    values = tuple(float(v) for v in lengths)
    return WireMounting(exit_, hook, poses, values, (CAPTURE_SIGMA_M,) * len(poses), mouth, **more)


@cache
def record_poses() -> np.ndarray:
    """Return thirty poses of a mastering record."""
    limits = MotionLimits(
        joint_margin_rad=0.2,
        box_low_m=(-1.2, -1.2, -0.4),
        box_high_m=(1.5, 1.5, 1.6),
        wire=WirePath(ANCHOR, HOOK, 3.0, lowest_fraction=0.06),
    )
    return kit_poses(MODEL, DRIVE, PRIOR, limits, 30)


def candidate_poses(
    exit_m: tuple[float, float, float], hook_m: tuple[float, float, float], count: int, seed: int
) -> np.ndarray:
    """Return poses within the wire's reach and in front of its mouth."""
    limits = MotionLimits(
        joint_margin_rad=0.2,
        box_low_m=(-0.3, -1.3, -0.4),
        box_high_m=(1.6, 1.3, 1.6),
        wire=WirePath(exit_m, hook_m, 3.0, lowest_fraction=0.08, highest_fraction=0.6),
    )
    drawn = candidate_joints(MODEL, limits, 4 * count, seed=seed, hook_in_flange_m=hook_m)
    away = MODEL.tip_positions(drawn, np.array(hook_m)) - np.array(exit_m)
    ahead = np.array(MOUTH) - np.array(exit_m)
    cosine = away @ ahead / np.linalg.norm(away, axis=1) / np.linalg.norm(ahead)
    return drawn[cosine > np.cos(1.0)][:count]


def fixture_network_prior() -> WireNetworkPrior:
    """Return what a technician knows before the fixture is measured; the record's exit comes first."""
    exits = (
        WirePlace(ANCHOR, 0.010),
        *(WirePlace(_transform_point(ROUGH, point), 0.020) for point in POINTS),
    )
    return WireNetworkPrior.with_certified_scale(PRIOR, exits, (WirePlace(HOOK, 0.002),), 1e-4)


def tool_network_prior() -> WireNetworkPrior:
    """Return what a technician knows before the targets are measured; the record's hook comes first."""
    hooks = (
        WirePlace(HOOK, 0.002),
        *(WirePlace(_transform_point(ROUGH_TOOL, target), 0.010) for target in TARGETS),
    )
    return WireNetworkPrior.with_certified_scale(PRIOR, (WirePlace(ANCHOR, 0.010),), hooks, 1e-4)


def _transform_point(pose: Pose, point: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = pose.rotation_matrix() @ np.array(point) + np.array(pose.position_m)
    return (float(x), float(y), float(z))


def error_of(found: Pose, truth: np.ndarray) -> np.ndarray:
    """Return how far the truth is from a pose found, along and about its axes (x, y, z, rx, ry, rz)."""
    return log_transform(np.linalg.inv(found.to_matrix()) @ truth)


def stated_u(covariance: Any) -> np.ndarray:
    """Return U (k = 2) of every axis."""
    return 2.0 * np.sqrt(np.diag(np.array(covariance)))


@dataclass
class AlignmentOutcome:
    """One alignment, the truth, and the error with the stated U of every axis (x, y, z, rx, ry, rz)."""

    placed: PlacedPoints
    network: WireNetwork
    truth: np.ndarray

    @property
    def pose_error(self) -> np.ndarray:
        return error_of(self.placed.outer_inner, self.truth)

    @property
    def stated_u_of_axes(self) -> np.ndarray:
        return stated_u(self.placed.covariance)


@cache
def designed_poses(hooks: bool, per_spot: int = 20) -> tuple[np.ndarray, ...]:
    """Return the poses that tell most at every spot, before anything is measured; the record's come first."""
    network_prior = tool_network_prior() if hooks else fixture_network_prior()
    record_mountings = [wire_mounting(0, 0, record_poses(), np.ones(30), another_day=True)]
    chosen = [record_poses()]
    for spot in range(1, len(TARGETS if hooks else POINTS) + 1):
        exit_, hook = (0, spot) if hooks else (spot, 0)
        drawn = candidate_poses(network_prior.exits[exit_].at_m, network_prior.hooks[hook].at_m, 90, spot)
        pool = wire_mounting(exit_, hook, drawn, np.ones(len(drawn)), None if hooks else MOUTH)
        chosen.append(drawn[list(best_order(MODEL, network_prior, record_mountings, pool, per_spot))])
        record_mountings.append(with_poses(pool, chosen[-1], CAPTURE_SIGMA_M))
    return tuple(chosen)


def align_world(world: FixtureWorld, per_spot: int = 20) -> AlignmentOutcome:
    """Take a record, then measure every alignment point at the poses that tell most."""
    record, *spots = designed_poses(False, per_spot)
    mountings = [wire_mounting(0, 0, record, world.measure_lengths(record), another_day=True)]
    for point, poses in enumerate(spots, 1):
        world.gauge.mount_exit(point, MOUTH)
        mountings.append(wire_mounting(point, 0, poses, world.measure_lengths(poses), MOUTH))
    network = fit_network(MODEL, fixture_network_prior(), mountings)
    points = list(range(1, len(POINTS) + 1))
    found = [network.exits_m[k] for k in points]
    placed = place_points(POINTS, found, network.exit_covariance(points), sigma_point_m=2e-5)
    return AlignmentOutcome(placed, network, world.true_fixture())


def find_tool(world: FixtureWorld) -> tuple[np.ndarray, np.ndarray]:
    """Take a record, then measure every target of the end-effector; return error and U of every axis."""
    record, *spots = designed_poses(True, 12)
    mountings = [wire_mounting(0, 0, record, world.measure_lengths(record), another_day=True)]
    for target, poses in enumerate(spots, 1):
        world.gauge.hook_to(target)
        mountings.append(wire_mounting(0, target, poses, world.measure_lengths(poses)))
    network = fit_network(MODEL, tool_network_prior(), mountings)
    targets = list(range(1, len(TARGETS) + 1))
    found = [network.hooks_m[k] for k in targets]
    placed = place_points(TARGETS, found, network.hook_covariance(targets), sigma_point_m=2e-5)
    one = AlignmentOutcome(placed, network, world.true_tool())
    return one.pose_error, one.stated_u_of_axes
