"""Forward kinematics and every derivative, against Pinocchio, differences and fifty digits."""

import math

import mpmath
import numpy as np
import pinocchio as pin
import pytest

from cellcal.calibration.arm.kinematics import (
    DhTable,
    RobotModel,
    chain_frames,
    joint_columns,
    load_model,
    model_names,
    placement_columns,
)
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import exp_twist, is_rigid, log_transform

TIP = np.array([0.06, 0.05, 0.12])


def some_joints(model: RobotModel, count: int = 12, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).uniform(model.lower_rad, model.upper_rad, (count, model.axis_count))


def bent_model(model: RobotModel, seed: int = 8) -> RobotModel:
    """Return the model with large errors in every DH parameter and placement."""
    rng = np.random.default_rng(seed)
    return model.with_dh_errors(rng.normal(scale=0.02, size=(model.axis_count, 5)))


def twisted_model(model: RobotModel, seed: int = 9) -> RobotModel:
    return bent_model(model).with_twists(
        np.random.default_rng(seed).normal(scale=0.02, size=(model.axis_count + 1, 6))
    )


def pinocchio_twin(model: RobotModel) -> tuple[pin.Model, int]:
    """Build the same chain in Pinocchio; its joint angles are the DH angles u."""
    twin, parent = pin.Model(), 0
    for name, placement in zip(model.joint_names, model.placements, strict=False):
        parent = twin.addJoint(parent, pin.JointModelRZ(), pin.SE3(np.array(placement)), name)
    tip = pin.SE3(np.array(model.placements[-1])) * pin.SE3(np.eye(3), TIP)
    return twin, twin.addFrame(pin.Frame("tip", parent, tip, pin.FrameType.OP_FRAME))


def dh_angles(model: RobotModel, joints: np.ndarray) -> np.ndarray:
    return joints @ model.joint_coupling.T + model.theta0_rad


@pytest.mark.parametrize("name", model_names())
@pytest.mark.parametrize("change", [lambda m: m, twisted_model], ids=["nominal", "twisted"])
def test_pinocchio_agrees_on_positions_and_jacobians(name, change):
    model = change(load_model(name))
    twin, frame = pinocchio_twin(model)
    data, joints = twin.createData(), some_joints(model)
    positions, jacobian = model.tip_jacobian(joints, TIP)
    flange, flange_jacobian = model.flange_jacobian(joints)
    for i, u in enumerate(dh_angles(model, joints)):
        pin.computeJointJacobians(twin, data, u)
        pin.updateFramePlacements(twin, data)
        tip = data.oMf[frame]
        twin_jacobian = (
            pin.getFrameJacobian(twin, data, frame, pin.LOCAL_WORLD_ALIGNED) @ model.joint_coupling
        )
        assert np.allclose(positions[i], tip.translation, rtol=0, atol=1e-12)
        assert np.allclose(flange[i, :3, :3], tip.rotation, rtol=0, atol=1e-12)
        assert np.allclose(jacobian[i], twin_jacobian[:3], rtol=0, atol=1e-12)
        assert np.allclose(flange_jacobian[i, 3:], twin_jacobian[3:], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", model_names())
def test_pinocchio_agrees_on_the_placement_regressor(name):
    model = twisted_model(load_model(name))
    twin, frame = pinocchio_twin(model)
    data, joints = twin.createData(), some_joints(model)
    positions, regressor = model.placement_regressor(joints, TIP)
    for i, u in enumerate(dh_angles(model, joints)):
        pin.forwardKinematics(twin, data, u)
        pin.updateFramePlacements(twin, data)
        local = pin.computeFrameKinematicRegressor(twin, data, frame, pin.LOCAL)
        ours = regressor[i, :, :-1].reshape(3, -1)
        assert np.allclose(positions[i], data.oMf[frame].translation, rtol=0, atol=1e-12)
        assert np.allclose(ours, data.oMf[frame].rotation @ local[:3], rtol=0, atol=1e-12)


def central_differences(function, size: int, step: float = 1e-6) -> np.ndarray:
    """Return central differences of a function of ``size`` numbers, on the last axis."""
    shifts = np.eye(size) * step
    return np.stack([(function(s) - function(-s)) / (2 * step) for s in shifts], axis=-1)


@pytest.mark.parametrize("name", ["ur10", "fanuc_m6ib", "kuka_kr6_r900", "abb_irb120"])
@pytest.mark.parametrize("change", [lambda m: m, bent_model], ids=["nominal", "bent"])
def test_the_dh_regressor_is_the_derivative(name, change):
    model = change(load_model(name))
    joints = some_joints(model)
    positions, regressor = model.dh_regressor(joints, TIP)
    numeric = central_differences(
        lambda e: model.with_dh_errors(e.reshape(-1, 5)).tip_positions(joints, TIP), model.axis_count * 5
    )
    assert np.allclose(positions, model.tip_positions(joints, TIP), atol=1e-15)
    assert np.allclose(regressor.reshape(*numeric.shape), numeric, atol=1e-8)


@pytest.mark.parametrize("name", ["ur10", "fanuc_m6ib"])
def test_the_placement_regressor_is_the_derivative(name):
    model = twisted_model(load_model(name))
    joints = some_joints(model)
    _, regressor = model.placement_regressor(joints, TIP)
    size = (model.axis_count + 1) * 6
    numeric = central_differences(
        lambda e: model.with_twists(e.reshape(-1, 6)).tip_positions(joints, TIP), size
    )
    assert np.allclose(regressor.reshape(*numeric.shape), numeric, atol=1e-8)


@pytest.mark.parametrize("name", ["ur10", "fanuc_m6ib", "kuka_kr6_r900"])
def test_the_jacobians_are_the_derivatives_by_what_the_pendant_shows(name):
    model = twisted_model(load_model(name))
    joints = some_joints(model)
    _, tip_jacobian = model.tip_jacobian(joints, TIP)
    flange, jacobian = model.flange_jacobian(joints)
    assert np.allclose(
        tip_jacobian,
        central_differences(lambda e: model.tip_positions(joints + e, TIP), model.axis_count),
        atol=1e-8,
    )
    body = central_differences(
        lambda e: log_transform(np.linalg.inv(flange) @ model.base_flange(joints + e)), model.axis_count
    )
    world = np.concatenate([flange[:, :3, :3] @ body[:, :3], flange[:, :3, :3] @ body[:, 3:]], axis=1)
    assert np.allclose(jacobian, world, atol=1e-8)


def test_fifty_digits_agree():
    model = bent_model(load_model("ur5e"))
    joints = some_joints(model, 3)
    flange = model.base_flange(joints)
    with mpmath.workdps(50):
        for q, ours in zip(joints, flange, strict=True):
            exact = mpmath.eye(4)
            for (theta, d, a, alpha, beta), angle in zip(model.dh.to_rows(), q, strict=True):
                exact = (
                    exact * axis_rotation("z", mpmath.mpf(theta) + mpmath.mpf(angle)) * translation(a, 0, d)
                )
                exact = exact * axis_rotation("x", mpmath.mpf(alpha)) * axis_rotation("y", mpmath.mpf(beta))
            error = max(abs(exact[i, j] - mpmath.mpf(ours[i, j])) for i in range(4) for j in range(4))
            assert error < 3e-15


def axis_rotation(axis: str, angle):
    c, s = mpmath.cos(angle), mpmath.sin(angle)
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    matrix = mpmath.eye(4)
    matrix[j, j] = matrix[k, k] = c
    matrix[k, j], matrix[j, k] = s, -s
    return matrix


def translation(x, y, z):
    matrix = mpmath.eye(4)
    matrix[0, 3], matrix[1, 3], matrix[2, 3] = x, y, z
    return matrix


def test_the_kernel_gives_every_frame_of_the_chain():
    model = twisted_model(load_model("fanuc_m6ib"))
    joints = some_joints(model)
    rotations, origins = chain_frames(model, joints)
    assert rotations.shape == (7, 3, 3, len(joints))
    assert origins.shape == (7, 3, len(joints))
    for i, u in enumerate(dh_angles(model, joints)):
        frame = model.placements[0]
        for k in range(7):
            assert np.allclose(rotations[k, :, :, i], frame[:3, :3], atol=1e-13)
            assert np.allclose(origins[k, :, i], frame[:3, 3], atol=1e-13)
            if k < 6:
                frame = frame @ exp_twist(np.array([0, 0, 0, 0, 0, u[k]])) @ model.placements[k + 1]


def test_the_kernels_columns_are_those_of_the_model():
    model = twisted_model(load_model("fanuc_m6ib"))
    joints = some_joints(model)
    rotations, origins = chain_frames(model, joints)
    tip = model.tip_positions(joints, TIP).T
    columns = placement_columns(rotations, origins, tip)
    again = placement_columns(rotations, origins, tip, out=np.full_like(columns, np.nan))
    assert np.array_equal(columns, again)
    assert np.allclose(columns.transpose(3, 2, 0, 1), model.placement_regressor(joints, TIP)[1], atol=1e-15)
    assert np.allclose(
        joint_columns(model, rotations, origins, tip).transpose(2, 1, 0), model.tip_jacobian(joints, TIP)[1]
    )
    assert rotations[3, :, 1].flags.c_contiguous
    assert origins[3].flags.c_contiguous


def test_each_pose_may_have_its_own_tip():
    model = load_model("ur5e")
    joints = some_joints(model)
    tips = np.random.default_rng(0).normal(scale=0.1, size=(len(joints), 3))
    positions, jacobian = model.tip_jacobian(joints, tips)
    for i, tip in enumerate(tips):
        one, column = model.tip_jacobian(joints[i : i + 1], tip)
        assert np.allclose(positions[i], one[0], atol=1e-15)
        assert np.allclose(jacobian[i], column[0], atol=1e-15)


def test_a_changed_model_is_another_model():
    model = load_model("ur5e")
    joints = some_joints(model)
    before = model.base_flange(joints)
    changed = model.with_dh_errors(np.full((6, 5), 1e-3)).with_twists(np.full((7, 6), 1e-3))
    assert np.array_equal(model.base_flange(joints), before)
    assert not np.allclose(changed.base_flange(joints), before)
    assert is_rigid(changed.base_flange(joints), tolerance=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        model.placements[0, 0, 0] = 2.0


def test_no_error_changes_nothing():
    model = load_model("fanuc_m6ib")
    joints = some_joints(model)
    same = model.with_dh_errors(np.zeros((6, 5))).with_twists(np.zeros((7, 6)))
    assert np.allclose(same.base_flange(joints), model.base_flange(joints), atol=1e-15)


def test_an_arm_without_poses_has_no_positions():
    model = load_model("ur5e")
    assert model.base_flange(np.empty((0, 6))).shape == (0, 4, 4)
    assert model.tip_jacobian(np.empty((0, 6)), TIP)[1].shape == (0, 3, 6)


UR = load_model("ur5e")
ONE = np.zeros((1, 6))


@pytest.mark.parametrize(
    "bad",
    [
        lambda: UR.base_flange(np.zeros(6)),
        lambda: UR.base_flange(np.zeros((2, 7))),
        lambda: UR.base_flange(np.full((2, 6), math.nan)),
        lambda: UR.tip_positions(ONE, np.zeros(2)),
        lambda: UR.tip_positions(ONE, np.zeros((2, 3))),
        lambda: UR.tip_positions(ONE, np.array([0, 0, math.inf])),
        lambda: UR.with_twists(np.zeros((6, 6))),
        lambda: UR.with_twists(np.zeros((7, 6))).dh_regressor(ONE, TIP),
        lambda: UR.with_twists(np.zeros((7, 6))).with_dh_errors(np.zeros((6, 5))),
        lambda: DhTable.from_rows(np.zeros((6, 3))),
        lambda: DhTable(np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(3), np.zeros(3)),
        lambda: RobotModel.from_dh(UR.dh, name="a", joint_coupling=np.zeros((6, 6))),
        lambda: RobotModel.from_dh(UR.dh, name="a", joint_coupling=np.eye(5)),
        lambda: RobotModel.from_dh(UR.dh, name="a", lower_rad=np.ones(6), upper_rad=np.zeros(6)),
        lambda: RobotModel.from_dh(UR.dh, name="a", base=np.diag([1.0, 1, -1, 1])),
        lambda: RobotModel.from_dh(DhTable.from_rows(np.full((6, 4), math.nan)), name="a"),
    ],
)
def test_what_is_no_arm_or_no_pose_is_refused(bad):
    with pytest.raises(CalibrationError):
        bad()


def test_a_base_may_stand_anywhere():
    base = exp_twist(np.array([1, 2, 3, 0.1, 0.2, 0.3]))
    moved = RobotModel.from_dh(UR.dh, name="wall", base=base)
    joints = some_joints(UR)
    assert np.allclose(moved.base_flange(joints), base @ UR.base_flange(joints), atol=1e-13)
    shaken = moved.with_dh_errors(np.full((6, 5), 1e-3))
    assert np.allclose(shaken.placements[0], base, atol=1e-15)
