"""The nominal models against what makers and others publish, typed here by hand."""

import numpy as np
import pinocchio as pin
import pytest

from cellcal.calibration.arm.kinematics import load_model, model_names
from cellcal.calibration.arm.robot_models.model_text import read_model_text
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import log_rotation
from cellcal.calibration.orientation import values_from

NOMINAL = [
    "ur3e",
    "ur5e",
    "ur10e",
    "ur16e",
    "ur20",
    "ur30",
    "ur3",
    "ur5",
    "ur10",
    "abb_irb120",
    "fanuc_m6ib",
    "fanuc_r2000ic_165f",
    "kuka_kr6_r900",
    "yaskawa_ar2010",
]


def flange_at(name: str, degrees) -> np.ndarray:
    return load_model(name).base_flange(np.deg2rad([degrees]))[0]


def test_the_models_that_ship_are_these():
    assert sorted(NOMINAL) == list(model_names())


@pytest.mark.parametrize("name", NOMINAL)
def test_every_model_has_six_axes_with_limits_and_speeds(name):
    model = load_model(name)
    assert (model.name, model.axis_count) == (name, 6)
    assert len(set(model.joint_names)) == 6
    assert (model.upper_rad - model.lower_rad > np.deg2rad(90)).all()
    assert (model.max_speed_rad_s > 1).all()


def test_the_ur_simulator_reports_the_same_pose():
    """URSim 5.8, UR5e, primary interface: joints, and the pose it shows for them with no tool."""
    joints = np.array([[-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031]])
    matrix = load_model("ur5e").base_flange(joints)[0]
    shown = (-0.14396865671352163, -0.43562006080319216, 0.2020300254283846)
    turn = (-0.0012213596815925638, 3.1162765284819756, 0.038891915636886834)
    # The controller writes pi / 2 as 1.570796327, which is worth 2e-10 here.
    assert np.allclose(matrix[:3, 3], shown, atol=5e-10)
    assert np.allclose(log_rotation(matrix[:3, :3]), turn, atol=2e-9)


@pytest.mark.parametrize(
    ("name", "out_m", "side_m", "up_m"),
    [
        ("ur3e", -0.24355 - 0.2132, -0.13105 - 0.0921, 0.15185 - 0.08535),
        ("ur10", -0.612 - 0.5723, -0.163941 - 0.0922, 0.1273 - 0.1157),
        ("ur30", -0.637 - 0.5037, -0.201 - 0.1543, 0.2363 - 0.1593),
    ],
)
def test_a_ur_at_zero_lies_along_minus_x(name, out_m, side_m, up_m):
    matrix = flange_at(name, [0] * 6)
    assert np.allclose(matrix[:3, 3], (out_m, side_m, up_m), atol=1e-12)
    assert np.allclose(matrix[:3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "x_mm", "z_mm"), [("fanuc_m6ib", 150 + 615 + 100, 600 + 100), ("fanuc_r2000ic_165f", 1807, 1300)]
)
def test_a_fanuc_at_zero(name, x_mm, z_mm):
    matrix = flange_at(name, [0] * 6)
    assert np.allclose(matrix[:3, 3] * 1e3, (x_mm, 0, z_mm), atol=1e-9)
    assert np.allclose(np.rad2deg(values_from("fanuc_wpr", matrix[:3, :3])), (180, -90, 0), atol=1e-6)


@pytest.mark.parametrize(("name", "reach_mm"), [("fanuc_m6ib", 1373), ("fanuc_r2000ic_165f", 2655)])
def test_the_published_reach_of_the_wrist_centre(name, reach_mm):
    """The forearm is level, the upper arm as level as J2 goes: 76 degrees on the large one."""
    model = load_model(name)
    a1, a2, a3 = model.dh.a_m[:3]
    reach = a1 + a2 * np.sin(min(model.upper_rad[1], np.pi / 2)) + np.hypot(a3, model.dh.d_m[3])
    assert round(reach * 1e3) == reach_mm


def test_a_fanuc_forearm_stays_level_when_only_j2_moves():
    """J3 is measured against the horizon."""
    level, leaning = flange_at("fanuc_m6ib", [0] * 6), flange_at("fanuc_m6ib", [0, 30, 0, 0, 0, 0])
    assert np.allclose(level[:3, :3], leaning[:3, :3], atol=1e-12)
    assert np.allclose(leaning[:3, 3] - level[:3, 3], (0.6 * 0.5, 0, 0.6 * (np.sqrt(0.75) - 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("joints", "x_mm", "z_mm"), [((0, 0, 0, 0, 0, 0), 980, 435), ((0, -90, 90, 0, 0, 0), 525, 890)]
)
def test_a_kuka_stretched_and_upright(joints, x_mm, z_mm):
    matrix = flange_at("kuka_kr6_r900", joints)
    assert np.allclose(matrix[:3, 3] * 1e3, (x_mm, 0, z_mm), atol=1e-9)
    assert np.allclose(np.rad2deg(values_from("kuka_abc", matrix[:3, :3])), (0, 90, 0), atol=1e-6)


def test_an_ar2010_at_zero():
    """The upper arm upright, the forearm and the flange level; reach and heights of the maker's drawing."""
    matrix = flange_at("yaskawa_ar2010", [0] * 6)
    assert np.allclose(matrix[:3, 3] * 1e3, (150 + 1082 + 100, 0, 760 + 200), atol=1e-9)
    assert np.allclose(matrix[:3, 2], (1, 0, 0), atol=1e-12)
    model = load_model("yaskawa_ar2010")
    assert round((model.dh.a_m[:2].sum() + np.hypot(0.200, 1.082)) * 1e3) == 2010


def test_a_kuka_turns_a1_clockwise_from_above():
    assert (
        flange_at("kuka_kr6_r900", [30, 0, 0, 0, 0, 0])[1, 3]
        < 0
        < flange_at("abb_irb120", [30, 0, 0, 0, 0, 0])[1, 3]
    )


def test_an_irb_120_at_zero():
    matrix = flange_at("abb_irb120", [0] * 6)
    assert np.allclose(matrix[:3, 3] * 1e3, (374, 0, 630), atol=1e-9)
    assert np.allclose(
        values_from("abb_quaternion", matrix[:3, :3]), (np.sqrt(0.5), 0, np.sqrt(0.5), 0), atol=1e-9
    )


@pytest.mark.parametrize(
    ("joints_deg", "shown_mm"),
    [
        ((-74.5, 33.9, -30.8, -15.1, 80.5, -59.7), (106.2, -451.9, 498.9)),
        ((-67.0, 33.8, -30.8, -15.1, 80.5, -59.7), (164.4, -433.8, 499.5)),
    ],
)
def test_an_irb_120_controller_shows_the_same_place(joints_deg, shown_mm):
    """First rows of RobotCali (Li, Li, Luo 2021); the joints there are rounded to 0.1 degrees."""
    assert np.allclose(flange_at("abb_irb120", joints_deg)[:3, 3] * 1e3, shown_mm, atol=0.8)


# ROS-Industrial's descriptions: origin and axis of each joint, then the turn to tool0 [m, rad].
HALF = np.pi / 2
PUBLISHED = {
    "abb_irb120": (
        [(0, 0, 0), (0, 0, 0.29), (0, 0, 0.27), (0, 0, 0.07), (0.302, 0, 0), (0.072, 0, 0)],
        [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)],
        (0, HALF, 0),
    ),
    "kuka_kr6_r900": (
        [(0, 0, 0.4), (0.025, 0, 0), (0.455, 0, 0), (0, 0, 0.035), (0.42, 0, 0), (0.08, 0, 0)],
        [(0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0)],
        (0, HALF, 0),
    ),
    "fanuc_m6ib": (  # its base link is 0.450 m below FANUC's world
        [(0, 0, 0), (0.15, 0, 0), (0, 0, 0.6), (0, 0, 0.1), (0.615, 0, 0), (0.1, 0, 0)],
        [(0, 0, 1), (0, 1, 0), (0, -1, 0), (-1, 0, 0), (0, -1, 0), (-1, 0, 0)],
        (np.pi, -HALF, 0),
    ),
    "fanuc_r2000ic_165f": (
        [(0, 0, 0), (0.312, 0, 0), (0, 0, 1.075), (0, 0, 0.225), (1.28, 0, 0), (0.215, 0, 0)],
        [(0, 0, 1), (0, 1, 0), (0, -1, 0), (-1, 0, 0), (0, -1, 0), (-1, 0, 0)],
        (np.pi, -HALF, 0),
    ),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_ros_industrial_draws_the_same_arm(name):
    origins, axes, tool_rpy = PUBLISHED[name]
    model = load_model(name)
    joints = np.random.default_rng(6).uniform(model.lower_rad, model.upper_rad, (20, 6))
    geometric = joints.copy()
    if name.startswith("fanuc"):
        geometric[:, 2] += joints[:, 1]
    for q, ours in zip(geometric, model.base_flange(joints), strict=True):
        frame = pin.SE3.Identity()
        for origin, axis, angle in zip(origins, axes, q, strict=True):
            offset, turn = np.array(origin, dtype=float), pin.exp3(np.array(axis) * angle)
            frame = frame * pin.SE3(turn, offset)
        frame = frame * pin.SE3(pin.rpy.rpyToMatrix(*tool_rpy), np.zeros(3))
        assert np.allclose(ours, frame.homogeneous, atol=1e-12)


def test_an_unknown_model_names_the_nearest():
    with pytest.raises(CalibrationError, match="Did you mean ur10e"):
        load_model("ur10ee")
    with pytest.raises(CalibrationError, match="Known: abb_irb120"):
        load_model("../secrets")


GOOD = """
title = "two bars"
joints = ["a", "b"]
dh_source = "here"
theta_deg = [0, 90]
d_mm = [100, 0]
a_mm = [0, 200]
alpha_deg = [90, 0]
interaction = [[2, 1, 0.5]]
interaction_source = "here"
limits_source = "here"
lower_deg = [-10, -20]
upper_deg = [10, 20]
speed_source = "here"
speed_deg_s = [100, 200]
"""


def test_a_file_is_read_in_si():
    fields = read_model_text("bars", GOOD).fields
    assert np.allclose(fields["rows"], [[0, 0.1, 0, np.pi / 2], [np.pi / 2, 0, 0.2, 0]])
    assert np.allclose(fields["joint_coupling"], [[1, 0], [0.5, 1]])
    assert np.allclose(fields["max_speed_rad_s"], np.deg2rad([100, 200]))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('dh_source = "here"', ""),
        ('dh_source = "here"', 'dh_source = "here"\nsurprise = 1'),
        ("d_mm = [100, 0]", "d_mm = [100]"),
        ("d_mm = [100, 0]", "d_mm = [100, nan]"),
        ('title = "two bars"', 'title = "two bars"\nsign = [1, 2]'),
        ("[[2, 1, 0.5]]", "[[3, 1, 0.5]]"),
        ("[[2, 1, 0.5]]", "[[0, 1, 0.5]]"),
        ('interaction_source = "here"', ""),
    ],
)
def test_a_damaged_file_is_refused(old, new):
    assert old in GOOD
    with pytest.raises(CalibrationError, match="bars"):
        read_model_text("bars", GOOD.replace(old, new, 1))
