"""What is stated about an identified arm holds: deviations, acceptance, points asked for, tables, residuals."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.standard_dh import hayati_dh, parallel_rows, standard_dh
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.identification.cross_validation import rmse_uncertainty
from cellcal.calibration.identification.group_effect import group_effect, widen_fit
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.offset_acceptance import accept_offsets
from cellcal.calibration.identification.parameters import GEOMETRY, OFFSETS
from cellcal.calibration.identification.residual_model import errors_with, fit_residual, residual_in_base
from cellcal.calibration.identification.selection import IdentificationOptions
from cellcal.calibration.identification.tip_uncertainty import hayati_table, predict_tips
from cellcal.calibration.uncertainty import Verdict, coverage_factor
from tests.unit.helpers.simulated_arm import random_joints, tracker_points, tracker_poses, wire_lengths
from tests.unit.test_identification import fit_at_level

UR10 = load_model("ur10")


def test_rows_that_share_an_error_count_as_fewer():
    rng = np.random.default_rng(0)
    groups = np.repeat(np.arange(40), 10)
    alone = group_effect(rng.standard_normal((3, 400)), groups)
    assert alone.widening == 1.0
    assert alone.effective_rows == 400
    shared = rng.standard_normal((3, 40))[:, groups] + rng.standard_normal((3, 400))
    effect = group_effect(shared, groups)
    assert effect.correlation == pytest.approx(0.5, abs=0.12)
    assert effect.widening**2 == pytest.approx(5.5, rel=0.25)
    assert "independent" in effect.said


@pytest.mark.parametrize("runs", [10, 20])
def test_intervals_hold_the_truth_where_runs_share_an_error(runs):
    """Each run of ten rows is off as a whole; least squares alone would call itself twice as good as it is."""
    groups = np.repeat(np.arange(runs), 10)
    inside: dict[bool, list[float]] = {False: [], True: []}
    for seed in range(8):
        rng = np.random.default_rng(seed)
        joints = random_joints(UR10, rng, runs)[groups] + rng.uniform(-0.02, 0.02, (10 * runs, 6))
        simulated = tracker_points(count=10 * runs, seed=seed, joints=joints)
        shifted = simulated.observations.positions_m + 1e-4 * rng.standard_normal((runs, 3))[groups]
        rows = replace(simulated.observations, positions_m=shifted)
        robust = fit_at_level(replace(simulated, observations=rows))
        check = random_joints(UR10, rng, 100)
        truth = simulated.truth.seen_from(0).base_flange(check)[:, :3, 3]
        widened, _ = widen_fit(robust, groups)
        assert widened.degrees_of_freedom < 3 * runs  # a run is known no better than its mean
        for one in (robust, widened):
            tips = predict_tips(one.fit, check)
            spread = np.sqrt(np.einsum("nii->ni", tips.covariance_m2))
            factor = coverage_factor(one.degrees_of_freedom)
            inside[one is widened].append(float((np.abs(tips.positions_m - truth) < factor * spread).mean()))
    assert np.mean(inside[False]) < 0.75
    assert np.mean(inside[True]) > 0.9


@pytest.mark.parametrize(
    ("simulate", "runs"),
    [(tracker_poses, 12), (tracker_points, 10), (tracker_points, 20), (wire_lengths, 20)],
)
def test_noise_alone_widens_nothing_however_many_unknowns_there_are(simulate, runs):
    """Sixty rows and 27 to 33 unknowns: a fit takes a third of what groups differ by, which is no reason to doubt."""
    widening_factors = []
    for seed in range(6):
        simulated = simulate(count=60, seed=seed)
        robust = fit_at_level(simulated)
        widened, effect = widen_fit(robust, np.repeat(np.arange(runs), 60 // runs))
        widening_factors.append(effect.widening)
        if effect.widening == 1.0:
            assert widened is robust
    assert np.median(widening_factors) == 1.0
    assert max(widening_factors) < 1.7


def test_offsets_are_accepted_as_four_numbers_a_joint_have_them():
    robust = fit_at_level(tracker_points(count=120))
    names = ("J2 offset", "J3 offset", "J4 offset", "J5 offset")
    accepted = accept_offsets(robust, np.deg2rad(0.02), names)
    assert accepted.verdict is Verdict.PASS
    # Beside its beta an offset as fitted is known to its prior only.
    every = [p.name for p in robust.fit.layout.parameters]
    raw = np.sqrt(robust.fit.covariance[every.index("J4 offset"), every.index("J4 offset")])
    assert raw > 10 * next(item.sigma_rad for item in accepted.offsets if item.parameter == "J4 offset")


def test_a_missed_acceptance_says_how_many_poses_or_why_none_will_do():
    robust = fit_at_level(tracker_points(count=60))
    limit = 0.5 * max(item.sigma_rad for item in accept_offsets(robust, 1.0, ("J2 offset",)).offsets)
    missed = accept_offsets(robust, limit, ("J2 offset", "J1 offset"))
    assert missed.verdict is Verdict.FAIL
    more, never = (item.more for item in missed.offsets)
    assert 100 < int(more.split()[1]) < 400  # four times the rows, and a margin
    assert "rotation of the base" in never
    assert "base frame" in never


def test_the_stated_number_of_further_poses_is_enough():
    few = fit_at_level(tracker_points(count=50))
    limit = 0.6 * accept_offsets(few, 1.0, ("J3 offset",)).offsets[0].sigma_rad
    pose_count = int(accept_offsets(few, limit, ("J3 offset",)).offsets[0].more.split()[1])
    many = fit_at_level(tracker_points(count=50 + pose_count))
    assert accept_offsets(many, 1.05 * limit, ("J3 offset",)).verdict is not Verdict.FAIL


def test_offsets_that_were_not_fitted_are_refused():
    robust = fit_at_level(tracker_points(count=60), 0)
    with pytest.raises(CalibrationError, match="no joint offset"):
        accept_offsets(robust, 1e-3)
    with pytest.raises(CalibrationError, match="positive"):
        accept_offsets(robust, 0.0)


def test_the_place_of_the_target_is_known_as_well_as_stated():
    ratios = []
    for seed in range(10):
        simulated = tracker_points(count=60, seed=seed, sigma_m=1e-4)
        robust = fit_at_level(simulated)
        joints = random_joints(UR10, np.random.default_rng(50 + seed), 100)
        tips = predict_tips(robust.fit, joints)
        truth = simulated.truth.seen_from(0).base_flange(joints)[:, :3, 3]
        square = ((tips.positions_m - truth) ** 2).sum(axis=1)
        ratios.append(square.mean() / np.einsum("nii->n", tips.covariance_m2).mean())
    assert 0.7 < np.sqrt(np.mean(ratios)) < 1.3


@pytest.mark.parametrize("robot", ["ur10", "ur5e", "abb_irb120", "fanuc_m6ib", "kuka_kr6_r900"])
def test_tilted_parallel_axes_stay_near_nominal_in_hayatis_form(robot):
    nominal = load_model(robot)
    errors = np.random.default_rng(1).standard_normal((6, 5)) * [2e-3, 5e-4, 5e-4, 1e-3, 1e-3]
    for row in parallel_rows(nominal):
        errors[row, 3:] = np.deg2rad(0.3)
    real = nominal.with_dh_errors(errors)
    found = hayati_dh(real, nominal)
    change = found.table.to_rows() - nominal.dh.to_rows()
    assert np.abs(change[:, 1:3]).max() < 2e-3
    assert np.abs(change).max() < 0.02
    joints = random_joints(nominal, np.random.default_rng(2), 30)
    again = nominal.with_dh_errors(change).base_flange(joints) @ found.flange_rest
    assert np.abs(again - real.base_flange(joints)).max() < 1e-12
    assert np.abs(standard_dh(real, nominal).table.to_rows() - nominal.dh.to_rows()[:, :5])[:, 1].max() > 10.0


def test_the_table_of_an_identified_arm_does_not_blow_up_and_says_how_sure_it_is():
    simulated = tracker_points(count=150)
    geometry = simulated.truth.geometry.copy()
    geometry[1:3, 3:] = np.deg2rad(0.3)
    truth = replace(simulated.truth, geometry=geometry)
    tips = truth.seen_from(0).base_flange(simulated.observations.joints_rad)[:, :3, 3]
    measured_m = tips + 5e-5 * np.random.default_rng(5).standard_normal(tips.shape)
    table = hayati_table(
        fit_at_level(
            replace(simulated, observations=replace(simulated.observations, positions_m=measured_m))
        ).fit
    )
    names = [entry.name for entry in table.entries]
    assert "J2 beta" in names
    assert "J2 d" not in names
    assert "J4 beta" not in names
    assert all(abs(e.value - e.nominal) < 4e-3 for e in table.entries if e.unit == "m")
    expected = hayati_dh(truth.arm_model, UR10).table.to_rows()
    known_entries = [
        entry for entry in table.entries if entry.name in ("J2 beta", "J3 alpha", "J3 a", "J4 offset")
    ]
    for entry in known_entries:
        column = ("offset", "d", "a", "alpha", "beta").index(entry.name.split()[1])
        assert abs(entry.value - expected[int(entry.name[1]) - 1, column]) < 4 * entry.sigma


def bending_error_m(joints):
    """An arm's error that no parameter has [m]."""
    return 3e-4 * np.stack(
        [np.sin(3 * joints[:, 0]), np.cos(2 * joints[:, 2]), np.sin(joints[:, 1] * 2)], axis=1
    )


def test_a_residual_model_helps_where_it_has_seen_and_is_silent_far_away():
    rng = np.random.default_rng(0)
    joints, near = rng.uniform(-1, 1, (300, 6)), rng.uniform(-1, 1, (100, 6))
    model = fit_residual(joints, bending_error_m(joints) + 5e-5 * rng.standard_normal((300, 3)))
    mean, sigma = model.predict_residual(near)
    remaining_m = bending_error_m(near) - mean
    assert np.sqrt((remaining_m**2).mean()) < 0.4 * np.sqrt((bending_error_m(near) ** 2).mean())
    assert 0.5 < np.sqrt((remaining_m**2).mean() / (sigma**2).mean()) < 1.6
    far, doubt = model.predict_residual(near + 60.0)
    assert np.abs(far).max() < 1e-12
    assert doubt == pytest.approx(np.sqrt(model.variance_m2))
    assert doubt.min() > 2 * sigma.mean()


@pytest.mark.parametrize(("bend", "chosen"), [(1.0, True), (0.0, False)])
def test_a_residual_model_is_used_only_if_unseen_rows_gain(bend, chosen):
    joints = random_joints(UR10, np.random.default_rng(3), 100, reach=1.0)
    rows = tracker_points(count=100, joints=joints).observations
    rows = replace(rows, positions_m=rows.positions_m + bend * bending_error_m(joints))
    options = IdentificationOptions(level=GEOMETRY, residual_model=True, find_breaks=False)
    found = identify_arm(UR10, rows, options=options)
    assert found.residual is not None
    assert found.residual.chosen is chosen
    assert found.residual.held_out.n == found.held_out.n == 100
    if chosen:
        assert found.residual.held_out.rmse_m < 0.8 * found.held_out.rmse_m
        with_it = errors_with(found.residual.model, found.state, rows)
        assert with_it.mean() < np.linalg.norm(residual_in_base(found.state, rows), axis=1).mean()


def test_lengths_have_no_residual_model():
    simulated = wire_lengths(count=60)
    with pytest.raises(CalibrationError, match="one direction"):
        identify_arm(
            simulated.model,
            simulated.observations,
            options=IdentificationOptions(level=OFFSETS, residual_model=True),
        )


def test_the_uncertainty_of_an_rmse_comes_from_groups():
    rng = np.random.default_rng(0)
    groups = np.repeat(np.arange(30), 20)
    found = [
        rmse_uncertainty(np.abs(rng.standard_normal(600) * rng.uniform(0.5, 1.5, 30)[groups]), groups)
        for _ in range(40)
    ]
    values, sigmas = np.array([f[0] for f in found]), np.array([f[1] for f in found])
    assert found[0][2] == 29
    assert 0.7 < sigmas.mean() / values.std() < 1.4
    with pytest.raises(DegenerateDataError):
        rmse_uncertainty(np.ones(5), np.zeros(5, dtype=int))
