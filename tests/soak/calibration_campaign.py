"""Campaigns over robot calibrations and drift checks: real drivers and sockets, the fake world with all it hides."""

import asyncio
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from cellcal.procedures.arm.arm_bench import Method
from cellcal.procedures.drift_check import drift_check
from cellcal.procedures.robot_calibration import DEFINITION, robot_calibration
from cellcal.procedures.run import Run
from tests.procedures.memory_ledgers import MemoryLedger
from tests.soak.calibrated_cell import cell_behind_sockets, errors_m
from tests.soak.campaign_figures import CampaignFigures
from tests.unit.helpers.fixture_world import TARGETS, error_of, stated_u

MOST_MEAN_M, LEAST_SAVED = 0.00025, 0.25
BELOW = 0.95  # of all seeds that must be below it, besides their mean
WITHIN_U = 0.9  # of all seeds: U is a claim at 95 %


@dataclass(frozen=True)
class CalibrationOutcome:
    """One calibration against the truth."""

    mean_m: float
    rms_m: float
    tip_u_m: float
    captures: int
    saved: float | None  # None: of all poses that were drawn no fixed plan reaches that U
    verdict: str
    before_m: float
    after_m: float


async def calibrate_robot(seed: int, folder: Path, method: Method = "wire") -> CalibrationOutcome:
    """Calibrate one fake robot, and look at the truth."""
    async with cell_behind_sockets(folder, seed) as bench:
        spec = bench.build_spec("robot_calibration", method=method)
        result = await robot_calibration(Run(bench.cell, MemoryLedger()), spec)
        hook = bench.target_m(method)
        errors = errors_m(bench, result.arm, hook)
    found = result.identified
    fixed = found.fixed_plan_captures
    assert DEFINITION.verdict is not None
    return CalibrationOutcome(
        mean_m=float(errors.mean()),
        rms_m=float(np.sqrt(np.mean(errors**2))),
        tip_u_m=found.tip_u_m,
        captures=found.captures,
        saved=None if fixed is None else 1.0 - found.captures / fixed,
        verdict=DEFINITION.verdict(spec, result).overall_decision,
        before_m=found.hold_out.before_rms_m,
        after_m=found.hold_out.after_rms_m,
    )


def calibrations(seeds: int) -> CampaignFigures:
    """Robots calibrated with a wire of 0.1 mm: error over the work, its stated U, and the poses saved."""
    with tempfile.TemporaryDirectory() as folder:
        runs = [
            asyncio.run(calibrate_robot(seed, Path(folder))) for seed in _seed_range("calibrations", seeds)
        ]
    means = np.array([run.mean_m for run in runs]) * 1e3
    saved = [run.saved for run in runs if run.saved is not None] or [0.0]
    below, unreached = float(np.mean(means <= MOST_MEAN_M * 1e3)), sum(run.saved is None for run in runs)
    within = float(np.mean([run.rms_m <= run.tip_u_m for run in runs]))
    captures = sorted(run.captures for run in runs)
    passed = sum(run.verdict == "pass" for run in runs)
    line = (
        f"calibrations: mean error of the target over the work {means.mean():.3f} mm (at most "
        f"{MOST_MEAN_M * 1e3:g}), at most that in {below:.0%} of the seeds (at least {BELOW:.0%}), worst seed "
        f"{means.max():.3f} mm; RMS inside the stated U in {within:.0%} (at least "
        f"{WITHIN_U:.0%}); captures median {captures[len(captures) // 2]}, saved {np.mean(saved):.0%} (at least "
        f"{LEAST_SAVED:.0%}), least {min(saved):.0%}, no fixed plan in reach in {unreached} "
        f"(not among the saved); {passed} of {seeds} PASS"
    )
    accurate = means.mean() <= MOST_MEAN_M * 1e3 and below >= BELOW
    return CampaignFigures(line, bool(accurate and np.mean(saved) >= LEAST_SAVED and within >= WITHIN_U))


@dataclass(frozen=True)
class ToolFound:
    """A tool frame found inside a calibration against the truth, along and about its axes."""

    error: np.ndarray  # x, y, z, rx, ry, rz
    u: np.ndarray
    not_written: str  # why it was not written, else empty
    captures: int
    verdict: str
    target_m: float  # RMS error of the target over the work
    target_u_m: float


async def find_tool(seed: int, folder: Path, method: Method) -> ToolFound:
    """Calibrate one fake robot with three points of its end-effector measured in between, and look at the truth."""
    async with cell_behind_sockets(folder, seed) as bench:
        bench.hang_at_targets()
        points = {"points_in_tool_m": TARGETS, "rough_flange_tool": {"position_m": [0.0, 0.0, 0.2]}}
        spec = bench.build_spec("robot_calibration", method=method, tool_number=3, **points)
        result = await robot_calibration(Run(bench.cell, MemoryLedger()), spec)
        found, truth = result.identified.tool, bench.flange_tool()
        errors = errors_m(bench, result.arm, bench.target_m(method))
    assert found is not None
    assert DEFINITION.verdict is not None
    return ToolFound(
        error=error_of(found.flange_tool, truth),
        u=stated_u(found.covariance),
        not_written=result.tool_not_written,
        captures=sum(found.captures),
        verdict=DEFINITION.verdict(spec, result).overall_decision,
        target_m=float(np.sqrt(np.mean(errors**2))),
        target_u_m=result.identified.tip_u_m,
    )


def tool_in_calibration(seeds: int) -> CampaignFigures:
    """Tool frames found inside calibrations with wire and tracker in turn: the error, and whether U holds it."""
    with tempfile.TemporaryDirectory() as folder:
        runs = [
            asyncio.run(find_tool(seed, Path(folder), "tracker" if seed % 2 else "wire"))
            for seed in _seed_range("tools in calibrations", seeds)
        ]
    covered = float(np.mean([np.abs(run.error) <= run.u for run in runs]))
    tips = np.array([np.linalg.norm(run.error[:3]) for run in runs]) * 1e3
    turns = np.degrees([np.linalg.norm(run.error[3:]) for run in runs])
    within = float(np.mean([run.target_m <= run.target_u_m for run in runs]))
    written = sum(not run.not_written for run in runs)
    line = (
        f"tool in calibration: inside U per axis {covered:.0%} (at least {WITHIN_U:.0%}); tip off {tips.mean():.3f} "
        f"mm, worst {tips.max():.3f}; axes by {turns.mean():.3f} deg, worst {turns.max():.3f}; "
        f"{np.mean([run.captures for run in runs]):.0f} captures at its points; written in {written} of {seeds}; "
        f"target over the work inside U in {within:.0%}; {sum(run.verdict == 'pass' for run in runs)} PASS"
    )
    return CampaignFigures(line, covered >= WITHIN_U and within >= WITHIN_U)


@dataclass(frozen=True)
class DriftOutcome:
    """What a drift check said after something happened."""

    happened: str
    named: str  # "" where it left it open, "nothing" where it saw no change


async def check_drift(seed: int, folder: Path, method: Method) -> list[DriftOutcome]:
    """Take a reference of one fake robot, let one thing after another happen to it, and ask each time."""
    outcomes = []
    async with cell_behind_sockets(folder, seed) as bench:
        spec = bench.build_spec("drift_check", method=method)
        reference = (await drift_check(Run(bench.cell, MemoryLedger()), spec)).reference
        cell = replace(bench.cell, drift_references=(reference,))
        for happened in ("nothing", "tool", "device", "warmth", *(f"J{k}" for k in range(1, 7))):
            undo = bench.let_happen(happened, method)
            look = (await drift_check(Run(cell, MemoryLedger()), spec)).look
            undo()
            assert look is not None
            named = (
                "nothing"
                if not look.finding.has_changed
                else look.finding.likeliest_cause.name
                if look.decided
                else ""
            )
            outcomes.append(DriftOutcome(happened, named))
    return outcomes


def drifts(seeds: int) -> CampaignFigures:
    """Drift checks with wire and tracker in turn: what happened is named, and hardly ever wrongly."""
    outcomes: list[DriftOutcome] = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in _seed_range("drift checks", seeds):
            outcomes += asyncio.run(check_drift(seed, Path(folder), "tracker" if seed % 2 else "wire"))
    quiet = [one for one in outcomes if one.happened == "nothing"]
    false_alarms = sum(one.named != "nothing" for one in quiet)
    named_outcomes = [one for one in outcomes if one.happened != "nothing" and one.named != "nothing"]
    named = [one for one in named_outcomes if one.named]
    wrong = [one for one in named if one.named != one.happened]
    line = (
        f"drifts: {false_alarms} of {len(quiet)} alarms where nothing happened (none); of "
        f"{len(outcomes) - len(quiet)} events {len(named_outcomes)} seen, {len(named)} named (at "
        f"least 60 % of those seen), "
        f"{len(wrong)} of these wrongly (at most 5 %)"
    )
    reached = (
        false_alarms == 0 and len(named) >= 0.6 * len(named_outcomes) and len(wrong) <= 0.05 * len(named)
    )
    return CampaignFigures(line, reached)


def _seed_range(what: str, count: int) -> Iterable[int]:
    return track(range(1, count + 1), description=what, console=Console(stderr=True))
