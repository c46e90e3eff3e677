"""A break of a small move is placed to the row, which the errors of the arm as made hide."""

from dataclasses import replace

import pytest

from cellcal.calibration.identification.break_choice import choose_breaks
from cellcal.calibration.identification.cross_validation import group_rows
from cellcal.calibration.identification.frame_fits import FrameFits
from tests.unit.helpers.simulated_arm import tracker_points


@pytest.mark.parametrize("robot", ["ur10", "abb_irb120", "kuka_kr6_r900"])
@pytest.mark.parametrize("moved_m", [5e-4, 2e-3, 0.2])
def test_a_break_is_placed_to_the_row(robot: str, moved_m: float) -> None:
    for seed in range(4):
        true = tracker_points(robot, 80, seed=seed)
        places = true.observations.positions_m.copy()
        places[40:] += [moved_m, 0.0, 0.0]
        rows = replace(true.observations, positions_m=places)
        found, _ = choose_breaks(FrameFits(true.model, rows), group_rows(rows.joints_rad), 0)
        assert [each.row for each in found] == [40]
