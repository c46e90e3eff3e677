"""Recoveries with a person at the pendant: every jog misjudged by up to a fifth, some axes and values mistaken.

No wire jogs or writes this robot: each instruction is read, obeyed more or less, and checked by the counts.
"""

import numpy as np
from rich.console import Console
from rich.progress import track

from tests.procedures.pendant_recovery import PendantRecovery, recover_seed
from tests.soak.campaign_figures import CampaignFigures

MOST_CAPTURES, MOST_GUIDED_S, LEAST_ACCEPTED = 12, 25 * 60.0, 0.95


def pendant(seeds: int) -> CampaignFigures:
    """Turn-only losses recovered by hand: no wrong accept, 95 % accepted, twelve captures, 25 minutes."""
    console = Console(stderr=True)
    ended = [recover_seed(seed) for seed in track(range(1, seeds + 1), "by hand", console=console)]
    for seed, one in enumerate(ended, 1):
        if not one.is_accepted:
            console.print(f"seed {seed}: {one.reason}")
    return judge_recoveries(ended)


def judge_recoveries(ended: list[PendantRecovery]) -> CampaignFigures:
    """Return the figures of recoveries and whether they are reached."""
    seeds, accepted = len(ended), [one for one in ended if one.is_accepted]
    wrong = sum(one.is_wrong for one in ended)
    captures = [one.fitted_captures for one in accepted] or [MOST_CAPTURES + 1]
    minutes = np.array([one.guided_s for one in accepted] or [np.inf]) / 60.0
    slips = [slip for one in ended for slip in one.slips]
    line = (
        f"pendant: {wrong} wrong accepts, {len(accepted)} of {seeds} accepted (at least 95 %), captures median "
        f"{int(np.median(captures))}, most {max(captures)} (with checks median "
        f"{int(np.median([one.all_captures for one in accepted] or [0]))}), guided time median "
        f"{np.median(minutes):.1f} min, most {minutes.max():.1f} (median under 25; "
        f"{np.mean(minutes < MOST_GUIDED_S / 60.0):.1%} are); slips: {slips.count('wrong axis')} wrong axis, "
        f"{slips.count('wrong way')} wrong way, {slips.count('mistyped')} mistyped"
    )
    fast = float(np.median(minutes)) < MOST_GUIDED_S / 60.0 and float(np.median(captures)) <= MOST_CAPTURES
    return CampaignFigures(line, wrong == 0 and len(accepted) >= LEAST_ACCEPTED * seeds and fast)
