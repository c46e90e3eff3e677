"""A part of a file in another unit is named as the cause; sound rows and other faults are not."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.observations import PointObservations
from tests.unit.helpers.simulated_arm import tracker_points

INCH_M = 0.0254


def rows_of(robot, seed):
    simulated = tracker_points(robot, 40, seed=seed)
    measured = simulated.observations
    once = np.zeros(len(measured), dtype=np.intp)
    return simulated.model, PointObservations(
        measured.joints_rad, measured.positions_m + np.array([1.5, -2.0, 0.3]), measured.sigma_m, once
    )


def changed(measured, rows, *, joints=1.0, places=1.0):
    scaled = np.isin(np.arange(len(measured)), rows)[:, None]
    return PointObservations(
        np.where(scaled, measured.joints_rad * joints, measured.joints_rad),
        np.where(scaled, measured.positions_m * places, measured.positions_m),
        measured.sigma_m,
        measured.mounting,
    )


CASES = {
    "metres below millimetres": (
        range(25, 40),
        {"places": 1e-3},
        "positions",
        "in m and of the others in mm",
    ),
    "millimetres taken for metres": (range(14), {"places": 1e3}, "positions", "in m and of the others in mm"),
    "inches": (range(0, 40, 2), {"places": 1e-3 / INCH_M}, "positions", "in inch and of the others in mm"),
    "radians below degrees": (
        range(22, 40),
        {"joints": np.pi / 180.0},
        "joints",
        "in rad and of the others in deg",
    ),
}


@pytest.mark.parametrize("robot", ["ur10", "kuka_kr6_r900"])
@pytest.mark.parametrize("case", CASES)
def test_the_other_unit_of_a_part_is_named(robot, case):
    rows, wrong, what, words = CASES[case]
    model, measured = rows_of(robot, 1)
    with pytest.raises(MisfitError, match=words) as refused:
        refuse_misfit(model, changed(measured, list(rows), **wrong), search_models=False)
    assert what in refused.value.message
    assert refused.value.causes[0].kinds == ("mixed",)


def test_sound_rows_pass_and_strange_ones_are_not_called_mixed():
    model, measured = rows_of("ur10", 5)
    refuse_misfit(model, measured)
    order = np.random.default_rng(3).permutation(len(measured))
    shuffled = replace(measured, positions_m=measured.positions_m[order])
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(model, changed(shuffled, list(range(20, 40)), places=1e-3), search_models=False)
    assert ("mixed",) not in [cause.kinds for cause in refused.value.causes]
