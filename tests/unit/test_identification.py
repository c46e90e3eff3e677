"""The estimator finds what was hidden, says how sure it is, and what it cannot know."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from cellcal.calibration.arm.joint_terms import gravity_terms, harmonic_terms, term_values
from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array, exp_twist
from cellcal.calibration.identification.base_parameters import base_subset
from cellcal.calibration.identification.estimator import (
    FitProblem,
    errors_m,
    estimate_arm,
    place_columns,
    whitened_residuals,
)
from cellcal.calibration.identification.first_guess import first_guess
from cellcal.calibration.identification.fold_errors import errors_without_folds
from cellcal.calibration.identification.identifiability import acts_in_a_sum, hiding_partners
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.observations import (
    LengthObservations,
    PointObservations,
    PoseObservations,
)
from cellcal.calibration.identification.parameters import (
    FRAMES,
    GEOMETRY,
    GRAVITY,
    OFFSETS,
    RIPPLE,
    Parameter,
    Priors,
)
from cellcal.calibration.identification.selection import IdentificationOptions, fit_level, terms_of_level
from tests.unit.helpers.simulated_arm import (
    ANCHOR,
    random_joints,
    tracker_points,
    tracker_poses,
    wire_lengths,
)


def best_start(model, observations):
    fits = []
    for start in first_guess(model, observations):
        layout = make_layout(model, observations.kind, len(start.devices), level=FRAMES)
        fits.append(estimate_arm(layout, start, FitProblem.from_observations(start, observations)))
    return min(fits, key=lambda fit: fit.cost).state


def fit_at_level(simulated, level=GEOMETRY):
    start = best_start(simulated.model, simulated.observations)
    return fit_level(simulated.model, simulated.observations, start, level, Priors())


def tip_places_m(state, joints):
    return state.seen_from(0).base_flange(
        state.moved_joints(joints, term_values(state.nominal, joints, state.terms))
    )[:, :3, 3]


def tip_error_m(simulated, state, joints):
    return np.linalg.norm(
        tip_places_m(state, joints) - simulated.truth.seen_from(0).base_flange(joints)[:, :3, 3], axis=1
    )


@pytest.mark.parametrize("simulate", [tracker_points, tracker_poses, wire_lengths])
@pytest.mark.parametrize("level", [OFFSETS, RIPPLE])
def test_derivatives_agree_with_finite_differences(simulate, level):
    simulated = simulate(count=9)
    model, observations = simulated.model, simulated.observations
    terms = terms_of_level(model, np.linspace(-1, 1, 60)[:, None] * np.ones(model.axis_count), level)
    layout = make_layout(model, observations.kind, 1, level=max(level, GEOMETRY), terms=terms)
    rng = np.random.default_rng(0)
    state = replace(
        simulated.truth,
        terms=terms,
        coefficients=1e-3 * rng.standard_normal(len(terms)),
        geometry=0.01 * rng.standard_normal((6, 5)),
    )
    problem = FitProblem.from_observations(state, observations)
    step = 1e-6
    columns, _ = place_columns(layout, state, problem)
    for i in range(len(layout)):
        change = np.zeros(len(layout))
        change[i] = step
        there = whitened_residuals(layout.apply_step(state, change), problem)
        back = whitened_residuals(layout.apply_step(state, -change), problem)
        # Attitude residuals are large here, so their rotation vectors do not turn one to one.
        rows = slice(0, 3)
        slope = (back - there)[rows] / (2 * step)
        assert np.abs(columns[i][rows] - slope).max() < 1e-5 * max(np.abs(slope).max(), 1e3)


def test_geometry_from_points_predicts_the_tip_within_its_uncertainty():
    ratios = []
    for seed in range(6):
        simulated = tracker_points(count=60, seed=seed)
        robust = fit_at_level(simulated)
        joints = random_joints(simulated.model, np.random.default_rng(99), 200)
        error = tip_error_m(simulated, robust.fit.state, joints)
        check = PointObservations(joints, np.zeros((200, 3)), np.ones(200), np.zeros(200, dtype=np.intp))
        columns, _ = place_columns(
            robust.fit.layout, robust.fit.state, FitProblem.from_observations(robust.fit.state, check)
        )
        variance = np.einsum("pmn,pq,qmn->n", columns, robust.fit.covariance, columns)
        ratios.append(np.sqrt(np.mean(error**2) / np.mean(variance)))
    assert 0.75 < np.mean(ratios) < 1.25


def test_poses_give_the_last_offset_that_points_do_not():
    by_points = fit_at_level(tracker_points(), OFFSETS)
    names = [p.name for p in by_points.fit.layout.parameters]
    sigma = np.sqrt(np.diag(by_points.fit.covariance))[names.index("J1 offset")]
    assert sigma > 0.9 * Priors().offset_rad
    simulated = tracker_poses()
    robust = fit_at_level(simulated)
    joints = random_joints(simulated.model, np.random.default_rng(5), 100)
    assert np.sqrt(np.mean(tip_error_m(simulated, robust.fit.state, joints) ** 2)) < 1e-4


def test_lengths_find_anchor_and_tool_without_any_start():
    simulated = wire_lengths()
    start = best_start(simulated.model, simulated.observations)
    assert np.linalg.norm(start.devices[0].anchor_in_base_m - ANCHOR) < 0.02
    assert np.linalg.norm(start.flange_tool[:3, 3] - simulated.truth.flange_tool[:3, 3]) < 0.02


def test_a_model_without_a_dh_table_is_identified_by_twists():
    simulated = tracker_points(count=80)
    bare = replace(simulated.model, dh=None)
    robust = fit_at_level(replace(simulated, model=bare))
    joints = random_joints(bare, np.random.default_rng(5), 100)
    assert np.sqrt(np.mean(tip_error_m(simulated, robust.fit.state, joints) ** 2)) < 1.5e-4


@pytest.mark.parametrize("level", [FRAMES, GEOMETRY, RIPPLE])
def test_rows_are_predicted_without_their_fold_as_by_a_fit_that_begins_anew(level):
    simulated = tracker_points("ur10", 120, seed=4)
    bad = np.arange(5, 120, 24)
    positions_m = simulated.observations.positions_m.copy()
    positions_m[bad] += 0.02
    rows = replace(simulated.observations, positions_m=positions_m)
    model, places = simulated.model, best_start(simulated.model, rows)
    whole = fit_level(model, rows, places, level, Priors())
    weights, folds = np.ones(120), np.arange(120) % 5
    weights[whole.rejected] = 0.0
    predicted_m = errors_without_folds(whole.fit, whole.problem, weights, folds)
    for fold in (0, 3):
        afresh = fit_level(model, rows.select_rows(np.flatnonzero(folds != fold)), places, level, Priors())
        assert np.isin(np.flatnonzero(folds != fold)[afresh.rejected], bad).all()
        held_rows = rows.select_rows(np.flatnonzero(folds == fold))
        problem = FitProblem.from_observations(afresh.fit.state, held_rows)
        assert np.abs(predicted_m[folds == fold] - errors_m(afresh.fit.state, problem)).max() < 1e-6


def test_sag_is_distinguished_from_offsets():
    simulated = tracker_points("fanuc_r2000ic_165f", 150)
    model = simulated.model
    terms = gravity_terms(model)
    coefficients = np.deg2rad(np.linspace(0.02, 0.06, len(terms)))
    state = replace(simulated.truth, terms=terms, coefficients=coefficients)
    joints = simulated.observations.joints_rad
    moved = state.moved_joints(joints, term_values(model, joints, terms))
    positions = state.seen_from(0).base_flange(moved)[:, :3, 3]
    observations = replace(simulated.observations, positions_m=positions)
    without = fit_level(model, observations, best_start(model, observations), GEOMETRY, Priors())
    with_sag = fit_level(model, observations, best_start(model, observations), GRAVITY, Priors())
    error = [
        float(
            np.sqrt(
                np.mean(errors_m(r.fit.state, FitProblem.from_observations(r.fit.state, observations)) ** 2)
            )
        )
        for r in (without, with_sag)
    ]
    assert error[1] < 0.1 * error[0]


def test_an_upright_joint_does_not_sag():
    for robot in ("ur10", "abb_irb120", "fanuc_m6ib"):
        assert {term.joint for term in gravity_terms(load_model(robot))} <= {1, 2, 3}
        assert {1, 2} <= {term.joint for term in gravity_terms(load_model(robot))}


def test_ripple_terms_are_named_by_joint_order_and_phase():
    terms = harmonic_terms(load_model("ur10"), (1, 2))
    assert len(terms) == 24
    assert terms[3].name == "J1 ripple sin 2"


def test_ripple_is_not_asked_of_a_joint_with_few_angles():
    model = load_model("ur10")
    joints = random_joints(model, np.random.default_rng(0), 100)
    joints[:, 3:] = np.round(joints[:, 3:])
    assert {t.joint for t in terms_of_level(model, joints, RIPPLE) if t.kind == "harmonic"} == {0, 1, 2}


def test_the_level_stops_where_unseen_groups_gain_nothing():
    model = load_model("ur10")
    simulated = tracker_points(count=120)
    perfect = replace(
        simulated.observations,
        positions_m=replace(simulated.truth, geometry=np.zeros((6, 5)))
        .seen_from(0)
        .base_flange(simulated.observations.joints_rad)[:, :3, 3]
        + 1e-4 * np.random.default_rng(3).standard_normal((120, 3)),
    )
    found = identify_arm(model, perfect)
    assert found.level == FRAMES
    assert found.held_out == found.before_errors
    wide = identify_arm(model, simulated.observations, options=IdentificationOptions(judge=False))
    assert wide.level >= GEOMETRY


def test_every_row_is_judged_by_a_fit_that_did_not_see_it():
    found = identify_arm(
        load_model("ur10"),
        tracker_points(count=120).observations,
        options=IdentificationOptions(level=GEOMETRY),
    )
    assert found.held_out.n == found.before_errors.n == 120
    assert found.held_out.rmse_m > found.fit_errors.rmse_m
    assert found.held_out.rmse_m < 2 * found.fit_errors.rmse_m
    assert found.before_errors.rmse_m > 10 * found.held_out.rmse_m


def test_what_cannot_be_known_is_named_with_partner_and_cure():
    found = identify_arm(
        load_model("ur10"),
        tracker_points(count=120).observations,
        options=IdentificationOptions(level=GEOMETRY),
    )
    unknown = {item.parameter: item for item in found.not_identified}
    assert unknown["J1 offset"].partner.startswith("rotation of the base about z")
    assert "base frame" in unknown["J1 offset"].cure
    assert set(unknown["J3 d"].partner.split("; ")) == {"J2 d", "J4 d"}
    assert "J2 a" not in unknown


@dataclass(frozen=True)
class _FreeLengths:
    parameters: tuple[Parameter, ...]
    prior_sigmas: Array


@dataclass(frozen=True)
class _EstimatedLengths:
    """Lengths along parallel axes of which measurements know the sum alone."""

    covariance: Array
    layout: _FreeLengths


@pytest.mark.parametrize("count", [3, 6])
def test_one_term_of_a_long_sum_names_all_others_that_hide_it(count: int):
    lengths = tuple(Parameter(f"J{k + 1} d", "m", 1.0, "geometry", k) for k in range(count))
    known_sum = np.full((count, count), 1.0 / count)
    fit = _EstimatedLengths(np.eye(count) - (1.0 - 1e-6) * known_sum, _FreeLengths(lengths, np.ones(count)))
    partners, share = hiding_partners(fit, 0, lambda parameter: parameter.name)
    assert sorted(index for block in partners for index in block) == list(range(1, count))
    assert share > 0.99
    assert acts_in_a_sum(partners) == (count == 6)


def test_parallel_axes_do_not_blow_up():
    found = identify_arm(
        load_model("ur10"),
        tracker_points(count=60).observations,
        options=IdentificationOptions(level=GEOMETRY),
    )
    assert np.abs(found.state.geometry[:, 1:3]).max() < 3e-3


def test_the_answer_does_not_depend_on_the_device_frame_or_the_order_of_rows():
    simulated = tracker_points(count=90)
    joints = random_joints(simulated.model, np.random.default_rng(8), 50)
    reference = fit_at_level(simulated).fit.state
    turn = exp_twist(np.array([3.0, -2.0, 1.0, 0.5, 2.0, -1.0]))
    turned = simulated.observations.positions_m @ turn[:3, :3].T + turn[:3, 3]
    order = np.random.default_rng(2).permutation(90)
    for changed, frame in (
        (replace(simulated.observations, positions_m=turned), turn),
        (simulated.observations.select_rows(order), np.eye(4)),
    ):
        state = fit_at_level(replace(simulated, observations=changed)).fit.state
        there = frame @ reference.seen_from(0).base_flange(joints)
        assert np.abs(state.seen_from(0).base_flange(joints)[:, :3, 3] - there[:, :3, 3]).max() < 1e-7


def test_too_few_rows_are_refused_with_what_to_do():
    simulated = tracker_points(count=3)
    with pytest.raises(DegenerateDataError) as caught:
        identify_arm(simulated.model, simulated.observations)
    assert "Measure at least" in caught.value.remedy
    with pytest.raises(CalibrationError):
        identify_arm(simulated.model, tracker_points().observations, options=IdentificationOptions(level=9))


def test_observations_refuse_what_is_not_a_number():
    joints, once = np.zeros((2, 6)), np.zeros(2, dtype=np.intp)
    with pytest.raises(CalibrationError):
        PointObservations(joints, np.full((2, 3), np.nan), np.ones(2), once)
    with pytest.raises(CalibrationError):
        LengthObservations(joints, np.zeros(3), np.ones(2), once)


def test_pose_rows_are_taken_whole():
    poses = tracker_poses().observations.select_rows(np.array([3, 5]))
    assert isinstance(poses, PoseObservations)
    assert poses.rotations.shape == (2, 3, 3)
    assert poses.sigma_rad.shape == poses.sigma_m.shape == (2,)


def test_position_measurements_of_a_ur10_tell_27_parameters_apart():
    simulated = tracker_points(count=200, seed=5)
    for model in (simulated.model, replace(simulated.model, dh=None)):
        layout = make_layout(model, "point", 1, level=GEOMETRY)
        start = first_guess(model, simulated.observations)[0]
        subset = base_subset(layout, start, simulated.observations)
        assert len(subset) == 27
        columns, _ = place_columns(subset, start, FitProblem.from_observations(start, simulated.observations))
        scaled = columns.reshape(27, -1) * subset.prior_sigmas[:, None]
        scaled /= np.linalg.norm(scaled, axis=1)[:, None]
        assert np.linalg.svd(scaled, compute_uv=False).min() > 1e-4
        # Offsets come before lengths: of two that act alike, the offset is kept.
        assert {f"J{i} offset" for i in (2, 3, 4)} <= {p.name for p in subset.parameters}
