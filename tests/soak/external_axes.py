"""Generated programs with external axes and standing tools, moved, against a calculation by plain numpy."""

import sys
from collections.abc import Callable
from functools import partial

from tests.programs.external.brands import BRANDS
from tests.programs.external.campaign import ExternalTally, try_cell
from tests.soak.campaign_figures import CampaignFigures

_SHOWN = 20


def of_one_brand() -> dict[str, tuple[Callable[[int], CampaignFigures], int]]:
    """Return the campaigns by brand, as ``external_axes.kuka``."""
    return {f"external_axes.{name}": (partial(run_brand, name), 10_000) for name in BRANDS}


def run_brand(name: str, count: int) -> CampaignFigures:
    """Move ``count`` generated programs; every point is where the calculation has it, or left with exit code 4."""
    tally = ExternalTally()
    for seed in range(count):
        try_cell(name, seed, tally)
    for line in tally.wrong[:_SHOWN]:
        sys.stderr.write(f"{name} {line}\n")
    return CampaignFigures(f"external_axes.{name}: {tally.figures_line()}", not tally.wrong)
