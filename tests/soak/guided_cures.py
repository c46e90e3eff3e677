"""Positions of ABB, Yaskawa and KUKA brought back at a simulated pendant, over the wire: half with wrong turns."""

import asyncio
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console

from tests.procedures.guided_cures import (
    BRANDS,
    CureOutcome,
    CureScenario,
    GuidedBench,
    draw_scenario,
    guided_bench,
    play_scenario,
)
from tests.soak.campaign_figures import CampaignFigures

SEEDS_PER_WORLD = 10  # losses of one robot with one record
LEAST_DECIDED = 0.9
AGAIN_EVERY = 10  # seeds; of these what was wrong is brought back once more


def guided_cures(seeds: int) -> CampaignFigures:
    """So many losses of each brand, every second one brought back wrongly; some are brought back again."""
    return judge_cures({brand: run_brand(brand, seeds) for brand in BRANDS})


def run_brand(brand: str, seeds: int) -> list[tuple[CureScenario, CureOutcome]]:
    """Return every cure of a brand with its scenario; some wrong ones are followed by the same axes done right."""
    found = []
    for world in range(1, -(-seeds // SEEDS_PER_WORLD) + 1):
        first = (world - 1) * SEEDS_PER_WORLD
        found += asyncio.run(_run_world(brand, world, range(first, min(first + SEEDS_PER_WORLD, seeds))))
    return found


async def _run_world(brand: str, world: int, seeds: range) -> list[tuple[CureScenario, CureOutcome]]:
    found: list[tuple[CureScenario, CureOutcome]] = []
    console = Console(stderr=True)
    with tempfile.TemporaryDirectory() as folder:
        async with guided_bench(Path(folder), brand, world) as bench:
            await bench.take_record()
            turn_rad = await bench.turn_rad()
            for seed in seeds:
                for scenario, outcome in await _run_seed(bench, seed, turn_rad):
                    console.print(f"{brand} {seed}: {scenario.wrong or 'right'} {outcome}")
                    found.append((scenario, outcome))
    return found


async def _run_seed(
    bench: GuidedBench, seed: int, turn_rad: np.ndarray
) -> list[tuple[CureScenario, CureOutcome]]:
    await bench.hands.mend()
    scenario = draw_scenario(bench.hands.brand, seed, turn_rad, goes_wrong=bool(seed % 2))
    await bench.hands.lose_position(scenario.lost)
    found = [(scenario, await play_scenario(bench, scenario))]
    if scenario.wrong and found[0][1].word != "refused" and seed % AGAIN_EVERY == 1:
        right = CureScenario((), {}, ())
        again = tuple(axis + 1 for axis in scenario.wrong)
        found.append((right, await play_scenario(bench, right, axes_again=again)))
    return found


def judge_cures(by_brand: dict[str, list[tuple[CureScenario, CureOutcome]]]) -> CampaignFigures:
    """Return the figures and whether they are reached: nothing wrong passes, and most cures are decided."""
    texts, reached = [], True
    for brand, played in by_brand.items():
        wrong_accepts = sum(outcome.is_wrong_accept for _, outcome in played)
        untrue = sum(not outcome.names_truth for _, outcome in played)
        bad = [outcome for scenario, outcome in played if scenario.wrong]
        good = [outcome for scenario, outcome in played if not scenario.wrong]
        passed = sum(outcome.word == "pass" for outcome in good)
        found = sum(outcome.word == "fail" for outcome in bad)
        refused = sum(outcome.word == "refused" for _, outcome in played)
        captures = [outcome.captures for _, outcome in played if outcome.captures] or [0]
        texts.append(
            f"{brand}: {wrong_accepts} wrong accepts, {untrue} axes told untruly, {passed} of {len(good)} right ones "
            f"passed, {found} of {len(bad)} wrong ones failed with their axes named, {refused} refused, captures "
            f"median {int(np.median(captures))}, most {max(captures)}"
        )
        decided = passed + found >= LEAST_DECIDED * len(played)
        reached = reached and wrong_accepts == 0 and untrue == 0 and decided
    return CampaignFigures("guided cures: " + "; ".join(texts), reached)
