"""Campaigns over alignments: arm, wire, fixture and end-effector of the fake world with all that they hide."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from rich.console import Console
from rich.progress import track

from cellcal.calibration.points.alignment import Alignment
from cellcal.calibration.points.fixture import BaseToBase, base_through_fixture, worst_expanded_u
from cellcal.calibration.points.joint_bases import bases_together
from tests.soak.campaign_figures import CampaignFigures
from tests.unit.helpers.fixture_world import FixtureWorld, error_of, find_tool, stated_u
from tests.unit.helpers.two_robots import DEFAULT, FOR_BASES, FOR_FIXTURES, MeasuringEffort, two_robots

MOST_ORIGIN_M, MOST_ANGLE_RAD = 0.00015, np.radians(0.02)


def fixture(seeds: int) -> CampaignFigures:
    """Fixtures, and bases chained through them: U (k = 2) within 0.15 mm and 0.02 deg, and true per axis."""
    lines, reached = [], True
    for name, effort, limited in (("four points", DEFAULT, False), ("six points", FOR_FIXTURES, True)):
        fixtures_found = [_find_fixture(seed, effort) for seed in _seed_range(f"fixtures, {name}", seeds)]
        fixtures = np.array([(one.pose_error, one.stated_u_of_axes) for one in fixtures_found])
        between = np.array(list(_chain_bases(fixtures_found)))
        covered, chained = _covered_share(fixtures), _covered_share(between)
        within = np.mean(
            [one.origin_u_m <= MOST_ORIGIN_M and one.angle_u_rad <= MOST_ANGLE_RAD for one in fixtures_found]
        )
        lines.append(
            f"{name}: U stated {np.median([one.origin_u_m for one in fixtures_found]) * 1e3:.3f} "
            f"mm, within 0.15 mm and "
            f"0.02 deg in {within:.1%}; inside U per axis {covered:.1%}, bases chained {chained:.1%} (at least "
            f"93.5 %); error of the origin {_describe_runs(fixtures)}, of a base {_describe_runs(between)}"
        )
        reached = reached and covered >= 0.935 and chained >= 0.935 and (within >= 0.95 or not limited)
    return CampaignFigures(f"fixture of {seeds}: {'; '.join(lines)}", reached)


def bases(seeds: int) -> CampaignFigures:
    """Two robots, one fixture, one wire: U (k = 2) of a base within 0.15 mm and 0.02 deg, and true per axis."""
    lines, reached = [], True
    for name, effort, limited in (("default set-up", DEFAULT, False), ("set-up for bases", FOR_BASES, True)):
        bases_found = [_find_base(seed, effort) for seed in _seed_range(f"bases, {name}", seeds)]
        runs = np.array([(error, u) for error, u, _ in bases_found])
        covered = _covered_share(runs)
        origin_mm = np.array([base.origin_u_m for _, _, base in bases_found]) * 1e3
        angle_deg = np.degrees([base.angle_u_rad for _, _, base in bases_found])
        within = np.mean((origin_mm <= MOST_ORIGIN_M * 1e3) & (angle_deg <= np.degrees(MOST_ANGLE_RAD)))
        in_space = np.mean(
            [np.linalg.norm(error[:3]) <= base.origin_space_u_m for error, _, base in bases_found]
        )
        lines.append(
            f"{name}: U stated {np.median(origin_mm):.3f} mm and {np.median(angle_deg):.4f} deg, within 0.15 mm and "
            f"0.02 deg in {within:.1%}; inside U per axis {covered:.1%} (at least 93.5 %), in space {in_space:.1%}; "
            f"error {_describe_runs(runs)}"
        )
        reached = reached and covered >= 0.935 and (within >= 0.95 or not limited)
    return CampaignFigures(f"bases of {seeds}: {'; '.join(lines)}", reached)


def _find_base(seed: int, effort: MeasuringEffort) -> tuple[np.ndarray, np.ndarray, BaseToBase]:
    """Align two robots and return the error of the second's base, its U along every axis, and the base."""
    left_robot, right = two_robots(seed, effort)
    (base,) = bases_together([left_robot.align_robot(), right.align_robot()]).bases
    truth = left_robot.true_fixture() @ np.linalg.inv(right.true_fixture())
    return error_of(base.other_base_base, truth), stated_u(base.covariance), base


def tool(seeds: int) -> CampaignFigures:
    """End-effectors from three points: inside U per axis."""
    found = np.array([find_tool(FixtureWorld(seed)) for seed in _seed_range("end-effectors", seeds)])
    covered = _covered_share(found)
    line = (
        f"tool: inside U per axis {covered:.1%} of {seeds} (at least 93.5 %); error of the tip "
        f"{_describe_runs(found)}"
    )
    return CampaignFigures(line, covered >= 0.935)


@dataclass(frozen=True)
class SeenFixture:
    """A fixture as one robot found it, and as it truly stands in that robot's base."""

    found: Alignment
    truth: np.ndarray

    @property
    def pose_error(self) -> np.ndarray:
        return error_of(self.found.base_fixture, self.truth)

    @property
    def pose_covariance(self) -> np.ndarray:
        return np.array(self.found.covariance)

    @property
    def stated_u_of_axes(self) -> np.ndarray:
        return stated_u(self.pose_covariance)

    @property
    def origin_u_m(self) -> float:
        return worst_expanded_u(self.pose_covariance[:3, :3])

    @property
    def angle_u_rad(self) -> float:
        return worst_expanded_u(self.pose_covariance[3:, 3:])


def _find_fixture(seed: int, effort: MeasuringEffort) -> SeenFixture:
    robot, _ = two_robots(seed, effort)
    return SeenFixture(robot.align_robot(), robot.true_fixture())


def _chain_bases(fixtures_found: list[SeenFixture]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Chain every alignment with the next one, as if two robots had seen one fixture; yield errors and U."""
    for one, other in pairwise(fixtures_found):
        chained = base_through_fixture(
            one.found.base_fixture, one.pose_covariance, other.found.base_fixture, other.pose_covariance
        )
        truth = other.truth @ np.linalg.inv(one.truth)
        yield error_of(chained.other_base_base, truth), stated_u(chained.covariance)


def _covered_share(runs: np.ndarray) -> float:
    return float((np.abs(runs[:, 0]) <= runs[:, 1]).mean())


def _describe_runs(runs: np.ndarray) -> str:
    origin, angle = (
        np.linalg.norm(runs[:, 0, :3], axis=1) * 1e3,
        np.degrees(np.linalg.norm(runs[:, 0, 3:], axis=1)),
    )
    return (
        f"median {np.median(origin):.3f} and 95 % {np.quantile(origin, 0.95):.3f} mm, angle 95 % "
        f"{np.quantile(angle, 0.95):.4f} deg"
    )


def _seed_range(what: str, count: int) -> Iterable[int]:
    return track(range(1, count + 1), description=what, console=Console(stderr=True))
