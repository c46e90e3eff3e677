"""Compensation: what converged stands right, what did not says so, and no arm ever leaps to another branch."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.joint_terms import gravity_terms, harmonic_terms, term_values
from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.compensation.compensate import (
    Compensation,
    CompensationLimits,
    PointStatus,
    ProgramDirection,
    compensate,
)
from cellcal.calibration.compensation.damped_solve import damped_step
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import exp_rotation, exp_twist, homogeneous_matrix, log_rotation
from cellcal.calibration.identification.parameters import nominal_state

ROBOTS = ("ur10", "abb_irb120", "fanuc_m6ib", "kuka_kr6_r900")
TOOL = homogeneous_matrix(exp_rotation(np.array([0.3, -0.8, 0.1])), np.array([0.05, 0.02, 0.18]))


def errors_of(model, seed):
    """DH errors of a real arm's size: 0.4 mm, 0.03 degrees, offsets of 0.15 degrees."""
    rng = np.random.default_rng(seed)
    errors = rng.normal(size=(model.axis_count, 5)) * [2.6e-3, 4e-4, 4e-4, 5e-4, 5e-4]
    return model.with_dh_errors(errors)


def model_pair(name="ur10", seed=3):
    nominal = load_model(name)
    return errors_of(nominal, seed), nominal


def random_joints(model, count, seed, share=1.0):
    rng = np.random.default_rng(seed)
    return share * rng.uniform(model.lower_rad, model.upper_rad, (count, model.axis_count))


def remaining_error(moved, followed, found, start, tip=None):
    """Distance and angle left, by the public forward kinematics and the logarithm: not as the solver counts."""
    tip = np.eye(4) if tip is None else tip
    there, here = followed.base_flange(start) @ tip, moved.base_flange(found) @ tip
    turn = log_rotation(np.swapaxes(here[:, :3, :3], 1, 2) @ there[:, :3, :3])
    return np.linalg.norm(there[:, :3, 3] - here[:, :3, 3], axis=1), np.linalg.norm(turn, axis=1)


@pytest.mark.parametrize("name", ROBOTS)
def test_random_poses_end_in_the_truth_about_them(name):
    real, nominal = model_pair(name)
    start = random_joints(nominal, 5000, seed=11)
    done = compensate(real, nominal, start)
    distance, angle = remaining_error(real, nominal, done.joints_rad, start)
    before, before_angle = remaining_error(real, nominal, start, start)
    ok = done.has_converged
    assert np.abs(done.joints_rad - start).max() <= 0.5 + 1e-12
    assert distance[ok].max() < 1.0001e-8
    assert angle[ok].max() < 2e-8
    assert (done.joints_rad[ok] >= nominal.lower_rad).all()
    assert (done.joints_rad[ok] <= nominal.upper_rad).all()
    assert np.allclose(done.position_error_m, distance, atol=1e-11)
    assert np.allclose(done.angle_error_rad, angle, atol=3e-8)
    # Weighed as the solver weighs, a point is never left worse than it came.
    assert (np.hypot(distance, 0.3 * angle) <= np.hypot(before, 0.3 * before_angle) + 1e-12).all()
    assert ok.mean() > 0.9
    assert done.status.shape == (5000,)
    assert np.sum(done.status == PointStatus.CONVERGED) == ok.sum()


@pytest.mark.parametrize("name", ROBOTS)
def test_up_and_down_again_is_where_one_began(name):
    real, nominal = model_pair(name)
    start = random_joints(nominal, 500, seed=4, share=0.7)
    up = compensate(real, nominal, start)
    down = compensate(real, nominal, up.joints_rad, direction=ProgramDirection.DOWNLOAD)
    both = up.has_converged & down.has_converged
    assert both.mean() > 0.9
    jacobians = nominal.flange_jacobian(start)[1]
    regular = both & (np.linalg.svd(jacobians, compute_uv=False)[:, -1] > 0.02)
    assert np.abs(down.joints_rad[regular] - start[regular]).max() < 1e-5
    assert np.abs(up.joints_rad[regular] - start[regular]).max() > 1e-3


def test_equal_arms_need_no_step():
    nominal = load_model("ur10")
    start = random_joints(nominal, 200, seed=1, share=0.9)
    done = compensate(nominal, nominal, start)
    assert done.has_converged.all()
    assert np.array_equal(done.joints_rad, start)
    assert (done.steps == 0).all()


def test_tools_of_their_own_meet_at_the_tip():
    real, nominal = model_pair()
    real_tool = TOOL @ exp_twist(np.array([1e-3, -5e-4, 2e-3, 4e-3, -2e-3, 1e-3]))
    start = random_joints(nominal, 300, seed=8, share=0.5)
    done = compensate(TipArm(real, real_tool), TipArm(nominal, TOOL), start)
    there = nominal.base_flange(start) @ TOOL
    here = real.base_flange(done.joints_rad) @ real_tool
    assert done.has_converged.mean() > 0.9
    assert np.abs(there - here)[done.has_converged].max() < 4e-8


def test_sag_and_ripple_of_an_identified_arm_are_compensated():
    nominal = load_model("ur10")
    terms = (*gravity_terms(nominal)[:3], *harmonic_terms(nominal, (1,)))
    rng = np.random.default_rng(5)
    state = replace(
        nominal_state(nominal, (), TOOL),
        geometry=rng.normal(size=(6, 5)) * 4e-4,
        terms=terms,
        coefficients=rng.normal(scale=2e-3, size=len(terms)),
    )
    start = random_joints(nominal, 400, seed=9, share=0.5)
    done = compensate(TipArm.of_state(state), TipArm(nominal, TOOL), start)
    carried = state.moved_joints(done.joints_rad, term_values(nominal, done.joints_rad, terms))
    distance, angle = remaining_error(state.arm_model, nominal, carried, start, TOOL)
    ok = done.has_converged
    assert ok.mean() > 0.9
    assert distance[ok].max() < 1.0001e-8
    assert angle[ok].max() < 2e-8
    plain = compensate(TipArm(state.arm_model, TOOL), TipArm(nominal, TOOL), start)
    assert np.abs(plain.joints_rad - done.joints_rad).max() > 1e-3


def test_a_stretched_arm_that_came_out_short_says_unreachable():
    nominal = load_model("ur10")
    errors = np.zeros((6, 5))
    errors[1:3, 2] = 5e-4  # both links shorter: UR writes them negative
    short = nominal.with_dh_errors(errors)
    start = np.array([[0.4, -1.2, 1e-4, -1.3, 1.2, 0.3]])
    done = compensate(short, nominal, start)
    assert done.status[0] == PointStatus.UNREACHABLE
    distance, _ = remaining_error(short, nominal, done.joints_rad, start)
    assert distance[0] == pytest.approx(done.position_error_m[0], abs=1e-12)
    assert 1e-5 < distance[0] < 1e-3


def test_a_wrist_in_line_keeps_its_branch_and_says_so():
    real, nominal = model_pair("abb_irb120", seed=7)
    start = np.array([[0.3, 0.2, -0.1, 0.9, 1e-6, 0.4]])
    done = compensate(real, nominal, start)
    assert done.status[0] == PointStatus.BRANCH_KEPT
    assert np.abs(done.joints_rad - start).max() <= 0.5 + 1e-12
    wide = compensate(real, nominal, start, limits=CompensationLimits(branch_rad=4.0))
    assert wide.status[0] == PointStatus.CONVERGED, "only the branch was in the way"
    assert np.abs(wide.joints_rad - start).max() > 0.5


def test_a_joint_limit_in_the_way_is_named_and_kept():
    real, nominal = model_pair()
    start = np.array([[0.4, -1.2, 1.3, -1.3, 1.2, 0.3]])
    free = compensate(real, nominal, start)
    way = free.joints_rad[0] - start[0]
    upper = nominal.upper_rad.copy()
    joint = int(np.argmax(way))
    upper[joint] = start[0, joint] + way[joint] / 2
    fenced = replace(real, upper_rad=upper)
    done = compensate(fenced, nominal, start)
    assert free.has_converged.all()
    assert done.status[0] == PointStatus.LIMIT
    assert (done.joints_rad <= upper).all()
    assert 1e-7 < done.position_error_m[0] < remaining_error(real, nominal, start, start)[0][0]


def test_a_point_from_beyond_a_limit_says_limit():
    real, nominal = model_pair()
    start = np.array([[0.4, -1.2, 1.3, -1.3, 1.2, 0.3]])
    fenced = replace(real, upper_rad=np.where(np.arange(6) == 4, 1.0, real.upper_rad))
    done = compensate(fenced, nominal, start)
    assert done.status[0] == PointStatus.LIMIT
    assert np.abs(done.joints_rad - start).max() < 0.5


def test_neither_order_nor_blocks_nor_the_world_matter():
    real, nominal = model_pair()
    start = random_joints(nominal, 4500, seed=2)
    done = compensate(real, nominal, start)
    order = np.random.default_rng(0).permutation(len(start))
    mixed = compensate(real, nominal, start[order])
    assert np.array_equal(mixed.status, done.status[order])
    assert np.abs(mixed.joints_rad - done.joints_rad[order])[mixed.has_converged].max() < 1e-5
    world = homogeneous_matrix(exp_rotation(np.array([0.7, 2.0, -0.4])), np.array([3.0, -2.0, 1.0]))
    turned = [
        replace(m, placements=np.concatenate([(world @ m.placements[0])[None], m.placements[1:]]))
        for m in (real, nominal)
    ]
    elsewhere = compensate(*turned, start)
    alike = elsewhere.has_converged & done.has_converged
    assert alike.sum() > 0.999 * done.has_converged.sum()
    jacobians = nominal.flange_jacobian(start)[1]
    regular = alike & (np.linalg.svd(jacobians, compute_uv=False)[:, -1] > 0.02)
    assert np.abs(elsewhere.joints_rad - done.joints_rad)[regular].max() < 1e-5


def test_arms_far_apart_end_in_an_answer_too():
    nominal = load_model("ur10")
    rng = np.random.default_rng(6)
    grotesque = nominal.with_dh_errors(rng.normal(size=(6, 5)) * [0.2, 0.03, 0.03, 0.15, 0.15])
    start = random_joints(nominal, 1000, seed=3, share=0.5)
    done = compensate(grotesque, nominal, start)
    distance, angle = remaining_error(grotesque, nominal, done.joints_rad, start)
    ok = done.has_converged
    assert 0 < ok.sum() < 1000
    assert distance[ok].max() < 1.0001e-8
    assert angle[ok].max() < 2e-8
    assert np.abs(done.joints_rad - start).max() <= 0.5 + 1e-12
    assert np.allclose(done.angle_error_rad, angle, atol=1e-7)


def test_no_points_are_no_answer():
    real, nominal = model_pair()
    done = compensate(real, nominal, np.empty((0, 6)))
    assert isinstance(done, Compensation)
    assert done.joints_rad.shape == (0, 6)
    assert done.status.shape == (0,)


@pytest.mark.parametrize(
    "joints",
    [np.zeros(6), np.zeros((3, 5)), np.full((1, 6), np.nan), np.full((2, 6), np.inf)],
)
def test_invalid_postures_are_refused(joints):
    real, nominal = model_pair()
    with pytest.raises(CalibrationError):
        compensate(real, nominal, joints)


@pytest.mark.parametrize("bad", [0.0, -1e-8, np.nan, np.inf])
def test_meaningless_tolerances_are_refused(bad):
    real, nominal = model_pair()
    with pytest.raises(CalibrationError):
        compensate(real, nominal, np.zeros((1, 6)), limits=CompensationLimits(position_m=bad))


def test_a_tip_that_is_no_transform_is_refused():
    with pytest.raises(CalibrationError):
        TipArm(load_model("ur10"), np.diag([1.0, 1.0, 2.0, 1.0]))


@pytest.mark.parametrize("unknowns", [6, 7])
def test_the_step_is_the_damped_least_squares_one(unknowns):
    rng = np.random.default_rng(unknowns)
    columns, error = rng.normal(size=(unknowns, 6, 50)), rng.normal(size=(6, 50))
    damping = 10.0 ** rng.uniform(-12, 1, 50)
    step = damped_step(columns, error, damping)
    for i in range(50):
        jacobian = columns[:, :, i].T
        normal = jacobian @ jacobian.T + damping[i] * np.eye(6)
        expected = jacobian.T @ np.linalg.solve(normal, error[:, i])
        assert np.allclose(step[:, i], expected, rtol=1e-6, atol=1e-9)
