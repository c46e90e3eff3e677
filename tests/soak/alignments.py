"""Campaign over alignments as procedures: two robots with a wire each, one fixture; drivers and sockets."""

import asyncio
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from cellcal.calibration.geometry import Pose
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.demo.simulated_technician import SimulatedTechnician
from cellcal.service.record.journal import Journal
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.runs.open_cell import open_cell, with_robot_history
from cellcal.service.runs.run_procedure import run_procedure
from cellcal.service.runs.settings import build_spec
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.fixtures import MOST_ANGLE_RAD, MOST_ORIGIN_M
from tests.stories.day_cell import ROBOTS, day_cell
from tests.unit.helpers.fixture_world import error_of, stated_u
from tests.unit.helpers.two_robots import FOR_BASES, FOR_FIXTURES

LEAST_INSIDE, LEAST_WITHIN = 0.935, 0.95
LEAST_ACCEPTED, _PER_CELL = (
    0.95,
    4,
)  # a refusal costs a repetition: few may be; two robots, two alignments each
_LIMITS = {"origin_m": MOST_ORIGIN_M, "angle_rad": MOST_ANGLE_RAD}
_SIX: dict[str, Any] = {
    "fixture": "by six points",
    "points_in_fixture_m": FOR_FIXTURES.points,
    "rough_base_fixture": {"position_m": [0.85, 0.0, -0.2]},
    "limits": _LIMITS,
    "write_anyway": "a campaign counts every alignment",
}
_TEN = _SIX | {
    "fixture": "by ten points",
    "points_in_fixture_m": FOR_BASES.points,
    "bases": _LIMITS,
    "rules": {"samples": FOR_BASES.samples, "max_captures": FOR_BASES.per_spot},
}
_THROUGH = {"fixture": _TEN["fixture"], "limits": _LIMITS, "write_anyway": _SIX["write_anyway"]}


@dataclass(frozen=True)
class SeenPose:
    """A pose as a procedure states it; error and U along and about every axis, U of its worst directions."""

    error: np.ndarray
    u: np.ndarray
    origin_u_m: float
    angle_u_rad: float

    @property
    def is_within(self) -> bool:
        """Whether the stated U is what the issue asks for."""
        return self.origin_u_m <= MOST_ORIGIN_M and self.angle_u_rad <= MOST_ANGLE_RAD


@dataclass(frozen=True)
class SocketRobot:
    """One of the two robots in a running cell."""

    config: CellConfig
    fake_client: FakeCellClient
    journal: Journal
    name: str

    async def run_procedures(self, *procedures: tuple[str, dict[str, Any]]) -> list[Any]:
        """Run procedures one after the other with the real drivers; return their results."""
        results = []
        technician = SimulatedTechnician(self.fake_client, lambda _: None, self._wire_name)
        async with open_cell(self.config, technician, self.name) as cell:
            for procedure, settings in procedures:
                await cell.robot.move_joints((0.0,) * 6, speed_rad_s=0.4)
                cell_with_history = await with_robot_history(cell, self.journal)
                spec = build_spec(self.config, self.name, procedure, settings)
                outcome = await run_procedure(cell_with_history, procedure, spec, self.journal)
                if outcome.result is None or outcome.verdict is not RunVerdict.PASSED:
                    raise AlignmentsError(f"{procedure} of {self.name}: {outcome.reason}")
                results.append(outcome.result)
        return results

    async def base_fixture(self) -> np.ndarray:
        """Return the true fixture (4, 4) in the robot's own base."""
        return np.array((await self.fake_client.read_truth())["gauges"][self._wire_name]["fixture_in_base"])

    @property
    def _wire_name(self) -> str:
        return f"wire of {self.name}"


class AlignmentsError(Exception):
    """A procedure ended without a result."""


async def align_two_robots(folder: Path, seed: int) -> tuple[list[SeenPose], SeenPose]:
    """Align two robots with one fixture; return the fixtures, and the one's base seen from the other."""
    async with day_cell(folder, seed=seed, points_m=FOR_BASES.points) as (path, fake_client):
        config = read_cell_file(path)
        with open_journal(config) as journal:
            one, other = (SocketRobot(config, fake_client, journal, name) for name in ROBOTS)
            aligning = ("mastering_record", {}), ("fixture_alignment", _SIX), ("fixture_alignment", _TEN)
            first = await one.run_procedures(*aligning)
            *second, chained = await other.run_procedures(*aligning, ("base_to_base", _THROUGH))
            true = await one.base_fixture(), await other.base_fixture()
    fixtures = [
        _compare_pose(each[1].placed, base_fixture)
        for each, base_fixture in zip((first, second), true, strict=True)
    ]
    (base,) = chained.bases
    pose = base.pose
    base_base = true[0] @ np.linalg.inv(true[1])
    error = error_of(pose.other_base_base, base_base)
    return fixtures, SeenPose(error, stated_u(pose.covariance), pose.origin_u_m, pose.angle_u_rad)


def _compare_pose(placed: Any, truth: np.ndarray) -> SeenPose:
    found: Pose = placed.outer_inner
    error = error_of(found, truth)
    return SeenPose(error, stated_u(placed.covariance), placed.origin_u_m, placed.angle_u_rad)


def alignments(seeds: int) -> CampaignFigures:
    """Fixtures by six points, bases by ten: U (k = 2) within 0.15 mm and 0.02 deg, and the truth inside it."""
    fixtures: list[SeenPose] = []
    bases: list[SeenPose] = []
    broken = 0
    for seed in track(range(1, seeds + 1), description="alignments", console=Console(stderr=True)):
        with tempfile.TemporaryDirectory() as folder:
            try:
                found, base = asyncio.run(align_two_robots(Path(folder), seed))
            except AlignmentsError as error:
                sys.stderr.write(f"alignments, seed {seed}: {error}\n")
                broken += 1
                continue
        fixtures += found
        bases.append(base)
        sys.stderr.write(
            f"seed {seed}: {_summarize_poses('fixtures', found)[0]}; {_summarize_poses('base', [base])[0]}\n"
        )  # hours are long
    summaries = [
        _summarize_poses("fixtures by six points", fixtures),
        _summarize_poses("bases by ten points", bases),
    ]
    line = "; ".join(words for words, _ in summaries)
    share = 1.0 - broken / (_PER_CELL * seeds)
    words = f"{broken} cells left out because a run was refused or broke off, alignments accepted {share:.1%}"
    reached = share >= LEAST_ACCEPTED and all(good for _, good in summaries)
    return CampaignFigures(
        f"alignments of {seeds} cells: {line}; {words} (at least {LEAST_ACCEPTED:.0%})", reached
    )


def _summarize_poses(what: str, poses: list[SeenPose]) -> tuple[str, bool]:
    """Return the figures of what was seen, and whether they are reached."""
    if not poses:
        return f"{what}: none", False
    within = float(np.mean([one.is_within for one in poses]))
    inside = float(np.mean([np.abs(one.error) <= one.u for one in poses]))
    origin_mm = np.array([one.origin_u_m for one in poses]) * 1e3
    angle_deg = np.degrees([one.angle_u_rad for one in poses])
    errors_mm = np.array([np.linalg.norm(one.error[:3]) for one in poses]) * 1e3
    words = (
        f"{what}: U stated {np.median(origin_mm):.3f} mm and {np.median(angle_deg):.4f} deg, within 0.15 mm and "
        f"0.02 deg in {within:.0%} of {len(poses)} (at least {LEAST_WITHIN:.0%}), truth inside U per axis "
        f"{inside:.1%} (at least {LEAST_INSIDE:.1%}), error of the origin median {np.median(errors_mm):.3f} and most "
        f"{errors_mm.max():.3f} mm"
    )
    return words, within >= LEAST_WITHIN and inside >= LEAST_INSIDE
