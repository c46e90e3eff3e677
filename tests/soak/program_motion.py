"""Generated programs, moved, against an independent interpreter of their motion: no point wrong that is not named."""

import sys
from collections.abc import Callable
from functools import partial

from tests.programs.motion.campaign import MotionTally, try_one
from tests.programs.motion.languages import LANGUAGES
from tests.soak.campaign_figures import CampaignFigures

_SHOWN = 20


def of_one_language() -> dict[str, tuple[Callable[[int], CampaignFigures], int]]:
    """Return the campaigns by language, as ``program_motion.kuka``."""
    return {f"program_motion.{name}": (partial(run_language, name), 10_000) for name in LANGUAGES}


def run_language(language: str, count: int) -> CampaignFigures:
    """Move ``count`` generated programs; whatever the robot then does otherwise must be named, with exit code 4."""
    tally = MotionTally()
    for seed in range(count):
        try_one(LANGUAGES[language], seed, tally)
    for line in tally.wrong[:_SHOWN]:
        sys.stderr.write(f"{language} {line}\n")
    return CampaignFigures(f"program_motion.{language}: {tally.figures_line()}", not tally.wrong)
