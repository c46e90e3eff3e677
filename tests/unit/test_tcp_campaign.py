"""Tools taught by hand, six attitudes to 60 degrees: a slice of the campaign ``tcp``, which has two thousand."""

import numpy as np

from tests.soak.tcp import MOST_MEDIAN_M, SIX, UNTIL_ENOUGH, teach_tool

RUNS = 40
LEAST_INSIDE = 33  # of 40 at 95 %: fewer, one time in ten thousand


def test_six_attitudes_find_the_tip_and_u_holds_it():
    taught = [teach_tool(seed, SIX) for seed in range(RUNS)]
    assert np.median([one.error_m for one in taught]) <= MOST_MEDIAN_M
    assert sum(one.is_inside for one in taught) >= LEAST_INSIDE
    assert (
        sum(one.error_m <= 0.5 * one.u_m for one in taught) < LEAST_INSIDE
    )  # and U is no larger than it must be


def test_it_stops_sooner_than_a_fixed_plan_and_within_the_class():
    taught = [teach_tool(seed, UNTIL_ENOUGH) for seed in range(8)]
    assert all(one.u_m <= 0.0004 for one in taught)
    assert sum(one.touches for one in taught) < 0.75 * sum(one.fixed_plan for one in taught)
