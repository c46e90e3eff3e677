"""What `--at` states holds: readings that no fit has seen, real ones included, are inside as often as said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.identification.cross_validation import group_rows
from cellcal.calibration.identification.held_out_regions import posture_regions
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.model_error import HeldOutErrors, model_error
from cellcal.calibration.identification.observations import PoseObservations
from cellcal.calibration.identification.parameters import GEOMETRY, GRAVITY
from cellcal.calibration.identification.reading_prediction import predict_readings
from cellcal.calibration.identification.selection import IdentificationOptions
from cellcal.calibration.identification.tip_uncertainty import tip_slopes
from cellcal.calibration.uncertainty import coverage_in_space, coverage_in_space_of
from cellcal.service.engineering.identification.identify_check import prepare_measurements
from cellcal.service.engineering.measured.measurements import ReadOptions
from tests.unit.helpers.simulated_arm import random_joints, tracker_points, wire_lengths

UR10 = load_model("ur10")
PUBLISHED = Path(__file__).parents[1] / "data" / "ipa_ur10"
SERIES = {
    "B": PUBLISHED / "series_b_joint_configurations.csv",
    "C": PUBLISHED / "series_c_random_poses_first_1400.csv",
}


def predict_others(rows, fitted, others, **options):
    found = identify_arm(
        UR10, rows.select_rows(fitted), options=IdentificationOptions(find_breaks=False, **options)
    )
    test = rows.select_rows(others)
    predictions = predict_readings(found, test.joints_rad)
    missed = np.linalg.norm(test.positions_m - predictions.positions_m, axis=1)
    return found, predictions, missed


@pytest.mark.parametrize("series", ["B", "C"])
@pytest.mark.parametrize("residual_model", [False, True])
def test_held_out_rows_of_a_real_arm_are_inside_what_is_stated(series, residual_model):
    rows = prepare_measurements(SERIES[series], UR10, ReadOptions()).observations
    order = np.random.default_rng(3).permutation(len(rows))
    fitted, others = np.sort(order[:200]), order[200:]
    _, predictions, missed = predict_others(
        rows, fitted, others, level=GRAVITY, residual_model=residual_model
    )
    inside = missed < predictions.expanded_m
    assert 0.9 < inside.mean() < 0.99
    assert (
        inside.mean() > 3 * (missed < predictions.parameters_expanded_m).mean()
    )  # the parameters alone promise too much
    assert np.median(predictions.expanded_m) < 1.5 * np.percentile(missed, 95)


@pytest.mark.parametrize(("series", "joint"), [("B", 1), ("C", 1), ("C", 3)])
def test_half_of_a_joints_range_does_not_promise_the_other_half(series, joint):
    rows = prepare_measurements(SERIES[series], UR10, ReadOptions()).observations
    some = rows.select_rows(np.arange(0, len(rows), 3))
    angle = some.joints_rad[:, joint]
    below, above = np.flatnonzero(angle < np.median(angle)), np.flatnonzero(angle >= np.median(angle))
    _, predictions, missed = predict_others(some, below, above, level=GRAVITY)
    assert (missed < predictions.expanded_m).mean() > 0.9
    assert predictions.far.mean() > 0.5


def test_with_a_complete_model_95_percent_are_95_percent():
    inside, alone = [], []
    for seed in range(12):
        simulated = tracker_points("ur10", 70, seed=seed)
        found = identify_arm(
            UR10, simulated.observations, options=IdentificationOptions(level=GEOMETRY, find_breaks=False)
        )
        rng = np.random.default_rng(100 + seed)
        joints = random_joints(UR10, rng, 200)
        truth = simulated.truth.seen_from(0).base_flange(joints)[:, :3, 3]
        predictions = predict_readings(found, joints)
        read = truth + 5e-5 * rng.standard_normal((200, 3))
        inside.append(
            float((np.linalg.norm(read - predictions.positions_m, axis=1) < predictions.expanded_m).mean())
        )
        off = np.linalg.norm(truth - predictions.positions_m, axis=1)
        alone.append(float((off < predictions.parameters_expanded_m).mean()))
    assert 0.935 < np.mean(inside) < 0.97
    assert 0.91 < np.mean(alone) < 0.985


def test_a_wire_states_its_reading_in_space_too():
    simulated = wire_lengths(count=120)
    found = identify_arm(
        simulated.model,
        simulated.observations,
        options=IdentificationOptions(level=GEOMETRY, find_breaks=False),
    )
    predictions = predict_readings(
        found, random_joints(simulated.model, np.random.default_rng(9), 50, reach=1.0)
    )
    assert np.isfinite(predictions.expanded_m).all()
    assert (predictions.expanded_m > predictions.parameters_expanded_m).all()


@pytest.mark.parametrize("simulate", [tracker_points, wire_lengths])
def test_derivatives_of_a_tip_are_those_of_differences(simulate):
    simulated = simulate(count=120)
    found = identify_arm(
        simulated.model,
        simulated.observations,
        options=IdentificationOptions(level=GRAVITY, find_breaks=False, judge=False),
    )
    fit, joints = found.robust.fit, simulated.observations.joints_rad[:7]

    def tip_of_state(state):
        from cellcal.calibration.arm.joint_terms import term_values

        values = term_values(state.nominal, joints, state.terms)
        return state.seen_from(0).base_flange(state.moved_joints(joints, values))[:, :3, 3]

    assert tip_slopes(fit.layout, fit.state, joints) == pytest.approx(
        central_differences(fit, tip_of_state).transpose(0, 2, 1), abs=2e-6
    )


def central_differences(fit, function):
    """Return derivatives (p, …) of a function of the state by every free parameter."""
    steps = np.minimum(1e-2 * fit.layout.prior_sigmas, 1e-4)
    return np.array(
        [
            (
                function(fit.layout.apply_step(fit.state, step))
                - function(fit.layout.apply_step(fit.state, -step))
            )
            / (2 * step.max())
            for step in np.diag(steps)
        ]
    )


def test_the_factor_in_space_of_many_is_that_of_each():
    variances = np.random.default_rng(0).uniform(0.1, 3.0, (5, 3))
    for freedom in (7.0, np.inf):
        each = [coverage_in_space(row.tolist(), freedom) for row in variances]
        assert coverage_in_space_of(variances, freedom) == pytest.approx(each)


def test_errors_that_grow_away_from_the_rows_are_learnt_from_regions():
    rng = np.random.default_rng(2)
    size = np.linalg.norm(rng.standard_normal((400, 3)), axis=1)
    near = HeldOutErrors(1e-4 * size, np.full(400, 3e-10), np.zeros(400), 3)
    far = HeldOutErrors(1e-3 * size, np.full(400, 3e-8), np.zeros(400), 3)
    grown, plain = model_error(near, far, 1000.0), model_error(near, HeldOutErrors.without_rows(), 1000.0)
    assert plain.growth == 1.0
    assert 50 < grown.growth < 200  # 1e-6 a coordinate where parameters alone say 1e-8
    there = np.broadcast_to(1e-8 * np.eye(3), (1, 3, 3))
    wide, narrow = (e.expanded_m(there, np.zeros(1), np.array([True]))[0] for e in (grown, plain))
    assert wide == pytest.approx(2.8e-3, rel=0.2)
    assert narrow < 0.2 * wide


def test_regions_are_of_like_size_and_lie_apart():
    joints = random_joints(UR10, np.random.default_rng(1), 160)
    regions = posture_regions(joints, 8)
    assert np.bincount(regions).min() >= 8
    assert len(np.unique(regions)) == 8
    within = np.mean([joints[regions == r].var(axis=0).sum() for r in range(8)])
    assert within < 0.8 * joints.var(axis=0).sum()


def test_poses_are_predicted_as_points_are():
    rows = prepare_measurements(SERIES["B"], UR10, ReadOptions()).observations
    assert isinstance(rows, PoseObservations)
    some = rows.select_rows(np.arange(0, len(rows), 10))
    found = identify_arm(
        UR10, some, options=IdentificationOptions(level=GEOMETRY, find_breaks=False, judge=False)
    )
    assert not len(found.judgement.held_out_m)  # judged when it is asked for
    predictions = predict_readings(found, some.joints_rad)
    assert (predictions.expanded_m > 3e-4).all()
    grouping = group_rows(some.joints_rad)
    again = predict_readings(replace(found, grouping=grouping), some.joints_rad)
    assert again.expanded_m == pytest.approx(predictions.expanded_m)
