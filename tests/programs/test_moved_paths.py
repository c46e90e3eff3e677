"""The path of the tip in space, before and after a move: `tests.programs.moved_path`, a slice of `make soak`."""

from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from tests.programs.moved_campaigns import fanuc_moved, yaskawa_moved
from tests.programs.moved_path import PathTally

SEEDS = range(20_000, 20_120)


@pytest.mark.parametrize("moved", [fanuc_moved, yaskawa_moved])
def test_every_motion_goes_along_or_is_named(
    moved: Callable[[Iterable[int], Path], PathTally], tmp_path: Path
) -> None:
    tally = moved(SEEDS, tmp_path)

    assert tally.programs == len(SEEDS)
    assert not tally.wrong
    assert not tally.needless
    assert tally.moved > 200
    assert tally.named > 200
