"""Campaign over tools taught by hand: how far the tip found is from the true one, and whether U says so."""

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from cellcal.calibration.geometry import Pose, exp_rotation, homogeneous_matrix
from cellcal.calibration.points.touch_design import planned_attitudes
from cellcal.calibration.uncertainty import Verdict
from cellcal.procedures.run import RefusalError, Run
from cellcal.procedures.six_point_tcp import DEFINITION, SixPointTcp, ToolSetup, six_point_tcp
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import TIP, ProcedureScene, tool_touch_scene
from tests.soak.campaign_figures import CampaignFigures

SIGMA_M, MOST_RAD, WOBBLE_RAD = 0.0002, np.radians(60.0), np.radians(4.0)
MOST_MEDIAN_M, LEAST_INSIDE, MOST_INSIDE = 0.00025, 0.935, 0.97
PIN = np.array([0.7, 0.1, 0.3])
SQUARE = np.diag([1.0, -1.0, -1.0])
WRITES_ALL = {"rms_limit_m": 0.05, "write_anyway": "a campaign counts every tool"}
SIX: dict[str, Any] = {"min_touches": 6, "max_touches": 6} | WRITES_ALL
UNTIL_ENOUGH: dict[str, Any] = {"max_touches": 20} | WRITES_ALL


@dataclass(frozen=True)
class TaughtTool:
    """One tool: how far its tip is off, what was stated, and how it came about."""

    error_m: float
    u_m: float
    touches: int
    fixed_plan: int | None
    again: int
    refused: bool  # the procedure would have written nothing if no reason to do so had stood in its settings

    @property
    def is_inside(self) -> bool:
        """Whether the true tip is within U of the one found."""
        return self.error_m <= self.u_m


def teach_tool(seed: int, settings: dict[str, Any]) -> TaughtTool | None:
    """Teach one tool whose technician follows the advice within a few degrees and misses the pin by chance.

    None: touches contradicted the others again and again, so that no tip was claimed.
    """
    made = tool_touch_scene(method="four_point", touch_sigma_m=SIGMA_M, **settings)
    random = np.random.default_rng(seed)
    attitudes = planned_attitudes(settings["max_touches"], MOST_RAD - 2.0 * WOBBLE_RAD)
    for number, planned in enumerate(attitudes, 1):
        for key in touch_keys(number):
            made.technician.does[key] = _touch_action(made, planned, random)
    try:
        setup = asyncio.run(six_point_tcp(Run(made.cell, MemoryLedger()), made.spec))
    except RefusalError:
        return None
    return compare_with_truth(made.spec, setup, np.array(TIP))


def compare_with_truth(spec: SixPointTcp, setup: ToolSetup, truth_m: np.ndarray) -> TaughtTool:
    """Hold what a procedure found against the true tip."""
    assert DEFINITION.verdict is not None
    return TaughtTool(
        error_m=float(np.linalg.norm(np.array(setup.tip.tip_in_flange_m) - truth_m)),
        u_m=setup.tip.tip_u_in_space_m,
        touches=setup.touches,
        fixed_plan=setup.fixed_plan_touches,
        again=len(setup.set_aside),
        refused=DEFINITION.verdict(spec, setup).overall_decision is Verdict.FAIL,
    )


def touch_keys(number: int) -> tuple[str, str]:
    """Return the keys of what a technician is asked for a touch, and for the same one anew."""
    return ("touch" if number == 1 else f"touch_{number}", f"touch_anew_{number}")


def attitude_at(planned: np.ndarray, random: np.random.Generator, pin_m: np.ndarray) -> np.ndarray:
    """Return the flange (4, 4) whose tip misses the pin by chance, nearly in the attitude that was asked for."""
    wobble = random.normal(size=3)
    wobble *= random.uniform(0.0, WOBBLE_RAD) / np.linalg.norm(wobble)
    rotation = SQUARE @ planned @ exp_rotation(wobble)
    place = pin_m + random.normal(scale=SIGMA_M, size=3)
    return homogeneous_matrix(rotation, place - rotation @ np.array(TIP))


def _touch_action(
    made: ProcedureScene, planned: np.ndarray, random: np.random.Generator
) -> Callable[[], None]:
    return lambda: setattr(made.arm, "taught", Pose.from_matrix(attitude_at(planned, random, PIN)))


def tcp(seeds: int) -> CampaignFigures:
    """Six attitudes to 60 degrees, 0.2 mm of touch noise, an arm without errors; then as many as class B takes.

    Every tool counts, those too that the procedure would not have written.
    """
    six = [teach_tool(seed, SIX) for seed in _seed_range("tools, six touches", seeds)]
    many = [teach_tool(seed, UNTIL_ENOUGH) for seed in _seed_range("tools, until enough", max(seeds // 4, 1))]
    fixed, enough = claimed_tools(six), claimed_tools(many)
    median, inside = float(np.median([one.error_m for one in fixed])), share_inside(fixed)
    taken = float(np.mean([one.touches for one in enough]))
    plan = float(np.mean([one.fixed_plan or np.nan for one in enough]))
    again = float(np.mean([one.again for one in fixed]))
    line = (
        f"tcp: six attitudes to 60 deg, an arm without errors, {seeds} runs: error median {median * 1e3:.3f} mm (at "
        f"most 0.25), inside U {inside:.1%} (93.5 to 97 %), touched again {again:.3f} a run, "
        f"{describe_refusals(six)}; "
        f"until class B holds: {taken:.1f} touches, fixed plan {plan:.0f}, inside U {share_inside(enough):.1%}, "
        f"{describe_refusals(many)}"
    )
    reached = median <= MOST_MEDIAN_M and LEAST_INSIDE <= inside <= MOST_INSIDE
    return CampaignFigures(line, reached and share_inside(enough) >= LEAST_INSIDE)


def claimed_tools(runs: list[TaughtTool | None]) -> list[TaughtTool]:
    """Return the tools of which a tip was claimed."""
    return [one for one in runs if one is not None]


def share_inside(runs: list[TaughtTool]) -> float:
    """Return the share of tools whose true tip is within the stated U."""
    return float(np.mean([one.is_inside for one in runs]))


def describe_refusals(runs: list[TaughtTool | None]) -> str:
    """Say how many tools would not have been written, and of how many there was no tip to write."""
    failed, without = sum(one.refused for one in claimed_tools(runs)), runs.count(None)
    return (
        f"{failed} of {len(runs)} would have been refused (FAIL, counted all the same), {without} had no tip"
    )


def _seed_range(what: str, count: int) -> Iterable[int]:
    return track(range(1, count + 1), description=what, console=Console(stderr=True))
