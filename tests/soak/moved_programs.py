"""Programs with relative, led, shifted, computed and mixed motions, moved and executed before and after."""

import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from tests.programs.moved_campaigns import fanuc_moved, yaskawa_moved
from tests.programs.moved_path import Tally
from tests.soak.figures import Figures

_BLOCK = 500


def moved_fanuc(count: int) -> Figures:
    """Move ``count`` FANUC listings."""
    return _campaign("moved_fanuc", fanuc_moved, count)


def moved_yaskawa(count: int) -> Figures:
    """Move ``count`` Yaskawa jobs."""
    return _campaign("moved_yaskawa", yaskawa_moved, count)


def _campaign(name: str, moved: Callable[[Iterable[int], Path], Tally], count: int) -> Figures:
    total = Tally()
    with tempfile.TemporaryDirectory() as folder:
        for first in range(0, count, _BLOCK):
            total.add(moved(range(first, min(first + _BLOCK, count)), Path(folder)))
            sys.stderr.write(
                f"{time.strftime('%H:%M:%S')} {name} {total.programs}, {len(total.wrong)} wrong\n"
            )
    for line in [*total.wrong, *total.needless][:20]:
        sys.stderr.write(f"  {line}\n")
    return Figures(
        f"{name}: {total.programs} programs, {total.motions} motions: {total.moved} end where the work took them, "
        f"{total.named} are named, {len(total.wrong)} are wrong; {len(total.needless)} places left without need",
        reached=not total.wrong and not total.needless,
    )
