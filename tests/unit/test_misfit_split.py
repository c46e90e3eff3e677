"""A device that was moved far within the series is named with the rows before and behind."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.calibration.identification.misfit import refuse_gross_misfit
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.misfit_split import find_split
from cellcal.calibration.orientation import elementary_rotation
from tests.unit.helpers.simulated_arm import tracker_points

TRUE = tracker_points("abb_irb120", 40)
MOVED = homogeneous_matrix(elementary_rotation("z", np.array(0.7)), np.array([0.5, -0.8, 0.1]))


def moved_from(row: int):
    places = TRUE.observations.positions_m.copy()
    places[row:] = places[row:] @ MOVED[:3, :3].T + MOVED[:3, 3]
    return replace(TRUE.observations, positions_m=places)


@pytest.mark.parametrize("row", [9, 22, 31])
def test_a_far_move_of_the_device_is_found_at_its_row(row: int) -> None:
    assert find_split(TRUE.model, moved_from(row), 5e-3) == row


def test_the_refusal_names_both_parts() -> None:
    with pytest.raises(MisfitError, match="the first 22 usable rows and the 18 behind them"):
        refuse_gross_misfit(TRUE.model, moved_from(22), np.full(40, 0.5))


def test_rows_in_any_order_have_no_split() -> None:
    shuffled = np.random.default_rng(1).permutation(40)
    wrong = replace(TRUE.observations, positions_m=TRUE.observations.positions_m[shuffled])
    assert find_split(TRUE.model, wrong, 5e-3) is None
    with pytest.raises(MisfitError, match="no known cause"):
        refuse_gross_misfit(TRUE.model, wrong, np.full(40, 0.5))
