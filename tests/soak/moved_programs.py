"""Programs with relative, led, shifted, computed and mixed motions, moved and executed before and after."""

import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from tests.programs.moved_campaigns import fanuc_moved, yaskawa_moved
from tests.programs.moved_path import PathTally
from tests.soak.campaign_figures import CampaignFigures

_BLOCK = 500


def moved_fanuc(count: int) -> CampaignFigures:
    """Move ``count`` FANUC listings."""
    return _run_campaign("moved_fanuc", fanuc_moved, count)


def moved_yaskawa(count: int) -> CampaignFigures:
    """Move ``count`` Yaskawa jobs."""
    return _run_campaign("moved_yaskawa", yaskawa_moved, count)


def _run_campaign(
    name: str, moved: Callable[[Iterable[int], Path], PathTally], count: int
) -> CampaignFigures:
    total = PathTally()
    with tempfile.TemporaryDirectory() as folder:
        for first in range(0, count, _BLOCK):
            total.add_tally(moved(range(first, min(first + _BLOCK, count)), Path(folder)))
            sys.stderr.write(
                f"{time.strftime('%H:%M:%S')} {name} {total.programs}, {len(total.wrong)} wrong\n"
            )
    for line in [*total.wrong, *total.needless][:20]:
        sys.stderr.write(f"  {line}\n")
    return CampaignFigures(
        f"{name}: {total.programs} programs, {total.motions} motions: {total.moved} end where the work took them, "
        f"{total.named} are named, {len(total.wrong)} are wrong; {len(total.needless)} places left without need",
        reached=not total.wrong and not total.needless,
    )
