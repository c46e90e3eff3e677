"""Readings in the long tail of an arm's errors count in what `--at` states, and mistakes do not."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification.error_tails import tail_reach
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.parameters import GEOMETRY
from cellcal.calibration.identification.reading_prediction import predict_readings
from cellcal.calibration.identification.selection import IdentificationOptions
from tests.unit.helpers.simulated_arm import random_joints, tracker_points

NOISE_M = 5e-5
LIMIT = 4.6


def sizes_of(dice, count, channels):
    return np.linalg.norm(dice.standard_normal((count, channels)), axis=1)


@pytest.mark.parametrize("channels", [3, 6])
@pytest.mark.parametrize("freedom", [2.0, 3.0])
def test_a_long_tail_is_told_and_reaches_over_nearly_all_of_its_rows(channels, freedom):
    dice = np.random.default_rng(1)
    beyond = 0
    for _ in range(20):
        sizes = sizes_of(dice, 300, channels) / np.sqrt(dice.chisquare(freedom, 300) / freedom)
        reach = tail_reach(sizes, channels, int((sizes > LIMIT).sum()))
        assert reach > LIMIT
        beyond += int((sizes > reach).sum())
    assert beyond <= 6


@pytest.mark.parametrize("channels", [1, 3, 6])
@pytest.mark.parametrize("share", [0.0, 0.06, 0.15])
@pytest.mark.parametrize("away", [12.0, 40.0, 300.0])
def test_mistakes_among_normal_errors_are_no_tail(channels, share, away):
    dice = np.random.default_rng(2)
    for count in (40, 120, 400):
        for _ in range(10):
            sizes = sizes_of(dice, count, channels)
            wrong = dice.random(count) < share
            sizes[wrong] += away * np.exp(0.4 * dice.standard_normal(int(wrong.sum())))
            assert tail_reach(sizes, channels, int((sizes > LIMIT).sum())) == 0.0


def _inside(seed, noise):
    """Return the share of further readings within what is stated, and how many rejected rows counted."""
    model = load_model("ur10")
    simulated, dice = tracker_points("ur10", 300, seed=seed, sigma_m=1e-7), np.random.default_rng(seed)
    measured = simulated.observations.positions_m + noise(dice, 300)
    found = identify_arm(
        model,
        replace(simulated.observations, positions_m=measured),
        options=IdentificationOptions(level=GEOMETRY, find_breaks=False),
    )
    joints = random_joints(model, dice, 500)
    readings = simulated.truth.seen_from(0).base_flange(joints)[:, :3, 3] + noise(dice, 500)
    prediction = predict_readings(found, joints)
    away = np.linalg.norm(readings - prediction.positions_m, axis=1)
    return float((away < prediction.expanded_m).mean()), prediction.model_error.tail_rows


def _heavy(dice, count):
    return NOISE_M * dice.standard_normal((count, 3)) / np.sqrt(dice.chisquare(2.0, (count, 1)) / 2.0)


def test_what_is_stated_holds_with_heavy_tails():
    shares, counted = zip(*(_inside(seed, _heavy) for seed in range(6)), strict=True)
    assert min(counted) > 10
    assert 0.935 < np.mean(shares) < 0.97


def _spoilt(dice, count):
    wrong = (dice.random((count, 1)) < 0.06) & (count == 300)
    return NOISE_M * (
        dice.standard_normal((count, 3)) + wrong * dice.uniform(20.0, 60.0) * dice.standard_normal((count, 3))
    )


def test_what_is_stated_is_not_widened_by_mistakes():
    shares, counted = zip(*(_inside(seed, _spoilt) for seed in range(6)), strict=True)
    assert sum(counted) == 0
    assert 0.935 < np.mean(shares) < 0.975
