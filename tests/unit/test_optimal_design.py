"""Choosing blocks of rows: against brute force, against a bound, and where numbers get thin."""

from itertools import combinations

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.poses.optimal_design import DesignTask, choose_blocks, design_efficiency, upper_bound


def task_of(seed, p=4, m=2, count=12, interest=None, prior_information=1e-3):
    rng = np.random.default_rng(seed)
    return DesignTask(rng.normal(size=(p, m, count)), prior_information * np.eye(p), interest)


def best_value(task, k):
    return max(
        task.criterion_value(task.information_of(np.array(c)))
        for c in combinations(range(task.candidate_count), k)
    )


@pytest.mark.parametrize("kind", ["determinant", "trace"])
def test_small_problems_are_solved_nearly_as_well_as_by_trying_everything(kind):
    interest = None if kind == "determinant" else np.eye(4)[:, :3]
    reached = []
    for seed in range(12):
        task = task_of(seed, interest=interest)
        found, best = choose_blocks(task, 4, starts=5), best_value(task, 4)
        assert found.value <= best + 1e-9
        reached.append(np.exp(found.value - best) if interest is None else best / found.value)
    assert min(reached) > 0.9
    assert np.median(reached) > 0.999


@pytest.mark.parametrize("kind", ["determinant", "trace"])
def test_nothing_exceeds_the_bound_and_the_bound_is_near(kind):
    interest = None if kind == "determinant" else np.eye(4)
    for seed in range(6):
        task = task_of(seed, interest=interest)
        bound, best = upper_bound(task, 4), best_value(task, 4)
        assert best <= bound + 1e-9
        assert bound - best < (1.0 if interest is None else 0.5 * abs(best))


def test_no_single_exchange_improves_a_choice():
    task = task_of(3, p=6, m=3, count=60)
    found = choose_blocks(task, 8)
    for place in range(8):
        for other in set(range(60)) - set(found.indices):
            changed = [*found.indices]
            changed[place] = other
            assert task.criterion_value(task.information_of(np.array(changed))) <= found.value + 1e-7


def test_the_value_is_that_of_the_choice_and_nothing_is_chosen_twice():
    task = task_of(4, p=6, m=3, count=80, interest=np.eye(6))
    found = choose_blocks(task, 10)
    assert len(set(found.indices)) == 10
    information = task.information_of(np.array(found.indices))
    assert found.value == pytest.approx(-np.trace(np.linalg.inv(information)), rel=1e-9)


def test_the_first_are_those_that_tell_most():
    task = task_of(5, p=4, m=1, count=40)
    few, many = choose_blocks(task, 12).indices[:6], choose_blocks(task, 12).indices[6:]
    assert task.criterion_value(task.information_of(np.array(few))) > task.criterion_value(
        task.information_of(np.array(many))
    )


def test_what_is_known_already_is_not_measured_again():
    columns = np.zeros((2, 1, 4))
    columns[0, 0, :2], columns[1, 0, 2:] = 1.0, 0.5
    prior_information = np.diag([100.0, 1e-3])
    assert set(choose_blocks(DesignTask(columns, prior_information), 2).indices) == {2, 3}
    assert set(choose_blocks(DesignTask(columns, prior_information[::-1, ::-1]), 2).indices) == {0, 1}


def test_only_what_is_of_interest_is_made_small():
    columns = np.zeros((2, 1, 4))
    columns[0, 0, :2], columns[1, 0, 2:] = 10.0, 0.1
    interest = np.array([[0.0], [1.0]])
    assert set(choose_blocks(DesignTask(columns, np.eye(2), interest), 2).indices) == {2, 3}


def test_fewer_rows_than_unknowns_lean_on_what_is_known():
    task = task_of(6, p=20, m=3, count=100, prior_information=1e-8)
    found = choose_blocks(task, 2)
    assert np.isfinite(found.value)
    assert found.value == pytest.approx(task.criterion_value(task.information_of(np.array(found.indices))))


def test_a_direction_that_one_block_alone_shows_survives_its_removal():
    rng = np.random.default_rng(7)
    columns = rng.normal(size=(5, 3, 40))
    columns[4, :, 1:] = 0.0
    columns[4, :, 0] = 1e4
    task = DesignTask(columns, np.diag([1e-3] * 4 + [1e-7]))
    assert 0 in choose_blocks(task, 4).indices


def test_all_are_chosen_if_there_are_no_more():
    task = task_of(8, count=5)
    assert sorted(choose_blocks(task, 9).indices) == [0, 1, 2, 3, 4]


def test_a_choice_is_reproducible_by_seed():
    task = task_of(9, p=6, m=3, count=60)
    assert choose_blocks(task, 8, seed=4).indices == choose_blocks(task, 8, seed=4).indices


def test_a_designed_choice_beats_every_random_one_and_tells_how_good_it_is():
    rng = np.random.default_rng(10)
    task = task_of(10, p=8, m=3, count=200, interest=np.eye(8))
    found = choose_blocks(task, 12)
    drawn = [
        task.criterion_value(task.information_of(rng.choice(200, 12, replace=False))) for _ in range(100)
    ]
    assert found.value > max(drawn)
    assert 0.8 < design_efficiency(task, found, rank=8) <= 1.0


def test_impossible_tasks_are_refused():
    with pytest.raises(CalibrationError, match="do not fit"):
        DesignTask(np.zeros((3, 1, 4)), np.eye(2))
    with pytest.raises(CalibrationError, match="finite"):
        DesignTask(np.full((2, 1, 4), np.nan), np.eye(2))
    with pytest.raises(DegenerateDataError, match="prior"):
        choose_blocks(DesignTask(np.zeros((2, 1, 4)), np.zeros((2, 2))), 1)
    with pytest.raises(CalibrationError, match="at least one"):
        choose_blocks(task_of(1), 0)
