"""A slice of `make soak ARGS="cell_process_kills=100"`: kill -9 in a browser's view."""

from pathlib import Path

import pytest

from tests.machine_speed import stretched_s
from tests.soak.cell_process_kills import kill_and_look


# Each wait has its own patience; three starts of a service take long on a busy computer
@pytest.mark.timeout(stretched_s(900.0))
async def test_after_a_few_kills_the_page_shows_the_same_step_and_no_point_is_lost(tmp_path: Path) -> None:
    observations = await kill_and_look(tmp_path, 2, seed=2, longest_life=20)
    assert observations.wrong == []
    assert observations.compared > 0
    assert observations.points["person"] > 0
