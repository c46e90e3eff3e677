"""A part of a series whose rows stand in another order is named, not only left out."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.identification.exchanged_rows import exchanged_rows
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.parameters import GEOMETRY
from cellcal.calibration.identification.selection import IdentificationOptions
from tests.unit.helpers.simulated_arm import tracker_points, wire_lengths

ROWS = 120
AT = np.arange(ROWS)
BLOCK = slice(40, 52)
ORDERS = {
    "reversed": np.r_[AT[:40], AT[BLOCK][::-1], AT[52:]],
    "shuffled": np.r_[AT[:40], 40 + np.random.default_rng(3).permutation(12), AT[52:]],
    "displaced": np.r_[AT[:40], AT[41:52], AT[40], AT[52:]],
    "two exchanged": np.r_[AT[:40], 70, AT[41:70], 40, AT[71:]],
    "stale": np.r_[AT[:40], 39, 39, 39, AT[43:]],
}


def notes_of(simulated, observations):
    found = identify_arm(
        simulated.model,
        observations,
        options=IdentificationOptions(level=GEOMETRY, find_breaks=False, judge=False),
    )
    return found, exchanged_rows(found, 1000 + AT)


@pytest.mark.parametrize("order", ORDERS.values(), ids=ORDERS)
@pytest.mark.parametrize("robot", ["ur10", "fanuc_m6ib"])
def test_rows_in_another_order_are_named_with_the_joints_that_fit(order, robot):
    simulated = tracker_points(robot, ROWS)
    true = simulated.observations
    _, (note,) = notes_of(simulated, replace(true, positions_m=true.positions_m[order]))
    moved = np.flatnonzero(order != AT)
    assert set(note.rows) <= set((1000 + moved).tolist())
    assert len(note.rows) >= 0.8 * len(moved)
    first = note.rows[0] - 1000
    assert f"that of row {1000 + first} to row {1000 + order[first]}" in note.message


def test_lengths_in_another_order_are_named():
    simulated = wire_lengths(count=ROWS)
    true = simulated.observations
    _, notes = notes_of(simulated, replace(true, lengths_m=true.lengths_m[ORDERS["reversed"]]))
    assert [note.code for note in notes] == ["exchanged"]


@pytest.mark.parametrize("simulate", [tracker_points, wire_lengths])
def test_mistakes_are_not_taken_for_another_order(simulate):
    simulated = simulate(count=ROWS)
    true = simulated.observations
    for seed in range(4):
        dice = np.random.default_rng(seed)
        wrong = (dice.random(ROWS) < 0.08) * dice.uniform(3e-3, 0.3, ROWS)
        if hasattr(true, "lengths_m"):
            spoilt = replace(true, lengths_m=true.lengths_m + wrong)
        else:
            spoilt = replace(true, positions_m=true.positions_m + wrong[:, None] * [0.6, 0.0, 0.8])
        found, notes = notes_of(simulated, spoilt)
        assert len(found.rejected) > 2
        assert notes == []
