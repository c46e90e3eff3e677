"""Tests of the usual suite in full: those marked `soak`, and every page in every language."""

import os
import subprocess
import sys

from tests.soak.campaign_figures import CampaignFigures

_PYTEST = (sys.executable, "-m", "pytest", "-q", "-p", "no:randomly", "-n", "2", "--dist", "loadgroup")


def long_tests(times: int) -> CampaignFigures:
    """Run the tests that are marked `soak`, which the usual suite leaves out."""
    return _run_times("long_tests", times, ["tests", "-m", "soak"], {})


def languages(times: int) -> CampaignFigures:
    """Look at the pages in all four languages; the usual suite looks in English and one other at most of them."""
    return _run_times("languages", times, ["tests/service", "-m", ""], {"CELLCAL_PAGES_IN_FULL": "1"})


def _run_times(name: str, times: int, selection: list[str], variables: dict[str, str]) -> CampaignFigures:
    summaries, failed = [], 0
    for _ in range(times):
        ended = subprocess.run(
            [*_PYTEST, *selection], env=os.environ | variables, capture_output=True, text=True, check=False
        )
        failed += ended.returncode != 0
        summaries += ended.stdout.strip().splitlines()[-1:]
    return CampaignFigures(f"{name}: {failed} of {times} runs failed; {'; '.join(summaries)}", failed == 0)
