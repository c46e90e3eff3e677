"""Fits write into memory that their thread keeps: neither fits before them nor fits beside them may show."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from cellcal.calibration.identification.estimator import FitProblem, errors_m, estimate_arm, place_columns
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.parameters import GEOMETRY
from tests.unit.helpers.simulated_arm import tracker_points, tracker_poses


def fit_simulated(simulate, count, seed, weights=None):
    simulated = simulate(count=count, seed=seed)
    start = first_guess(simulated.model, simulated.observations)[0]
    layout = make_layout(simulated.model, simulated.observations.kind, 1, level=GEOMETRY)
    problem = FitProblem.from_observations(start, simulated.observations)
    return estimate_arm(layout, start, problem, weights, from_afar=True), problem


def test_fits_beside_each_other_and_after_each_other_are_the_same():
    cases = [(tracker_points, 40 + 300 * (seed % 3), seed) for seed in range(12)]
    cases += [(tracker_poses, 30, seed) for seed in range(4)]
    alone = [fit_simulated(*case)[0] for case in cases]
    with ThreadPoolExecutor(4) as pool:
        beside = [fit for fit, _ in pool.map(lambda case: fit_simulated(*case), cases * 3)]
    for i, fit in enumerate(beside):
        assert np.array_equal(fit.covariance, alone[i % len(cases)].covariance)
        assert np.array_equal(fit.state.geometry, alone[i % len(cases)].state.geometry)


def test_what_was_returned_is_not_written_over():
    fit, problem = fit_simulated(tracker_points, 60, 1)
    columns, residuals = place_columns(fit.layout, fit.state, problem)
    copies = columns.copy(), residuals.copy(), errors_m(fit.state, problem)
    fit_simulated(tracker_points, 60, 2)
    assert np.array_equal(columns, copies[0])
    assert np.array_equal(residuals, copies[1])
    assert np.array_equal(errors_m(fit.state, problem), copies[2])


@pytest.mark.parametrize("simulate", [tracker_points, tracker_poses])
def test_a_row_of_weight_zero_is_as_if_it_were_not_there_and_of_weight_four_as_of_half_the_sigma(simulate):
    count = 50
    weights = np.where(np.arange(count) % 5 == 0, 0.0, 1.0)
    fit, problem = fit_simulated(simulate, count, 3, weights)
    again = estimate_arm(fit.layout, fit.state, problem, weights)
    less = estimate_arm(fit.layout, fit.state, problem.select_rows(np.flatnonzero(weights)))
    assert relative_difference(information_by_rows(again), information_by_rows(less)) < 1e-5
    four = estimate_arm(fit.layout, fit.state, problem, np.full(count, 4.0))
    assert (
        relative_difference(
            information_by_rows(four), 4.0 * information_by_rows(estimate_arm(fit.layout, fit.state, problem))
        )
        < 1e-5
    )


def information_by_rows(fit):
    """Return the information of the rows alone, in prior deviations."""
    prior = fit.layout.prior_sigmas
    return np.linalg.inv(fit.covariance / np.outer(prior, prior)) - np.eye(len(prior))


def relative_difference(information, other):
    size = np.sqrt(np.diag(other))
    return np.abs((information - other) / np.outer(size, size)).max()
