"""The columns that are no combinations of others, and what stands for the rest: Pinocchio and differences agree."""

import numpy as np
import pinocchio as pin
import pytest

from cellcal.calibration.arm.kinematics import (
    chain_frames,
    cosine_and_sine,
    independent_columns,
    load_model,
    model_names,
    placement_columns,
    twists_by_independent_columns,
)
from cellcal.calibration.geometry import exp_twist, log_rotation

_POSTURES = 40


def bent_model(name, seed=8):
    model, rng = load_model(name), np.random.default_rng(seed)
    model = model.with_dh_errors(rng.normal(scale=0.02, size=(model.axis_count, 5)))
    return model.with_twists(rng.normal(scale=0.02, size=(model.axis_count + 1, 6)))


def some_joints(model, seed=3):
    return np.random.default_rng(seed).uniform(
        model.lower_rad, model.upper_rad, (_POSTURES, model.axis_count)
    )


def columns_of(model, joints, scale=None):
    rotations, origins = chain_frames(model, joints)
    out = np.full((4 * model.axis_count + 4, 3, len(joints)), np.nan)
    return independent_columns(rotations, origins, out=out, scale=scale)


@pytest.mark.parametrize("name", model_names())
def test_every_twist_is_a_combination_of_the_independent_columns(name):
    model = bent_model(name)
    joints = some_joints(model)
    rotations, origins = chain_frames(model, joints)
    every = placement_columns(rotations, origins, origins[-1]).reshape(-1, 3 * _POSTURES)
    columns = columns_of(model, joints)[: 4 * model.axis_count + 3].reshape(-1, 3 * _POSTURES)
    rebuilt_columns = (
        twists_by_independent_columns(model.placements)[:, :-3] @ columns
    )  # the tip's own turns move no tip
    assert np.abs(rebuilt_columns - every).max() < 1e-13


@pytest.mark.parametrize("name", ["ur10", "fanuc_m6ib", "kuka_kr6_r900"])
def test_pinocchios_regressor_is_a_combination_of_the_independent_columns(name):
    model = bent_model(name)
    twin, parent = pin.Model(), 0
    for joint, placement in zip(model.joint_names, model.placements, strict=False):
        parent = twin.addJoint(parent, pin.JointModelRZ(), pin.SE3(np.array(placement)), joint)
    tip = pin.SE3(np.array(model.placements[-1]))
    frame = twin.addFrame(pin.Frame("tip", parent, tip, pin.FrameType.OP_FRAME))
    data, joints = twin.createData(), some_joints(model)
    columns = columns_of(model, joints)[: 4 * model.axis_count + 3]
    rebuilt_columns = np.tensordot(twists_by_independent_columns(model.placements)[:, :-3], columns, axes=1)
    for i, angles in enumerate(joints @ model.joint_coupling.T + model.theta0_rad):
        pin.forwardKinematics(twin, data, angles)
        pin.updateFramePlacements(twin, data)
        regressor = pin.computeFrameKinematicRegressor(twin, data, frame, pin.LOCAL_WORLD_ALIGNED)
        assert np.abs(rebuilt_columns[: 6 * model.axis_count, :, i].T - regressor[:3]).max() < 1e-13
        assert (
            np.abs(
                rebuilt_columns[6 * model.axis_count :, :, i].T - np.eye(3, 6) @ _tip_motions(data.oMf[frame])
            ).max()
            < 1e-13
        )


def _tip_motions(place):
    """Return how a twist of the last placement moves the tip: by its three ways in the base's axes."""
    turned = np.zeros((6, 6))
    turned[:3, :3] = turned[3:, 3:] = place.rotation
    return turned


@pytest.mark.parametrize("name", ["ur10", "fanuc_m6ib", "abb_irb120"])
def test_all_combinations_are_derivatives_of_place_and_attitude(name):
    model = bent_model(name)
    joints, step = some_joints(model), 1e-6
    columns = columns_of(model, joints)[: 4 * model.axis_count + 3]
    combine = twists_by_independent_columns(model.placements)
    places = np.tensordot(combine[:, :-3], columns, axes=1)
    rotations, _ = chain_frames(model, joints)
    # Of the motions behind the columns, turning about x and y of a frame turns the tip, and so do its own turns.
    turns = np.zeros((4 * model.axis_count + 6, 3, _POSTURES))
    for k in range(model.axis_count):
        turns[4 * k + 2], turns[4 * k + 3] = rotations[k, :, 0], rotations[k, :, 1]
    turns[-3:] = rotations[-1].swapaxes(0, 1)
    attitudes = np.tensordot(combine, turns, axes=1)
    for i in range(6 * (model.axis_count + 1)):
        twists = np.zeros((model.axis_count + 1, 6))
        twists.flat[i] = step
        there, back = (
            replace_placements(model, model.placements @ exp_twist(sign * twists)).base_flange(joints)
            for sign in (1.0, -1.0)
        )
        moved = (there[:, :3, 3] - back[:, :3, 3]) / (2 * step)
        turned = log_rotation(there[:, :3, :3] @ np.swapaxes(back[:, :3, :3], 1, 2)) / (2 * step)
        assert np.abs(places[i].T - moved).max() < 2e-9
        assert np.abs(attitudes[i].T - turned).max() < 2e-9


def replace_placements(model, placements):
    return type(model)(**{**model.__dict__, "placements": placements, "dh": None})


@pytest.mark.parametrize("name", ["ur10", "abb_irb120", "kuka_kr6_r900"])
def test_no_independent_column_is_a_combination_of_others(name):
    model = bent_model(name)  # a tip on the last axis would not tell all of the wrist
    columns = columns_of(model, some_joints(model))[: 4 * model.axis_count + 3].reshape(
        4 * model.axis_count + 3, -1
    )
    sizes = np.linalg.svd(columns / np.linalg.norm(columns, axis=1, keepdims=True), compute_uv=False)
    assert sizes[-1] > 1e-3 * sizes[0]


def test_a_scale_multiplies_all_columns_of_its_posture_and_further_rows_are_zero():
    model = load_model("ur10")
    joints, scale = some_joints(model), np.random.default_rng(0).uniform(0.1, 3.0, _POSTURES)
    plain, scaled = columns_of(model, joints), columns_of(model, joints, scale)
    assert np.abs(scaled - plain * scale).max() < 1e-14
    assert not plain[-1].any()


def test_cosine_and_sine_are_right_to_the_last_digits_at_any_angle():
    near = np.pi * np.arange(-4, 5)[:, None] / 2 + np.array([0.0, 1e-16, -1e-12, 1e-9, -1e-5])
    angles = np.concatenate(
        [near.ravel(), np.random.default_rng(0).uniform(-50, 50, 10_000), [1e6, -1e6, 1e-300]]
    )
    cosine, sine = cosine_and_sine(angles)
    assert np.abs(cosine - np.cos(angles)).max() < 4e-16
    assert np.abs(sine - np.sin(angles)).max() < 4e-16
    assert np.abs(cosine**2 + sine**2 - 1.0).max() < 1e-15
