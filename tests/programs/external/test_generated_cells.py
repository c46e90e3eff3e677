"""A slice of `make soak ARGS=external_axes.abb`: generated programs with external axes and standing tools."""

from dataclasses import replace

import pytest

from tests.programs.external.brands import BRANDS
from tests.programs.external.campaign import ExternalTally, find_wrong_point, generate_cell, try_cell


@pytest.mark.parametrize("name", BRANDS)
def test_every_point_is_right_or_left_and_named(name: str) -> None:
    tally = ExternalTally()
    for seed in range(60):
        try_cell(name, seed, tally)
    assert not tally.wrong
    assert tally.changed > 50
    assert tally.left_points > 50


@pytest.mark.parametrize("name", BRANDS)
def test_the_calculation_sees_points_that_did_not_move(name: str) -> None:
    for seed in range(10):
        made = generate_cell(name, seed)
        for point in made.points:
            assert find_wrong_point(made, point, point, left=False)
            assert not find_wrong_point(made, point, point, left=True)
            assert find_wrong_point(made, point, replace(point, axes={"E9": 1.0}), left=True)
