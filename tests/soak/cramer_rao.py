"""Is the estimate as good as estimates can be? The tip's error at unseen postures against its theoretical bound."""

import sys

import numpy as np
from rich.console import Console
from rich.progress import track

from cellcal.calibration.arm.kinematics import load_model
from tests.benchmarks.bench_identify import base_layout, squared_errors
from tests.soak.campaign_figures import CampaignFigures

_ROWS = (100, 1000, 10_000)
_WITHIN = 0.03


def cramer_rao(arms: int) -> CampaignFigures:
    """So many simulated arms for each number of rows: 27 parameters, 1000 noise-free check postures each."""
    layout, ratios = base_layout(load_model("ur10")), []
    for rows in _ROWS:
        seeds = track(range(arms), description=f"{rows} rows", console=Console(stderr=True))
        actual, bound = np.array([squared_errors(rows, seed, layout) for seed in seeds]).T
        ratio = float(np.sqrt(actual.mean() / bound.mean()))
        # Of a ratio of means of independent arms, to first order.
        uncertain = 0.5 * ratio * float(np.std(actual / bound)) / np.sqrt(arms)
        sys.stdout.write(
            f"  {rows} rows: {np.sqrt(actual.mean()) * 1e3:.5f} mm, bound {np.sqrt(bound.mean()) * 1e3:.5f} mm, "
            f"ratio {ratio:.3f} +- {uncertain:.3f}\n"
        )
        ratios.append(ratio)
    ratio_text = " / ".join(f"{ratio:.3f}" for ratio in ratios)
    line = (
        f"cramer_rao: tip error over its bound {ratio_text} for {_ROWS} rows, {arms} arms each "
        f"(within {_WITHIN:.0%})"
    )
    return CampaignFigures(line, all(abs(ratio - 1.0) <= _WITHIN for ratio in ratios))
