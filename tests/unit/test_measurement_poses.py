"""Planning measurements: predictions that simulated calibrations keep, the next best poses, and enough of them."""

import re
from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.identification.estimator import FitProblem, estimate_arm
from cellcal.calibration.identification.observations import LengthObservations, PointObservations
from cellcal.calibration.identification.parameters import GRAVITY, OFFSETS, Priors
from cellcal.calibration.motion.cell_shapes import SphereObstacle, assumed_shape
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath
from cellcal.calibration.poses.enough_poses import AcceptanceLimits, acceptance_gaps, enough_poses
from cellcal.calibration.poses.measurement_poses import (
    DesignCriterion,
    choose_poses,
    measurable_postures,
    plan_efficiency,
)
from cellcal.calibration.poses.measurement_prediction import (
    DesignInstrument,
    TestPoses,
    predict_accuracy,
    predict_after_fit,
    predict_from_poses,
)

MODEL = load_model("abb_irb120")
TOOL = (0.04, 0.025, 0.1)
POINT = DesignInstrument("point", 1e-4)
POSE = DesignInstrument("pose", 1e-4, 1e-4)
WIRE = DesignInstrument("length", 2e-4, anchor_in_base_m=(0.6, -0.5, 0.1))
CANDIDATES = measurable_postures(MODEL, MotionLimits(), 300)
TESTS = TestPoses(measurable_postures(MODEL, MotionLimits(), 60, seed=9))


def draw_candidates(k, seed=0):
    return CANDIDATES[np.random.default_rng(seed).choice(len(CANDIDATES), k, replace=False)]


def offsets_rms(prediction):
    return np.sqrt(np.mean([sigma**2 for _, sigma in prediction.offsets_rad]))


def test_candidates_keep_the_limits_and_the_filters():
    ball = SphereObstacle("ball", (0.45, 0.0, 0.5), 0.15)
    check = CollisionCheck.from_model(MODEL, assumed_shape(MODEL, (ball,)))
    found = measurable_postures(MODEL, MotionLimits(), 100, filters=(check.is_free,))
    assert len(found) == 100
    assert check.is_free(found).all()
    assert not check.is_free(CANDIDATES).all()
    margin = np.deg2rad(3) - 1e-6
    assert (found > MODEL.lower_rad + margin).all()
    assert (found < MODEL.upper_rad - margin).all()


def test_a_wire_that_reaches_nothing_is_reported():
    limits = MotionLimits(wire=WirePath((9.0, 0.0, 0.0), (0.0, 0.0, 0.0), range_m=1.0))
    with pytest.raises(DegenerateDataError, match="limits"):
        measurable_postures(MODEL, limits, 10)
    with pytest.raises(DegenerateDataError, match="collisions"):
        measurable_postures(MODEL, MotionLimits(), 10, filters=(lambda q: np.zeros(len(q), dtype=bool),))


def test_a_joint_whose_range_is_within_its_margins_is_named():
    low, high = MODEL.lower_rad.copy(), MODEL.upper_rad.copy()
    low[4], high[4] = -0.03, 0.03
    narrow = replace(MODEL, lower_rad=low, upper_rad=high)
    with pytest.raises(DegenerateDataError, match=f"the range of {MODEL.joint_names[4]} is smaller"):
        measurable_postures(narrow, MotionLimits(), 10)


def test_poses_of_a_quill_reach_near_both_its_ends():
    scara = load_model("mitsubishi_rh6crh6020")
    quill = measurable_postures(scara, MotionLimits(), 400)[:, 2]
    assert quill.min() < scara.lower_rad[2] + 0.01
    assert quill.max() > scara.upper_rad[2] - 0.01
    assert scara.lower_rad[2] + 0.004 < quill.min()
    assert quill.max() < scara.upper_rad[2] - 0.004


@pytest.mark.parametrize("instrument", [POINT, POSE, WIRE], ids=["point", "pose", "length"])
@pytest.mark.parametrize("criterion", list(DesignCriterion))
def test_chosen_poses_promise_more_than_random_ones(instrument, criterion):
    prediction = predict_from_poses(MODEL, instrument, tool_in_flange_m=TOOL)
    plan = choose_poses(prediction, CANDIDATES, 25, TESTS, criterion=criterion)
    random = [
        predict_accuracy(prediction.with_measured(draw_candidates(25, seed)), TESTS) for seed in range(15)
    ]
    assert plan.joints_rad.shape == (25, 6)
    if criterion is DesignCriterion.TEST_POSES:
        assert plan.prediction.tip_rms_m < min(p.tip_rms_m for p in random)
    if criterion is DesignCriterion.DETERMINANT:
        assert plan.prediction.tip_rms_m < np.median([p.tip_rms_m for p in random])
    if criterion is DesignCriterion.OFFSETS:
        everything = {
            name for name, _ in predict_accuracy(prediction.with_measured(CANDIDATES), TESTS).offsets_rad
        }
        index = [i for i, name in enumerate(plan.prediction.parameters) if name in everything]

        def tip_uncertainty(prediction):
            return np.sum(np.square([prediction.sigma[i] for i in index]))

        assert tip_uncertainty(plan.prediction) < min(map(tip_uncertainty, random))


def test_test_poses_are_served_better_by_their_own_criterion():
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL)
    corner = TestPoses(CANDIDATES[:1] + 0.1 * np.random.default_rng(3).normal(size=(20, 6)))
    own = choose_poses(prediction, CANDIDATES, 20, corner, criterion=DesignCriterion.TEST_POSES).prediction
    other = choose_poses(prediction, CANDIDATES, 20, corner, criterion=DesignCriterion.DETERMINANT).prediction
    assert own.tip_rms_m < 0.9 * other.tip_rms_m


def simulate_errors(prediction, joints, truth_of, trials):
    """Return tip errors (trials, T, 3) [m] and parameter errors (trials, p) of fits of noisy measurements."""
    rng = np.random.default_rng(5)
    tips, parameters = [], []
    places = [p.role in ("base", "anchor", "tool") for p in prediction.layout.parameters]
    for _ in range(trials):
        change = rng.normal(size=len(prediction.layout)) * prediction.layout.prior_sigmas
        change[places] = 0.0  # metres of doubt need a start of their own
        truth = prediction.layout.apply_step(prediction.state, change)
        fit = estimate_arm(
            prediction.layout,
            prediction.state,
            FitProblem.from_observations(prediction.state, truth_of(truth, joints, rng)),
        )
        fitted_state, real = fit.state.seen_from(0), truth.seen_from(0)
        zero = np.zeros(3)
        tips.append(
            fitted_state.tip_positions(TESTS.joints_rad, zero) - real.tip_positions(TESTS.joints_rad, zero)
        )
        parameters.append(fit.deviations - change)
    return np.array(tips), np.array(parameters)


def test_simulated_calibrations_are_as_good_as_predicted_for_points():
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL, priors=Priors(offset_rad=5e-3))
    joints = draw_candidates(30)

    def measure_points(truth, joints, rng):
        points = truth.seen_from(0).tip_positions(joints, np.zeros(3)) + rng.normal(scale=1e-4, size=(30, 3))
        return PointObservations(joints, points, np.full(30, 1e-4), np.zeros(30, dtype=np.intp))

    tips, _ = simulate_errors(prediction, joints, measure_points, 60)
    predicted = predict_accuracy(prediction.with_measured(joints), TESTS)
    assert np.sqrt((tips**2).sum(axis=2).mean()) == pytest.approx(predicted.tip_rms_m, rel=0.06)


def test_simulated_calibrations_are_as_good_as_predicted_for_lengths():
    prediction = predict_from_poses(MODEL, WIRE, tool_in_flange_m=TOOL)
    joints = draw_candidates(60)
    anchor = np.array(WIRE.anchor_in_base_m)

    def measure_lengths(truth, joints, rng):
        tips = truth.seen_from(0).tip_positions(joints, np.zeros(3))
        device = truth.devices[0]
        lengths = device.zero_m + device.scale * np.linalg.norm(tips - anchor, axis=1)
        noise = rng.normal(scale=2e-4, size=60)
        return LengthObservations(joints, lengths + noise, np.full(60, 2e-4), np.zeros(60, dtype=np.intp))

    tips, parameters = simulate_errors(prediction, joints, measure_lengths, 40)
    predicted = predict_accuracy(prediction.with_measured(joints), TESTS)
    sigma = dict(zip(predicted.parameters, predicted.sigma, strict=True))
    names = list(predicted.parameters)
    for name in ("J2 offset", "J3 offset", "J2 a"):
        assert parameters[:, names.index(name)].std() == pytest.approx(sigma[name], rel=0.35)
    assert _after_best_frame(tips) == pytest.approx(predicted.tip_rms_m, rel=0.15)


def _after_best_frame(errors):
    """Return the rms distance left when one small rigid motion of all test tips is fitted to each trial."""
    tips = MODEL.tip_positions(TESTS.joints_rad, np.array(TOOL))
    centred = tips - tips.mean(axis=0)
    columns = [np.tile(axis, (len(tips), 1)) for axis in np.eye(3)]
    columns += [np.cross(axis, centred) for axis in np.eye(3)]
    motions = np.stack(columns).reshape(6, -1).T
    flat = errors.reshape(len(errors), -1).T
    remaining = flat - motions @ np.linalg.lstsq(motions, flat, rcond=None)[0]
    return np.sqrt((remaining**2).sum(axis=0).mean() / len(tips))


def test_the_next_poses_go_on_from_a_fit():
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL)
    small_box = CANDIDATES[:1] + 0.15 * np.random.default_rng(1).normal(size=(20, 6))
    tips = MODEL.tip_positions(small_box, np.array(TOOL))
    points = PointObservations(small_box, tips, np.full(20, 1e-4), np.zeros(20, dtype=np.intp))
    fit = estimate_arm(
        prediction.layout, prediction.state, FitProblem.from_observations(prediction.state, points)
    )
    after = predict_after_fit(fit, POINT.make_observations)
    prediction_before = predict_accuracy(prediction.with_measured(small_box), TESTS)
    assert predict_accuracy(after, TESTS).tip_rms_m == pytest.approx(prediction_before.tip_rms_m, rel=1e-3)
    plan = choose_poses(after, CANDIDATES, 8, TESTS)
    again = predict_accuracy(after.with_measured(small_box[:8]), TESTS)
    assert plan.prediction.tip_rms_m < 0.7 * again.tip_rms_m
    assert plan.prediction.tip_rms_m < 0.5 * prediction_before.tip_rms_m


def test_a_known_tip_counts_instead_of_the_target():
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL).with_measured(CANDIDATES)
    target = predict_accuracy(prediction, TESTS).tip_rms_m
    same_place = predict_accuracy(prediction, TestPoses(TESTS.joints_rad, TOOL)).tip_rms_m
    far = predict_accuracy(prediction, TestPoses(TESTS.joints_rad, (0.0, 0.0, 0.5))).tip_rms_m
    assert same_place != pytest.approx(target, rel=1e-3)  # where target and flange meet is not known
    assert far > same_place


def test_what_cannot_be_known_is_named_with_its_partner():
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL, level=OFFSETS).with_measured(
        CANDIDATES
    )
    hidden = {item.parameter: item for item in prediction.not_identified()}
    assert set(hidden) == {"J1 offset", "J6 offset"}
    assert "base" in hidden["J1 offset"].partner
    assert "tool" in hidden["J6 offset"].partner


def test_parameters_that_others_imitate_are_dropped_when_asked():
    carried = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL)
    dropped = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL, drop_redundant=True)
    assert len(dropped.layout) == 27
    everything = predict_accuracy(dropped.with_measured(CANDIDATES), TESTS)
    widened = predict_accuracy(carried.with_measured(CANDIDATES), TESTS)
    assert everything.tip_rms_m == pytest.approx(widened.tip_rms_m, rel=1e-3)
    offset, wide = dict(everything.offsets_rad)["J3 offset"], dict(widened.offsets_rad)["J3 offset"]
    assert offset < 0.1 * wide
    found = enough_poses(
        dropped, CANDIDATES, AcceptanceLimits(offset_rad=np.deg2rad(0.03), offsets_of=("J3 offset",)), TESTS
    )
    assert found.plan is not None


def test_sag_is_planned_for_when_asked():
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL, level=GRAVITY)
    names = choose_poses(prediction, CANDIDATES, 30, TESTS).prediction.parameters
    assert any("sag" in name for name in names)


def test_the_efficiency_is_that_against_a_bound():
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL)
    for criterion in (DesignCriterion.DETERMINANT, DesignCriterion.TEST_POSES):
        plan = choose_poses(prediction, CANDIDATES, 40, TESTS, criterion=criterion)
        assert 0.85 < plan_efficiency(prediction, CANDIDATES, plan, TESTS) <= 1.0


def test_enough_poses_are_the_fewest_that_keep_the_acceptance():
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL)
    acceptance = AcceptanceLimits(tip_rms_m=1.5e-4)
    found = enough_poses(prediction, CANDIDATES, acceptance, TESTS)
    assert found.plan is not None
    count = len(found.plan.indices)
    assert not acceptance_gaps(found.prediction, acceptance)
    assert found.prediction.tip_rms_m <= 1.5e-4 / 1.2
    fewer = choose_poses(prediction, CANDIDATES, count - 1, TESTS, starts=1)
    assert acceptance_gaps(fewer.prediction, acceptance)
    assert f"{count} poses" in found.reason


def test_nothing_is_measured_when_enough_is_known():
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL).with_measured(CANDIDATES)
    found = enough_poses(prediction, CANDIDATES, AcceptanceLimits(tip_rms_m=1e-3), TESTS)
    assert found.plan.indices == ()
    assert "already" in found.reason


@pytest.mark.parametrize(
    ("acceptance", "level", "words"),
    [
        (AcceptanceLimits(tip_rms_m=1e-6), 2, "too coarse"),
        (AcceptanceLimits(tip_rms_m=6e-5), 2, "measure more poses"),
        (AcceptanceLimits(offset_rad=1e-3), OFFSETS, "hides behind .*: "),
        (
            AcceptanceLimits(offset_rad=1e-3, offsets_of=("J4 offset",)),
            2,
            "tells J4 offset from J4 beta|hides behind",
        ),
    ],
)
def test_an_acceptance_that_cannot_be_reached_is_explained(acceptance, level, words):
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL, level=level)
    found = enough_poses(prediction, CANDIDATES, acceptance, TESTS, most=40)
    assert found.plan is None
    assert re.search(words, found.reason), found.reason


def test_offsets_alone_need_few_poses():
    prediction = predict_from_poses(MODEL, POINT, tool_in_flange_m=TOOL, level=OFFSETS)
    offset_names = tuple(f"J{i} offset" for i in (2, 3, 4, 5))
    found = enough_poses(
        prediction, CANDIDATES, AcceptanceLimits(offset_rad=np.deg2rad(0.02), offsets_of=offset_names), TESTS
    )
    assert found.plan.criterion is DesignCriterion.OFFSETS
    assert 4 <= len(found.plan.indices) <= 10
    assert offsets_rms(found.prediction) < np.deg2rad(0.02)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: DesignInstrument("photo", 1e-4),
        lambda: DesignInstrument("point", 0.0),
        lambda: DesignInstrument("point", float("nan")),
        lambda: DesignInstrument("pose", 1e-4),
        AcceptanceLimits,
        lambda: AcceptanceLimits(tip_rms_m=0.0),
        lambda: AcceptanceLimits(tip_rms_m=1e-4, margin=0.5),
        lambda: enough_poses(
            predict_from_poses(MODEL, POINT),
            CANDIDATES,
            AcceptanceLimits(offset_rad=1e-3, offsets_of=("J9 offset",)),
            TESTS,
        ),
    ],
)
def test_impossible_wishes_are_refused(wrong):
    with pytest.raises(CalibrationError):
        wrong()
