"""A slide: its places along a line, its scale, and the round places to which it is sent."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.identification.level_fit import terms_of_level
from cellcal.calibration.identification.lints import rounding_floor
from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_slides import refuse_straight_line
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.parameters import GEAR, GEOMETRY, OFFSETS

TRACK = load_model(f"{Path(__file__).parents[1]}/data/descriptions/arm_on_track.urdf?base=world&tip=tool0")
ROWS = 25


def rows_along_the_track() -> PointObservations:
    travel = np.linspace(TRACK.lower_rad[0], TRACK.upper_rad[0], ROWS)
    joints = np.tile(0.3 * np.ones(TRACK.axis_count), (ROWS, 1))
    joints[:, 0] = travel
    noise = 3e-5 * np.random.default_rng(1).normal(size=(ROWS, 3))
    places = np.outer(travel, [0.6, 0.8, 0.0]) + noise
    return PointObservations(joints, places, np.full(ROWS, 3e-5), np.zeros(ROWS, dtype=np.intp))


def test_a_track_alone_is_told_what_its_rows_leave_open() -> None:
    with pytest.raises(DegenerateDataError, match="along one line") as refused:
        refuse_misfit(TRACK, rows_along_the_track(), search_models=False)
    assert "joints that turn" in refused.value.remedy


def test_rows_beside_a_line_have_other_causes() -> None:
    rows = rows_along_the_track()
    places = rows.positions_m + np.outer(np.linspace(-1, 1, ROWS) ** 2, [0.0, 0.0, 0.5])
    refuse_straight_line(TRACK, replace(rows, positions_m=places))


def test_the_scale_of_a_slide_is_geometry_from_three_places_on() -> None:
    joints = np.random.default_rng(1).uniform(TRACK.lower_rad, TRACK.upper_rad, (40, TRACK.axis_count))
    joints[:, 0] = np.arange(40) % 3
    (scale,) = terms_of_level(TRACK, joints, GEOMETRY)
    assert (scale.kind, scale.joint, scale.source) == ("gear", 0, 0)
    assert [term for term in terms_of_level(TRACK, joints, GEAR) if term == scale] == [scale]
    joints[:, 0] = np.arange(40) % 2
    assert not terms_of_level(TRACK, joints, GEOMETRY)
    assert not terms_of_level(TRACK, joints, OFFSETS)


def test_round_places_of_a_slide_are_no_rounding() -> None:
    joints = np.random.default_rng(1).uniform(TRACK.lower_rad, TRACK.upper_rad, (40, TRACK.axis_count))
    steps = np.where(np.arange(TRACK.axis_count) == 0, 0.5, 1e-8)
    assert rounding_floor(TRACK, joints, steps, 1e-7)
    joints[:, 0] = 0.5 * (np.arange(40) % 5)
    assert not rounding_floor(TRACK, joints, steps, 1e-7)
