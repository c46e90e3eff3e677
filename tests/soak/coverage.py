"""Does an interval hold the truth as often as it says? Simulated calibrations of every kind, by the thousand."""

import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.progress import track

from cellcal.calibration.geometry import Array
from tests.soak import coverage_cells, coverage_devices
from tests.soak.campaign_figures import CampaignFigures

KINDS = {**coverage_devices.KINDS, **coverage_cells.KINDS}

LEAST, MOST = 0.935, 0.97
_WAYS = {False: "deviation known", True: "deviation found"}
_AT_ONCE = 2
_SHARE = 50  # calibrations a piece of work


@dataclass(frozen=True, eq=False)
class CoverageTally:
    """How often the intervals of one kind held the truth, calibration by calibration."""

    names: tuple[str, ...]
    parameters: Array  # (R, p) of 0 and 1
    tips: Array  # (R, t)

    @property
    def worst_parameter(self) -> tuple[str, float]:
        """The parameter that was held least often, and how often."""
        by_name = self.parameters.mean(axis=0)
        return self.names[int(by_name.argmin())], float(by_name.min())

    @property
    def is_good(self) -> bool:
        """Whether parameters and tips were held as often as they must be, no more and no less."""
        return all(LEAST <= float(inside.mean()) <= MOST for inside in (self.parameters, self.tips))

    def describe(self, what: str) -> str:
        """Say it."""
        name, share = self.worst_parameter
        return (
            f"{what}: parameters {self.parameters.mean():.2%}, tip {self.tips.mean():.2%} of {len(self.tips)} "
            f"calibrations; least often {name}, {share:.1%}"
        )


def coverage(runs: int) -> CampaignFigures:
    """So many calibrations of every kind, with known and with found deviations; k = 2, or Student's."""
    with ProcessPoolExecutor(_AT_ONCE, multiprocessing.get_context("spawn")) as pool:
        work = [
            (kind, found, pool.submit(tally_kind, kind, found, range(first, min(first + _SHARE, runs))))
            for kind in KINDS
            for found in _WAYS
            for first in range(0, runs, _SHARE)
        ]
        parts: dict[tuple[str, bool], list[CoverageTally]] = {}
        for kind, found, piece in track(work, description="coverage", console=Console(stderr=True)):
            parts.setdefault((kind, found), []).append(piece.result())
    tallies = {key: _join_tallies(some) for key, some in parts.items()}
    for (kind, found), each in tallies.items():
        sys.stdout.write(f"  {'' if each.is_good else 'OFF '}{each.describe(f'{kind}, {_WAYS[found]}')}\n")
    shares = [float(inside.mean()) for each in tallies.values() for inside in (each.parameters, each.tips)]
    line = (
        f"coverage: {runs} calibrations of each of {len(KINDS)} kinds, twice: intervals hold the truth in "
        f"{min(shares):.1%} to {max(shares):.1%} ({LEAST:.1%} to {MOST:.1%})"
    )
    return CampaignFigures(line, all(each.is_good for each in tallies.values()))


def tally_kind(kind: str, found: bool, seeds: range) -> CoverageTally:
    """Calibrate with these seeds, and say which intervals held."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    scores = [KINDS[kind](np.random.default_rng([seed, found]), found) for seed in seeds]
    inside_parameters = [np.abs(score.parameters) <= score.factor for score in scores]
    tips = [np.abs(score.tips) <= score.factor for score in scores]
    return CoverageTally(
        scores[0].names, np.array(inside_parameters, dtype=float), np.array(tips, dtype=float)
    )


def _join_tallies(parts: list[CoverageTally]) -> CoverageTally:
    return CoverageTally(
        parts[0].names,
        np.concatenate([part.parameters for part in parts]),
        np.concatenate([part.tips for part in parts]),
    )
