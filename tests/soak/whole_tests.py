"""Tests of the usual suite in full: those marked `soak`, and every page in every language."""

from tests.soak.campaign_figures import CampaignFigures
from tests.soak.pytest_runs import run_tests


def long_tests(times: int) -> CampaignFigures:
    """Run the tests that are marked `soak`, which the usual suite leaves out."""
    return _run_times("long_tests", times, "tests", "-m", "soak")


def languages(times: int) -> CampaignFigures:
    """Look at the pages in all four languages; the usual suite looks in English and one other at most of them."""
    return _run_times("languages", times, "tests/service", "-m", "", CELLCAL_PAGES_IN_FULL="1")


def _run_times(name: str, times: int, *words: str, **variables: str) -> CampaignFigures:
    runs = [
        run_tests("-n", "2", "--dist", "loadfile", "--no-loadscope-reorder", *words, **variables)
        for _ in range(times)
    ]
    failed = sum(run.returncode != 0 for run in runs)
    summaries = "; ".join(run.stdout.strip().rpartition("\n")[2] for run in runs)
    return CampaignFigures(f"{name}: {failed} of {times} runs failed; {summaries}", failed == 0)
