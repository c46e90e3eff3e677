"""Programs cloned between fake cells with all that they hide, both calibrated with noisy instruments."""

import tempfile
from pathlib import Path

import numpy as np

from tests.soak.campaign_figures import CampaignFigures
from tests.unit.helpers.cloned_program import ClonedCells, changed_rows

MOST_MEAN_M, MOST_M = 0.25e-3, 0.5e-3
WITHIN_U = 0.9  # of all points: U is a claim at 95 %


def clones(pairs: int) -> CampaignFigures:
    """Forty points each, taught in one cell and run in the other; base shift alone beside it."""
    means, worst, base, within, left_count = [], [], [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(pairs):
            cells = ClonedCells.make(seed, Path(folder) / str(seed), around=(seed % 5 - 2) * 0.3)
            result = cells.clone_program()
            rows = changed_rows(result)
            missed = cells.missed_m(result.after.positions.frame_tip, rows)
            means.append(float(missed.mean()))
            worst.append(float(missed.max()))
            base.append(float(result.uncorrected_m[rows].mean()))
            within.append(float((missed <= result.expected_error_m[rows]).mean()))
            left_count += len(cells.joints) - len(rows)
    mean, most = max(means), max(worst)
    line = (
        f"clones: {pairs} pairs of cells with 40 points: mean error {np.mean(means) * 1e3:.3f} mm, worst pair "
        f"{mean * 1e3:.3f} mm (at most {MOST_MEAN_M * 1e3:g}), largest {most * 1e3:.3f} mm (at most "
        f"{MOST_M * 1e3:g}); base shift alone {np.mean(base) * 1e3:.2f} mm; inside the expected "
        f"error {np.mean(within):.1%} (at least {WITHIN_U:.0%}); {left_count} points left"
    )
    reached = mean <= MOST_MEAN_M and most <= MOST_M and np.mean(within) >= WITHIN_U
    return CampaignFigures(line, bool(reached))
