"""Damaged files of a FANUC controller: how many make a record, and how many of these are wrong."""

import tempfile
from collections import Counter
from pathlib import Path

from tests.soak.campaign_figures import CampaignFigures
from tests.unit.helpers.fanuc_mutations import judge_damage

_FIRST_SEED = 1_000


def fanuc_files(damages: int) -> CampaignFigures:
    """Damage one file of a backup in one place, again and again."""
    with tempfile.TemporaryDirectory() as folder:
        seeds = range(_FIRST_SEED, _FIRST_SEED + damages)
        found = Counter(judge_damage(Path(folder), seed) for seed in seeds)
    wrong = sorted(found.keys() - {"refused", "harmless"})
    for each in wrong:
        print(each)
    line = f"{damages} damaged files: {found['refused']} refused, {found['harmless']} harmless, {len(wrong)} wrong"
    return CampaignFigures(line, not wrong)
