"""Poses, rotations, twists, and every maker's way to write an orientation."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import (
    Pose,
    exp_rotation,
    exp_twist,
    inverse_transform,
    is_rigid,
    log_rotation,
    log_transform,
    mean_rotation,
    nearest_rotation,
    quaternion_from_rotation,
    rotation_from_quaternion,
    skew_matrix,
)
from cellcal.calibration.orientation import (
    CONVENTIONS,
    euler_angles,
    euler_rotation,
    rotation_from,
    values_from,
)

DEG = math.pi / 180
unit = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 1e-3)
vector = st.lists(st.floats(-10, 10), min_size=3, max_size=3)
angles = st.lists(st.floats(-7, 7), min_size=3, max_size=3)
AXES = ["xyz", "xzy", "yxz", "yzx", "zxy", "zyx", "zyz", "zxz", "xyx", "xzx", "yxy", "yzy"]


@given(unit)
def test_quaternions_survive_the_matrix(numbers):
    quaternion = np.array(numbers) / np.linalg.norm(numbers)
    back = quaternion_from_rotation(rotation_from_quaternion(quaternion))
    assert min(np.abs(back - quaternion).max(), np.abs(back + quaternion).max()) < 1e-14
    assert back[0] >= 0


@given(unit)
def test_quaternions_agree_with_scipy(numbers):
    w, x, y, z = np.array(numbers) / np.linalg.norm(numbers)
    assert np.allclose(
        rotation_from_quaternion(np.array([w, x, y, z])), Rotation([x, y, z, w]).as_matrix(), atol=1e-14
    )


@given(vector, unit, vector, unit)
def test_poses_chain_and_invert(p, q, r, s):
    one = Pose(tuple(p), tuple(np.array(q) / np.linalg.norm(q)))
    two = Pose(tuple(r), tuple(np.array(s) / np.linalg.norm(s)))
    assert np.allclose((one @ two).to_matrix(), one.to_matrix() @ two.to_matrix(), atol=1e-13)
    assert np.allclose((one @ one.inverse()).to_matrix(), np.eye(4), atol=1e-13)


@pytest.mark.parametrize(
    "bad",
    [
        lambda: Pose((math.nan, 0, 0)),
        lambda: Pose((0, 0, 0), (1, 1, 0, 0)),
        lambda: Pose.from_matrix(np.diag([1.0, 1, -1, 1])),
        lambda: Pose.from_matrix(np.diag([1.0, 1, 1.1, 1])),
        lambda: nearest_rotation(np.zeros((3, 3))),
        lambda: nearest_rotation(np.diag([1.0, 0, 0])),
    ],
)
def test_what_is_no_pose_is_refused(bad):
    with pytest.raises(CalibrationError):
        bad()


@pytest.mark.parametrize("defect", [(0, 0, 1.01), (3, 0, 0.1), (1, 1, math.nan), (3, 3, 2.0)])
def test_a_damaged_matrix_is_not_rigid(defect):
    row, column, value = defect
    matrix = exp_twist(np.array([1, 2, 3, 0.1, 0.2, 0.3]))
    assert is_rigid(matrix)
    matrix[row, column] = value
    assert not is_rigid(matrix)


@given(angles)
@example([0.0, 0.0, 0.0])
@example([1e-9, 0.0, 0.0])
@example([math.pi, 0.0, 0.0])
@example([0.0, -math.pi, 0.0])
def test_rotation_vectors_survive_the_matrix(numbers):
    turn = np.array(numbers)
    rotation = exp_rotation(turn)
    assert np.allclose(rotation, Rotation.from_rotvec(turn).as_matrix(), atol=1e-14)
    back = log_rotation(rotation)
    assert np.linalg.norm(back) <= math.pi + 1e-12
    assert np.allclose(exp_rotation(back), rotation, atol=1e-13)


@pytest.mark.parametrize("turn", [(math.pi, 0, 0), (0, math.pi, 0), (0, 0, math.pi)])
def test_half_a_turn_has_one_name(turn):
    assert np.allclose(log_rotation(exp_rotation(np.array(turn))), turn, atol=1e-12)
    assert np.allclose(log_rotation(exp_rotation(-np.array(turn))), turn, atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-6, 9.99e-4, 1.001e-3, 0.1, 2.0, 3.1])
def test_twists_survive_the_exponential(size):
    rng = np.random.default_rng(4)
    turns = rng.normal(size=(20, 3))
    turns *= size / np.linalg.norm(turns, axis=1, keepdims=True)
    twists = np.hstack([rng.normal(size=(20, 3)), turns])
    assert np.allclose(log_transform(exp_twist(twists)), twists, atol=1e-12)


def test_the_twist_is_the_generator_of_the_screw():
    twist = np.array([0.3, -0.2, 0.7, 0.5, 1.1, -0.4])
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = skew_matrix(twist[3:]), twist[:3]
    series, term = np.eye(4), np.eye(4)
    for k in range(1, 40):
        term = term @ generator / k
        series = series + term
    assert np.allclose(exp_twist(twist), series, atol=1e-14)


def test_many_inverses_at_once():
    matrices = exp_twist(np.random.default_rng(0).normal(size=(5, 4, 6)))
    assert np.allclose(matrices @ inverse_transform(matrices), np.eye(4), atol=1e-13)


def test_the_mean_rotation_lies_in_the_middle():
    centre = exp_rotation(np.array([0.4, -1.0, 2.0]))
    turns = np.array([[0.1, 0, 0], [-0.1, 0, 0], [0, 0.2, 0], [0, -0.2, 0]])
    assert np.allclose(mean_rotation(centre @ exp_rotation(turns)), centre, atol=1e-12)


@pytest.mark.parametrize("axes", AXES)
def test_angles_agree_with_scipy(axes):
    rotations = Rotation.random(200, rng=np.random.default_rng(2))
    assert np.allclose(
        euler_angles(axes, rotations.as_matrix()), rotations.as_euler(axes.upper()), atol=1e-12
    )


@pytest.mark.parametrize("axes", AXES)
@settings(max_examples=40)
@given(
    angles, st.sampled_from([0.0, 1e-15, 1e-12, 1e-10, 1e-8, 1e-5]), st.sampled_from([0.0, 0.5, 1.0, -0.5])
)
def test_angles_keep_all_digits_of_the_rotation_at_and_around_gimbal_lock(axes, numbers, distance, quarter):
    a, _, c = numbers
    rotation = euler_rotation(axes, np.array([a, quarter * math.pi + distance, c]))
    assert np.allclose(euler_rotation(axes, euler_angles(axes, rotation)), rotation, atol=2e-9)


@pytest.mark.parametrize("name", CONVENTIONS)
@given(angles)
def test_every_convention_survives_the_matrix(name, numbers):
    rotation = exp_rotation(np.array(numbers))
    values = values_from(name, rotation)
    assert values.shape == (len(CONVENTIONS[name].fields),)
    assert np.allclose(rotation_from(name, values), rotation, atol=2e-9)


@pytest.mark.parametrize("name", CONVENTIONS)
def test_every_convention_works_on_many_at_once(name):
    rotations = exp_rotation(np.random.default_rng(1).normal(size=(4, 5, 3)))
    values = values_from(name, rotations)
    assert values.shape[:2] == (4, 5)
    assert np.allclose(values[2, 3], values_from(name, rotations[2, 3]), atol=1e-13)
    assert np.allclose(rotation_from(name, values), rotations, atol=1e-12)


@pytest.mark.parametrize("name", CONVENTIONS)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_every_convention_refuses_what_is_not_finite(name, bad):
    with pytest.raises(CalibrationError):
        rotation_from(name, [bad] + [0.0] * (len(CONVENTIONS[name].fields) - 1))
    with pytest.raises(CalibrationError):
        values_from(name, np.full((3, 3), bad))


def axis_rotation(axis, degrees):
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


@pytest.mark.parametrize(
    ("name", "values", "rotation"),
    [
        ("fanuc_wpr", (10, 20, 30), axis_rotation("z", 30) @ axis_rotation("y", 20) @ axis_rotation("x", 10)),
        ("kuka_abc", (10, 20, 30), axis_rotation("z", 10) @ axis_rotation("y", 20) @ axis_rotation("x", 30)),
        (
            "yaskawa_rpy",
            (10, 20, 30),
            axis_rotation("z", 30) @ axis_rotation("y", 20) @ axis_rotation("x", 10),
        ),
        (
            "staubli_rxryrz",
            (10, 20, 30),
            axis_rotation("x", 10) @ axis_rotation("y", 20) @ axis_rotation("z", 30),
        ),
        (
            "kawasaki_oat",
            (10, 20, 30),
            axis_rotation("z", 10) @ axis_rotation("y", 20) @ axis_rotation("z", 30),
        ),
        ("comau_zyz", (10, 20, 30), axis_rotation("z", 10) @ axis_rotation("y", 20) @ axis_rotation("z", 30)),
        ("ros_rpy", (10, 20, 30), axis_rotation("z", 30) @ axis_rotation("y", 20) @ axis_rotation("x", 10)),
        ("ur_rotation_vector", (0, 90, 0), axis_rotation("y", 90)),
        (
            "instrument_xyz",
            (10, 20, 30),
            axis_rotation("x", 10) @ axis_rotation("y", 20) @ axis_rotation("z", 30),
        ),
        (
            "instrument_zyx",
            (10, 20, 30),
            axis_rotation("z", 30) @ axis_rotation("y", 20) @ axis_rotation("x", 10),
        ),
        (
            "mitsubishi_abc",
            (10, 20, 30),
            axis_rotation("z", 30) @ axis_rotation("y", 20) @ axis_rotation("x", 10),
        ),
        ("epson_uvw", (10, 20, 30), axis_rotation("z", 10) @ axis_rotation("y", 20) @ axis_rotation("x", 30)),
    ],
)
def test_angles_mean_what_the_maker_means(name, values, rotation):
    assert np.allclose(rotation_from(name, np.array(values) * DEG), rotation, atol=1e-14)


def test_yaskawas_angles_are_those_of_the_makers_own_software():
    """Yaskawa's MotoROS2 makes the quaternion of a controller's Rx, Ry, Rz by this sum (src/Quaternion_Conversion.c).

    Its source calls the same angles "ZYX euler" where it makes frames of them (src/PositionMonitor.c).
    """
    angles = np.random.default_rng(4).uniform(-1.5, 1.5, (50, 3))
    (c1, c2, c3), (s1, s2, s3) = np.cos(angles / 2).T, np.sin(angles / 2).T
    xyzw = (
        s1 * c2 * c3 - c1 * s2 * s3,
        c1 * s2 * c3 + s1 * c2 * s3,
        c1 * c2 * s3 - s1 * s2 * c3,
        c1 * c2 * c3 + s1 * s2 * s3,
    )
    expected = rotation_from("ros_quaternion", np.stack(xyzw, axis=-1))
    assert np.allclose(rotation_from("yaskawa_rpy", angles), expected, atol=1e-14)
    assert not np.allclose(rotation_from("staubli_rxryrz", angles), expected, atol=0.1)


def test_quaternions_are_in_the_makers_order():
    half = math.sqrt(0.5)
    assert np.allclose(rotation_from("abb_quaternion", (half, 0, 0, half)), axis_rotation("z", 90))
    assert np.allclose(rotation_from("ros_quaternion", (0, 0, half, half)), axis_rotation("z", 90))
    assert np.allclose(values_from("ros_quaternion", axis_rotation("z", 90)), (0, 0, half, half))


@pytest.mark.parametrize(
    ("name", "rotation", "degrees"),
    [
        ("fanuc_wpr", [[0, 0, 1], [0, -1, 0], [1, 0, 0]], (180, -90, 0)),  # the pendant at all joints zero
        ("kuka_abc", [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], (0, 90, 0)),
        ("kawasaki_oat", axis_rotation("z", 40), (0, 0, 40)),
    ],
)
def test_at_gimbal_lock_the_leftmost_angle_is_zero(name, rotation, degrees):
    assert np.allclose(values_from(name, np.array(rotation, dtype=float)) / DEG, degrees, atol=1e-9)


@pytest.mark.parametrize("values", [(1, 0, 0), (2, 0, 0, 0), (0, 0, 0, 0)])
def test_a_quaternion_of_another_length_is_refused(values):
    with pytest.raises(CalibrationError):
        rotation_from("abb_quaternion", values)


def test_a_printed_quaternion_is_made_unit():
    rotation = rotation_from("abb_quaternion", (0.70711, 0, 0, 0.70711))
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)


def test_an_unknown_convention_is_refused_with_the_known_ones():
    with pytest.raises(CalibrationError, match="fanuc_wpr"):
        rotation_from("fanuc_rpw", (0, 0, 0))


@pytest.mark.parametrize("matrix", [np.eye(3) * 1.01, np.diag([1.0, 1, -1]), np.eye(4)])
def test_what_is_no_rotation_has_no_angles(matrix):
    with pytest.raises(CalibrationError):
        values_from("fanuc_wpr", matrix)
