"""Two arms before one fixture of the fake world, one wire carried from the one to the other."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.pose_design import kit_poses
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath
from cellcal.calibration.points.alignment import Alignment, WirePoints
from cellcal.calibration.points.fixture import place_points
from cellcal.calibration.wires.design import best_order, with_poses
from cellcal.calibration.wires.network import WireMounting, WireNetworkPrior, WirePlace
from cellcal.calibration.wires.network_fit import fit_network
from cellcal.fake_devices.wire_gauge import WireGauge
from cellcal.fake_devices.world import World
from tests.unit.helpers.fixture_world import (
    ANCHOR,
    HOOK,
    MODEL,
    MOUTH,
    POINTS,
    PRIOR,
    READING_SIGMA_M,
    candidate_poses,
)
from tests.unit.helpers.recovery_cases import DRIVE

TEN_POINTS = (
    *POINTS,
    *((0.0, -0.45, 0.3), (0.0, 0.45, 0.3), (-0.35, 0.0, 0.15), (0.35, 0.0, 0.15)),
    *((0.0, -0.45, 0.0), (0.0, 0.45, 0.0)),
)
ROUGH = {"left": Pose((0.85, 0.0, -0.2)), "right": Pose((0.85, 0.0, -0.2), (0.0, 0.0, 0.0, 1.0))}  # they face
HOME_MOUTH = (0.75, 0.0, 0.55)  # where the wire looks at home, as the cell file says
SEAT_SIGMA_M = 2e-5


@dataclass(frozen=True)
class MeasuringEffort:
    """How much is measured: alignment points, captures at each, poses of the record, readings of a capture."""

    points: tuple[tuple[float, float, float], ...] = POINTS
    per_spot: int = 26
    record: int = 30
    samples: int = 5
    sigma_scale: float = 1e-4

    @property
    def sigma_m(self) -> float:
        return READING_SIGMA_M / self.samples**0.5


DEFAULT = MeasuringEffort()
FOR_FIXTURES = MeasuringEffort(TEN_POINTS[:6])  # two points more than a plane and one beside it
FOR_BASES = MeasuringEffort(
    TEN_POINTS, per_spot=40, record=30, samples=20
)  # points tell more than captures do


@dataclass
class AlignedRobot:
    """One of the two arms with the wire before it."""

    world: World
    name: str
    effort: MeasuringEffort

    def __post_init__(self) -> None:
        self.arm = self.world.arms[self.name]
        self.gauge = WireGauge(self.world, {"name": "wire", "robot": self.name})  # of one name: one wire
        self.gauge.scale_error *= self.effort.sigma_scale / 1e-4

    def align_robot(self) -> Alignment:
        """Take a record, then measure every alignment point at the poses that tell most."""
        network_prior, (record, *spots) = (
            network_prior_of(self.name, self.effort),
            poses_of(self.name, self.effort),
        )
        mountings = [self._measure_mounting(0, record, mouth_at_m=HOME_MOUTH, another_day=True)]
        for point, poses in enumerate(spots, 1):
            self.gauge.mount_exit(point, MOUTH)
            mountings.append(self._measure_mounting(point, poses, mouth_at_m=MOUTH))
        network = fit_network(MODEL, network_prior, mountings)
        points = range(1, len(self.effort.points) + 1)
        found = tuple(network.exits_m[k] for k in points)
        covariance = network.exit_covariance(points)
        placed = place_points(self.effort.points, found, covariance, sigma_point_m=SEAT_SIGMA_M)
        wire_points = WirePoints(
            wire="wire",
            found_m=found,
            of_wire=(network.scale, network.exit_radius_m, *network.slow_m),
            covariance=tuple(
                tuple(float(v) for v in row) for row in network.exit_and_wire_covariance(points)
            ),
            believed=network_prior.wire_values(),
            sigma=network_prior.wire_sigmas(),
            sigma_seat_m=SEAT_SIGMA_M,
            sigma_drawing_m=0.0,
        )
        return Alignment(
            "table",
            self.name,
            MODEL.name,
            self.effort.points,
            placed.outer_inner,
            placed.covariance,
            (),
            wire_points,
        )

    def true_fixture(self) -> np.ndarray:
        """Return the true fixture in the robot's own base."""
        fixture = self.gauge.fixture_in_base()
        assert fixture is not None
        return fixture

    def _measure_mounting(self, exit_: int, joints: np.ndarray, **more: Any) -> WireMounting:
        lengths = []
        for pose in joints:
            self.arm.put_joints(pose - 0.02)
            self.arm.put_joints(pose)
            self.world.clock.advance(1.0)  # it settles
            lengths.append(float(np.mean([self.gauge.read_m()[0] for _ in range(self.effort.samples)])))
        return _make_mounting(exit_, joints, tuple(lengths), self.effort, **more)


def two_robots(seed: int, effort: MeasuringEffort = DEFAULT) -> tuple[AlignedRobot, AlignedRobot]:
    """Return two robots of one world; everything hidden is drawn from the seed."""
    world = World(seed, 0.0)
    fixture_poses = {
        "left": [850.0, 0.0, -200.0, 0.0, 0.0, 0.0],
        "right": [850.0, 0.0, -200.0, 0.0, 0.0, 180.0],
    }
    world.add_fixtures(
        {"fixture": {"points_mm": [[1e3 * v for v in p] for p in effort.points], "seen_from": fixture_poses}}
    )
    for name in fixture_poses:
        world.add_arm(name, MODEL.name)
    return AlignedRobot(world, "left", effort), AlignedRobot(world, "right", effort)


@cache
def network_prior_of(name: str, effort: MeasuringEffort) -> WireNetworkPrior:
    """Return what a technician knows before the fixture is measured; the record's exit comes first."""
    rough = ROUGH[name]
    at = [rough.rotation_matrix() @ np.array(p) + np.array(rough.position_m) for p in effort.points]
    exits = (WirePlace(ANCHOR, 0.010), *(WirePlace((float(x), float(y), float(z)), 0.020) for x, y, z in at))
    return WireNetworkPrior.with_certified_scale(PRIOR, exits, (WirePlace(HOOK, 0.002),), effort.sigma_scale)


@cache
def poses_of(name: str, effort: MeasuringEffort) -> tuple[np.ndarray, ...]:
    """Return the poses that tell most at every spot, before anything is measured; the record's come first."""
    network_prior, record = network_prior_of(name, effort), _record_poses(effort.record)
    record_mountings = [
        _make_mounting(0, record, (1.0,) * len(record), effort, mouth_at_m=HOME_MOUTH, another_day=True)
    ]
    chosen = [record]
    for spot in range(1, len(effort.points) + 1):
        drawn = candidate_poses(network_prior.exits[spot].at_m, HOOK, 90, spot)
        pool = _make_mounting(spot, drawn, (1.0,) * len(drawn), effort, mouth_at_m=MOUTH)
        chosen.append(drawn[list(best_order(MODEL, network_prior, record_mountings, pool, effort.per_spot))])
        record_mountings.append(with_poses(pool, chosen[-1], effort.sigma_m))
    return tuple(chosen)


@cache
def _record_poses(count: int) -> np.ndarray:
    limits = MotionLimits(
        joint_margin_rad=0.2,
        box_low_m=(-1.2, -1.2, -0.4),
        box_high_m=(1.5, 1.5, 1.6),
        wire=WirePath(ANCHOR, HOOK, 3.0, lowest_fraction=0.06),
    )
    return kit_poses(MODEL, DRIVE, PRIOR, limits, count)


def _make_mounting(
    exit_: int, joints: np.ndarray, lengths: tuple[float, ...], effort: MeasuringEffort, **more: Any
) -> WireMounting:
    poses = tuple(tuple(float(q) for q in pose) for pose in joints)
    return WireMounting(exit_, 0, poses, lengths, (effort.sigma_m,) * len(poses), **more)
