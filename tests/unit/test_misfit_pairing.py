"""Joints and measured values that belong together in another order are refused with that order."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.misfit_fit import fit_quickly
from cellcal.calibration.identification.misfit_pairing import pairing_causes
from tests.unit.helpers.simulated_arm import tracker_points, wire_lengths

ROWS = 64
AT = np.arange(ROWS)


def refusal(order, robot, seed):
    """Return the refusal of rows whose measured values stand in this order."""
    simulated = tracker_points(robot, ROWS, seed=seed)
    true = simulated.observations
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(simulated.model, replace(true, positions_m=true.positions_m[order]))
    return refused.value


# an arm of six joints and one of seven, in turns
@pytest.mark.parametrize(
    ("robot", "seed", "order", "says"),
    [
        ("ur10", 1, AT[::-1], "reverse order"),
        ("franka_fer", 2, np.roll(AT, ROWS // 2), "the first 32 rows belong to the joints of the last 32"),
        ("ur10", 1, np.roll(AT, 20), "the first 20 rows belong to the joints of the last 20"),
        (
            "franka_fer",
            2,
            np.r_[AT[:25], AT[26:], AT[-1]],
            "from row 25 on .* joints that stand 1 further down",
        ),
        ("ur10", 1, np.r_[AT[:40], AT[39:-1]], "from row 40 on .* joints that stand 1 further up"),
        (
            "franka_fer",
            2,
            np.r_[AT[:20], AT[22:], AT[-2:]],
            "from row 20 on .* joints that stand 2 further down",
        ),
    ],
    ids=["reversed", "halves", "parts", "reading missing", "reading too many", "two missing"],
)
def test_the_order_in_which_rows_fit_is_named(robot, seed, order, says):
    refused = refusal(order, robot, seed)
    assert refused.causes[0].kinds == ("rows",)
    assert says.split(" .* ")[0] in str(refused)
    assert says.split(" .* ")[-1] in str(refused)


def test_measured_values_that_were_sorted_are_asked_for():
    simulated = tracker_points("ur10", ROWS)
    refused = refusal(np.argsort(simulated.observations.positions_m[:, 1]), "ur10", 1)
    assert not refused.causes
    assert "The measured Y only rises or falls" in refused.remedy


def test_an_order_that_nothing_proves_is_not_named():
    refused = refusal(np.random.default_rng(0).permutation(ROWS), "ur10", 1)
    assert not refused.causes
    assert "belong together" in refused.remedy


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda q: np.where(np.arange(6) == 0, 0.5, q), "is the same in all rows"),
        (lambda q: np.where(np.arange(6) == 4, np.abs(q), q), "is never negative"),
    ],
    ids=["constant", "lost minus"],
)
def test_a_joint_that_strikes_is_asked_for(spoil, says):
    simulated = tracker_points("ur10", ROWS)
    true = simulated.observations
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(simulated.model, replace(true, joints_rad=spoil(true.joints_rad)))
    assert says in refused.value.remedy


@pytest.mark.parametrize(
    ("order", "says"),
    [
        (AT[::-1], "reverse order"),
        (np.roll(AT, 20), "the first 20 rows belong to the joints of the last 20"),
        (np.r_[AT[:25], AT[26:], AT[-1]], "joints that stand 1 further down"),
        pytest.param(np.r_[AT[:40], AT[39:-1]], "joints that stand 1 further up", marks=pytest.mark.soak),
    ],
    ids=["reversed", "parts", "reading missing", "reading too many"],
)
def test_the_order_of_lengths_is_named(order, says):
    simulated = wire_lengths(count=ROWS)
    true = simulated.observations
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(simulated.model, replace(true, lengths_m=true.lengths_m[order]))
    assert refused.value.causes[0].kinds == ("rows",)
    assert says in str(refused.value)


def test_shuffled_lengths_have_no_order():
    simulated = wire_lengths(count=ROWS)
    true = simulated.observations
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(ROWS)
        shuffled = replace(true, lengths_m=true.lengths_m[order])
        assert pairing_causes(simulated.model, shuffled, fit_quickly, 0.01) == ()


@pytest.mark.parametrize("joint", [0, 2])
def test_a_column_that_is_no_joints_is_asked_for(joint):
    simulated = tracker_points("ur10", ROWS)
    true, rail = simulated.observations, np.random.default_rng(1).uniform(-1500.0, 3000.0, ROWS)
    joints = np.where(np.arange(6) == joint, np.deg2rad(rail)[:, None], true.joints_rad)
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(simulated.model, replace(true, joints_rad=joints))
    name = simulated.model.joint_names[joint]
    assert f"{name} moves through 4" in refused.value.remedy
    assert "another joint, or of a track" in refused.value.remedy
