"""Mountings that are worked on together give the equations that each gives alone."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.geometry import exp_twist
from cellcal.calibration.identification.estimator import FitProblem, place_columns, whitened_residuals
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import DevicePlacement, with_mounting
from cellcal.calibration.identification.parameters import GEOMETRY
from tests.unit.helpers.simulated_arm import ANCHOR, TRACKER, tracker_points, tracker_poses, wire_lengths

_STARTS = (0, 20, 45, 70)


def mounted(simulate, **options):
    """Return rows in four mountings, a state with a device for each, and the layout."""
    simulated = simulate(count=90, **options)
    mounting = np.searchsorted(_STARTS, np.arange(90), side="right") - 1
    rows, state = with_mounting(simulated.observations, mounting), simulated.truth
    shifts = [exp_twist(np.array([0.01 * k, 0.0, 0.002 * k, 0.0, 0.01 * k, 0.0])) for k in range(4)]
    if rows.kind == "length":
        devices = [DevicePlacement(np.eye(4), ANCHOR + shift[:3, 3], 1e-3, 1.001) for shift in shifts]
    else:
        devices = [DevicePlacement(TRACKER @ shift, np.zeros(3)) for shift in shifts]
    state = replace(state, devices=tuple(devices))
    return rows, state, make_layout(simulated.model, rows.kind, 4, level=GEOMETRY)


@pytest.mark.parametrize("simulate", [tracker_points, tracker_poses, wire_lengths])
def test_joined_mountings_give_the_equations_that_each_gives_alone(simulate) -> None:
    rows, state, layout = mounted(simulate)
    problem = FitProblem.from_observations(state, rows)
    assert len(problem.spans_at(state)) == 1
    alone = replace(problem)
    alone.__dict__["joined_blocks"] = tuple((block,) for block in problem.blocks)
    assert len(alone.spans_at(state)) == 4
    for together, each in zip(
        place_columns(layout, state, problem), place_columns(layout, state, alone), strict=True
    ):
        np.testing.assert_allclose(together, each, rtol=1e-11, atol=1e-9)
    np.testing.assert_allclose(
        whitened_residuals(state, problem), whitened_residuals(state, alone), rtol=1e-9, atol=1e-7
    )


def test_gauges_of_different_scale_are_not_taken_for_one() -> None:
    rows, state, layout = mounted(wire_lengths)
    second = replace(state.devices[1], scale=1.5)
    changed = replace(state, devices=(state.devices[0], second, *state.devices[2:]))
    problem = FitProblem.from_observations(state, rows)
    residuals = whitened_residuals(changed, problem)
    alone = problem.select_rows(np.arange(20, 45))
    np.testing.assert_allclose(residuals[:, 20:45], whitened_residuals(changed, alone), rtol=1e-9)
    columns = place_columns(layout, changed, problem)[0]
    np.testing.assert_allclose(
        columns[:, :, 20:45], place_columns(layout, changed, alone)[0], rtol=1e-9, atol=1e-9
    )


def test_mountings_in_turn_are_not_joined() -> None:
    rows, state, _ = mounted(tracker_points)
    in_turn = with_mounting(rows, np.arange(90) % 4)
    problem = FitProblem.from_observations(state, in_turn)
    assert len(problem.spans_at(state)) == 4
    one = problem.select_rows(np.arange(1, 90, 4))
    np.testing.assert_allclose(
        whitened_residuals(state, problem)[:, 1::4], whitened_residuals(state, one), rtol=1e-9, atol=1e-7
    )
