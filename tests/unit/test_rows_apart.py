"""Rows of another station or robot in a file are named with what they are, and not counted as chance outliers."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.parameters import GEOMETRY
from cellcal.calibration.identification.rows_apart import rows_apart
from cellcal.calibration.identification.selection import IdentificationOptions
from tests.unit.helpers.simulated_arm import tracker_points

_OPTIONS = IdentificationOptions(level=GEOMETRY, judge=False)


def _joined(first: PointObservations, second: PointObservations, first_row: int) -> PointObservations:
    return replace(
        first,
        joints_rad=np.concatenate([first.joints_rad[:first_row], second.joints_rad]),
        positions_m=np.concatenate([first.positions_m[:first_row], second.positions_m]),
    )


@pytest.mark.parametrize(
    ("robot", "expected"), [("abb_irb120", "by themselves:"), ("ur5e", "by themselves either")]
)
def test_a_block_of_rows_from_elsewhere_is_named(robot: str, expected: str) -> None:
    here, there = tracker_points("abb_irb120", 52, seed=1), tracker_points(robot, 12, seed=5).observations
    moved = replace(there, positions_m=there.positions_m[:, [1, 0, 2]] * [-1.0, 1.0, 1.0] + 1.0)
    found = identify_arm(here.model, _joined(here.observations, moved, 40), options=_OPTIONS)
    notes = rows_apart(found, np.arange(100, 152))
    assert [note.code for note in notes] == ["apart"]
    assert "140 to 151" in notes[0].message
    assert expected in notes[0].message
    assert notes[0].rows == tuple(range(140, 152))


def test_a_few_outliers_are_no_other_station() -> None:
    here = tracker_points("abb_irb120", 52, seed=1)
    positions_m = here.observations.positions_m.copy()
    positions_m[[3, 17, 30]] += 0.05
    found = identify_arm(here.model, replace(here.observations, positions_m=positions_m), options=_OPTIONS)
    assert list(found.rejected) == [3, 17, 30]
    assert rows_apart(found, np.arange(52)) == []
