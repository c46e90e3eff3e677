"""Campaigns over what must survive: kill -9 in the middle of a recovery, and power cuts under the journal."""

from tests.e2e.test_kill_nine import kill_and_resume
from tests.e2e.test_power_cut import lost_in
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.pytest_runs import run_tests

MATRIX = "tests/procedures/test_crash_and_cancel.py"
STORIES = "tests/stories/test_stories.py"


def kill(kills: int) -> CampaignFigures:
    """Kill -9 at random instants: nothing acknowledged lost or doubled, the same result after resume."""
    wrong = kill_and_resume(kills, seed=7)
    return CampaignFigures(f"kill: {kills} kills, {len(wrong)} runs with another end: {wrong[:3]}", not wrong)


def matrix(most: int) -> CampaignFigures:
    """Crash every procedure after every write and cancel it in every step, up to so many of each."""
    ended = run_tests("-n", "2", MATRIX, CELLCAL_CRASHES=str(most))
    lines = ended.stdout.strip().splitlines()
    failed = [line.split(" - ")[0] for line in lines if line.startswith(("FAILED", "ERROR"))]
    summary = f"{len(failed)} failed {failed}" if failed else lines[-1]
    return CampaignFigures(
        f"matrix: at most {most} crashes and cancels per procedure: {summary}", ended.returncode == 0
    )


def corner_story(times: int) -> CampaignFigures:
    """A corner felt in a browser's view, to its certificate."""
    failed = sum(run_tests("-m", "soak", STORIES).returncode != 0 for _ in range(times))
    return CampaignFigures(f"corner_story: {failed} of {times} failed", failed == 0)


def power(cuts: int) -> CampaignFigures:
    """Power cuts on a disk that drops unsynced writes; the controls must lose."""
    full = lost_in(cuts, seed=11, synchronous=None)
    off, normal = (lost_in(cuts, seed=11, synchronous=mode) for mode in ("OFF", "NORMAL"))
    line = (
        f"power: {full} of {cuts} cuts lost something acknowledged (must be 0); the controls: "
        f"synchronous=OFF {off}, NORMAL {normal} (each must be more than half)"
    )
    return CampaignFigures(line, full == 0 and off > cuts / 2 and normal > cuts / 2)
