"""The integer search against brute force, and its probability against what happens."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.mastering.integer_search import search_integers, success_probability


def draw_covariance(seed, size, scale):
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(size, size)) * 10.0 ** rng.uniform(-1, 0.3, size)
    return scale**2 * (mixing @ mixing.T + 1e-4 * np.eye(size))


def brute_force(estimate, matrix, reach):
    weight = np.linalg.inv(matrix)
    around = np.rint(estimate)
    grid = around + np.array(list(itertools.product(range(-reach, reach + 1), repeat=len(estimate))))
    distances = np.einsum("ij,jk,ik->i", grid - estimate, weight, grid - estimate)
    order = np.argsort(distances)[:2]
    return grid[order], distances[order]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3), st.floats(0.05, 0.6))
def test_the_two_nearest_are_those_of_brute_force(seed, size, scale):
    matrix = draw_covariance(seed, size, scale)
    estimate = np.random.default_rng(seed + 1).uniform(-30, 30, size)
    _, distances = brute_force(estimate, matrix, 20 if size < 3 else 12)
    fix = search_integers(estimate, matrix)
    assert fix.best_distance <= distances[0] * (1 + 1e-9)
    assert fix.second_distance <= distances[1] * (1 + 1e-9)
    weight = np.linalg.inv(matrix)
    for point, found in ((fix.best, fix.best_distance), (fix.second, fix.second_distance)):
        away = np.array(point) - estimate
        assert away @ weight @ away == pytest.approx(found, rel=1e-6, abs=1e-9)


def test_strong_correlation_defeats_rounding_but_not_the_search():
    rng = np.random.default_rng(5)
    matrix = 0.5 * np.outer([1.0, 0.618], [1.0, 0.618]) + 0.003 * np.eye(2)
    truth = np.array([7.0, -4.0])
    draws = truth + rng.multivariate_normal([0, 0], matrix, 500)
    searched = np.mean([search_integers(draw, matrix).best == (7, -4) for draw in draws])
    rounded = np.mean((np.rint(draws) == truth).all(axis=1))
    assert searched > rounded + 0.2


def test_the_success_probability_is_a_lower_bound_that_is_not_idle():
    rng = np.random.default_rng(11)
    matrix = draw_covariance(3, 6, 0.12)
    bound = success_probability(matrix)
    draws = rng.multivariate_normal(np.zeros(6), matrix, 600)
    rate = np.mean([search_integers(draw, matrix).best == (0,) * 6 for draw in draws])
    assert rate >= bound - 3 * np.sqrt(0.25 / 600)
    assert rate - bound < 0.25


def test_independent_unknowns_round_and_their_probability_is_the_textbook_one():
    fix = search_integers(np.array([2.2, -0.9]), np.diag([0.15**2, 0.15**2]))
    assert fix.best == (2, -1)
    assert fix.second == (3, -1) or fix.second == (2, -1 + 1) or fix.second == (2, -2)
    assert fix.success_probability == pytest.approx(0.99914**2, abs=2e-5)  # 0.15 cycle: 99.9 % each
    assert fix.distance_ratio > 3


def test_adding_integers_moves_the_answer_by_them():
    matrix = draw_covariance(8, 6, 0.1)
    estimate = np.random.default_rng(2).uniform(-1, 1, 6)
    shift = np.array([40, -3, 0, 17, -25, 8])
    plain, moved = search_integers(estimate, matrix), search_integers(estimate + shift, matrix)
    assert tuple(np.array(plain.best) + shift) == moved.best
    assert moved.best_distance == pytest.approx(plain.best_distance)


def test_nothing_to_search_is_certain_and_a_singular_covariance_is_refused():
    assert search_integers(np.zeros(0), np.zeros((0, 0))).success_probability == 1.0
    with pytest.raises(DegenerateDataError):
        search_integers(np.zeros(2), np.array([[1.0, 1.0], [1.0, 1.0]]))


def test_hopeless_geometry_still_ends():
    matrix = np.diag([25.0, 9.0, 16.0, 4.0, 30.0, 50.0]) + 3.0
    fix = search_integers(np.full(6, 0.4), matrix)
    assert fix.success_probability < 1e-3
    assert len(fix.best) == 6
