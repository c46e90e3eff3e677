"""Universal Robots' kinematics files: three forms of one arm, in and out, and whose arm it is."""

import struct

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import DhTable, RobotModel, load_model
from cellcal.calibration.arm.standard_dh import standard_dh
from cellcal.calibration.arm.ur_factory import factory_model, table_of_hash
from cellcal.calibration.errors import CalibrationError
from cellcal.service.engineering.parameters.ur_files import (
    RosKinematics,
    UrKinematics,
    model_of_ros,
    read_calibration_conf,
    read_primary_kinematics,
    read_ros_kinematics,
    ros_frames,
    write_calibration_conf,
    write_primary_kinematics,
    write_ros_kinematics,
)
from tests.unit.test_ur_factory import ABSOLUTE, CONF, JOINTS

NOMINAL = load_model("ur10e")
ARM = factory_model(NOMINAL, ABSOLUTE)

# ur_calibration's own result for that arm is quoted in the maker's ROS documentation to the digits used below.
DEFAULT_UR10E = """
kinematics:
  shoulder:
    x: 0
    y: 0
    z: 0.1807
    roll: -0
    pitch: 0
    yaw: -0
  upper_arm:
    x: 0
    y: 0
    z: 0
    roll: 1.570796327
    pitch: 0
    yaw: 0
  forearm:
    x: -0.6127
    y: 0
    z: 0
    roll: 0
    pitch: 0
    yaw: 0
  wrist_1:
    x: -0.57155
    y: 0
    z: 0.17415
    roll: 0
    pitch: 0
    yaw: 0
  wrist_2:
    x: 0
    y: -0.11985
    z: -2.458164590756244e-11
    roll: 1.570796327
    pitch: 0
    yaw: 0
  wrist_3:
    x: 0
    y: 0.11655
    z: -2.390480459346185e-11
    roll: 1.570796326589793
    pitch: 3.141592653589793
    yaw: 3.141592653589793
  hash: calib_5119701370761913513
"""


def arm_reach_m(model):
    return model.base_flange(JOINTS)


def test_the_file_that_ros_ships_is_the_nominal_arm():
    read = read_ros_kinematics(DEFAULT_UR10E)
    assert np.allclose(arm_reach_m(model_of_ros(read, NOMINAL)), arm_reach_m(NOMINAL), atol=5e-9)
    assert read.hash == UrKinematics(NOMINAL.dh).factory_hash
    assert np.allclose(ros_frames(NOMINAL), read.frames, atol=5e-9)


def test_frames_of_a_real_arm_are_those_of_ur_calibration():
    frames = ros_frames(ARM)
    assert frames[2][0, 3] == pytest.approx(-0.612541, abs=5e-7)
    assert np.allclose(frames[3][:3, 3], (-0.571354, -0.001207, 0.174508), atol=1e-6)


def test_ros_kinematics_go_out_and_come_back():
    text = write_ros_kinematics(RosKinematics(ros_frames(ARM), UrKinematics(ABSOLUTE).factory_hash))
    back = read_ros_kinematics(text)
    assert np.allclose(arm_reach_m(model_of_ros(back, NOMINAL)), arm_reach_m(ARM), rtol=0, atol=1e-11)
    assert back.hash == UrKinematics(ABSOLUTE).factory_hash
    assert back.hash != UrKinematics(NOMINAL.dh).factory_hash


def test_angles_are_turned_about_x_then_y_then_z_of_the_moving_frame():
    frame = read_ros_kinematics(
        DEFAULT_UR10E.replace("yaw: -0", "yaw: 0.3").replace("roll: -0", "roll: 0.2")
    ).frames[0]
    c, s = np.cos(0.3), np.sin(0.3)
    turned = [[1, 0, 0], [0, np.cos(0.2), -np.sin(0.2)], [0, np.sin(0.2), np.cos(0.2)]] @ np.array(
        [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    )
    assert np.allclose(frame[:3, :3], turned, atol=1e-12)


def test_calibration_conf_goes_out_and_comes_back():
    read = read_calibration_conf(CONF, NOMINAL)
    back = read_calibration_conf(write_calibration_conf(read, NOMINAL), NOMINAL)
    assert np.array_equal(back.table.to_rows(), read.table.to_rows())
    assert back.joint_checksum == read.joint_checksum
    assert back.factory_hash == read.factory_hash


def test_an_arm_that_was_not_linearised_stays_so():
    text = CONF.replace("calibration_status = 2", "calibration_status = 1")
    read = read_calibration_conf(text, NOMINAL)
    assert "calibration_status = 1" in write_calibration_conf(read, NOMINAL)


def test_the_primary_interface_goes_out_and_comes_back_among_other_messages():
    kinematics = UrKinematics(ABSOLUTE, (1, 2, 3, 4, 5, 0xFFFFFFFE), 2)
    message = write_primary_kinematics(kinematics)
    assert len(message) == 5 + 225
    version = struct.pack(">iB", 9, 20) + b"text"
    other = struct.pack(">iB", 5 + 9, 16) + struct.pack(">IB", 9, 8) + b"\0\0\0\0"
    back = read_primary_kinematics(version + other + message + other[:7])
    assert np.array_equal(back.table.to_rows(), ABSOLUTE.to_rows())
    assert back.joint_checksum == kinematics.joint_checksum
    assert back.status == 2


def test_bytes_are_in_the_makers_order():
    rows = np.arange(24.0).reshape(6, 4) / 100
    body = write_primary_kinematics(UrKinematics(DhTable.from_rows(rows)))[10:]
    assert body[:4] == b"\xff\xff\xff\xff"
    values = struct.unpack(">24d", body[24:-4])
    assert values[:6] == tuple(rows[:, 0])  # theta
    assert values[6:12] == tuple(rows[:, 2])  # a
    assert values[12:18] == tuple(rows[:, 1])  # d
    assert values[18:] == tuple(rows[:, 3])  # alpha


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda m: b"", "no kinematics"),
        (lambda m: m[:100], "bytes, not"),
        (lambda m: b"\xff" + m, "impossible"),
        (lambda m: m[:5] + struct.pack(">I", 999) + m[9:], "longer"),
        (lambda m: m[:34] + struct.pack(">d", float("nan")) + m[42:], "finite"),
        (lambda m: b"HTTP/1.1 200 OK\r\n\r\n", "impossible"),
    ],
)
def test_damaged_bytes_are_refused(damage, words):
    with pytest.raises(CalibrationError, match=words):
        read_primary_kinematics(damage(write_primary_kinematics(UrKinematics(ABSOLUTE))))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("  forearm:", "  fore_arm:", "lacks kinematics.forearm.x"),
        ("x: -0.6127", "x: far", "not a number"),
        ("x: -0.6127", "x: .inf", "not a number|not finite"),
        ("x: -0.6127", "x: 1e999", "not finite"),
        ("  forearm:", "  wrist_1:", "twice"),
        ("kinematics:", "[kinematics]", "not a kinematics file"),
    ],
)
def test_a_damaged_kinematics_file_is_refused(old, new, words):
    assert old in DEFAULT_UR10E
    with pytest.raises(CalibrationError, match=words):
        read_ros_kinematics(DEFAULT_UR10E.replace(old, new))


def test_frames_of_another_type_are_refused():
    with pytest.raises(CalibrationError, match="UR5e"):
        model_of_ros(read_ros_kinematics(DEFAULT_UR10E), load_model("ur5e"))


def test_a_base_that_leans_is_refused():
    leaning = DEFAULT_UR10E.replace("roll: -0", "roll: 0.01")
    with pytest.raises(CalibrationError, match="upright"):
        model_of_ros(read_ros_kinematics(leaning), NOMINAL)


def test_the_well_conditioned_arm_goes_back_to_the_factorys_own_table():
    table = standard_dh(ARM, NOMINAL).table
    assert np.allclose(table.to_rows(), ABSOLUTE.to_rows(), rtol=1e-9, atol=1e-9)
    assert UrKinematics(table).factory_hash == UrKinematics(ABSOLUTE).factory_hash


@pytest.mark.parametrize(("half_turn", "whole_turn"), [(1, None), (2, 2), (1, 3), (None, 1)])
def test_a_hash_tells_in_which_form_the_controller_keeps_its_table(half_turn, whole_turn):
    rows = ABSOLUTE.to_rows()[:, :4]
    if half_turn is not None:
        rows[half_turn, [2, 3]] *= -1.0
        rows[half_turn : half_turn + 2, 0] -= np.pi
    if whole_turn is not None:
        rows[whole_turn, 0] += 2.0 * np.pi
    own = UrKinematics(DhTable.from_rows(rows))
    found = table_of_hash(standard_dh(factory_model(NOMINAL, own.table), NOMINAL).table, own.factory_hash)
    assert found is not None
    assert np.allclose(found.to_rows(), own.table.to_rows(), rtol=1e-9, atol=1e-9)


def test_a_hash_of_other_numbers_is_found_in_no_form():
    rows = ABSOLUTE.to_rows()[:, :4]
    rows[0, 1] += 1e-5
    assert table_of_hash(ABSOLUTE, UrKinematics(DhTable.from_rows(rows)).factory_hash) is None


@pytest.mark.parametrize("name", ["ur3", "ur5", "ur20", "abb_irb120", "kuka_kr6_r900"])
def test_any_arm_has_a_standard_table_that_reaches_the_same_poses(name):
    nominal = load_model(name)
    rng = np.random.default_rng(8)
    errors = rng.normal(scale=(1e-3, 1e-3, 1e-3, 2e-3, 2e-3), size=(6, 5))
    for model in (nominal, nominal.with_dh_errors(errors)):
        found = standard_dh(model, nominal)
        plain = RobotModel.from_dh(
            found.table, name="plain", base=nominal.placements[0], joint_coupling=nominal.joint_coupling
        )
        assert (found.table.beta_rad == 0).all()
        assert np.allclose(arm_reach_m(plain) @ found.flange_rest, arm_reach_m(model), rtol=0, atol=1e-11)
    assert np.allclose(standard_dh(nominal, nominal).table.to_rows(), nominal.dh.to_rows(), atol=1e-12)
    assert np.abs(found.flange_rest - np.eye(4)).max() < 0.02
