"""Rows in which only a slide moves: places along a line are no misfit, and no joint is to be described otherwise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_slides import refuse_straight_line
from cellcal.calibration.identification.observations import PointObservations

TRACK = load_model(f"{Path(__file__).parents[1]}/data/descriptions/arm_on_track.urdf?base=world&tip=tool0")
ROWS = 25


def rows_along_the_track() -> PointObservations:
    travel = np.linspace(TRACK.lower_rad[0], TRACK.upper_rad[0], ROWS)
    joints = np.tile(0.3 * np.ones(TRACK.axis_count), (ROWS, 1))
    joints[:, 0] = travel
    noise = 3e-5 * np.random.default_rng(1).normal(size=(ROWS, 3))
    places = np.outer(travel, [0.6, 0.8, 0.0]) + [1.0, -2.0, 0.5] + noise
    return PointObservations(joints, places, np.full(ROWS, 3e-5), np.zeros(ROWS, dtype=np.intp))


def test_a_track_alone_is_told_what_its_rows_leave_open() -> None:
    with pytest.raises(DegenerateDataError, match="along one line") as refused:
        refuse_misfit(TRACK, rows_along_the_track(), search_models=False)
    assert "joints that turn" in refused.value.remedy


def test_rows_beside_a_line_have_other_causes() -> None:
    rows = rows_along_the_track()
    places = rows.positions_m + np.outer(np.linspace(-1, 1, ROWS) ** 2, [0.0, 0.0, 0.5])
    refuse_straight_line(TRACK, replace(rows, positions_m=places))
