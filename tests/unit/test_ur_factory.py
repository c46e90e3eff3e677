"""Factory calibration of Universal Robots arms."""

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import DhTable, RobotModel, load_model
from cellcal.calibration.arm.ur_factory import (
    calibration_hash,
    factory_model,
    parse_calibration_conf,
    to_well_conditioned,
)
from cellcal.calibration.errors import CalibrationError

# A real UR10e, absolute standard DH, from the documentation of ur_calibration, "Calibration correction".
THETA = [-2.4147806894359e-07, 1.60233952386695, -1.68607190752171, 0.0837331147700119, -1.01260355871158e-07,
         3.91986209186124e-08]  # fmt: skip
A = [
    2.12234865571206e-05,
    0.0193171326277006,
    -0.569251663611088,
    -4.61409023720934e-05,
    -6.39280053471802e-05,
    0,
]
D = [
    0.180539811714259,
    439.140974079901,
    -446.027059806332,
    7.0603368964236,
    0.119811341150314,
    0.115670917257426,
]
ALPHA = [1.57014608044242, 0.0013941666682559, 0.00693818880325995, 1.56998468543761, -1.57038520649543, 0]
ABSOLUTE = DhTable.from_rows(np.array([THETA, D, A, ALPHA]).T)
JOINTS = np.random.default_rng(0).uniform(-6, 6, (500, 6))


def test_the_rewritten_arm_reaches_the_same_poses():
    raw = RobotModel.from_dh(ABSOLUTE, name="as written")
    model = factory_model(load_model("ur10e"), ABSOLUTE)
    assert np.allclose(model.base_flange(JOINTS), raw.base_flange(JOINTS), rtol=0, atol=5e-13)


def test_hundreds_of_metres_become_millimetres():
    nominal = load_model("ur10e")
    model = factory_model(nominal, ABSOLUTE)
    assert np.abs(model.dh.to_rows() - nominal.dh.to_rows())[:, 1:3].max() < 1.5e-3
    # UR's own rewriting gives the forearm at -0.612541 m, pitched by 1.393 mrad, and wrist 1 at 0.174508 m.
    assert model.dh.a_m[1] == pytest.approx(-0.612541, abs=5e-7)
    assert model.dh.beta_rad[1] == pytest.approx(1.393e-3, abs=1e-6)
    wrist_1 = model.placements[3] @ [0, 0, model.dh.d_m[3], 1]
    assert np.allclose(wrist_1[:3], (-0.571354, -0.001207, 0.174508), atol=1e-6)


def test_this_arm_differs_from_nominal_by_millimetres():
    nominal = load_model("ur10e")
    model = factory_model(nominal, ABSOLUTE)
    change = np.linalg.norm((model.base_flange(JOINTS) - nominal.base_flange(JOINTS))[:, :3, 3], axis=1)
    assert change.mean() == pytest.approx(1.85e-3, rel=0.08)
    assert 3.5e-3 < change.max() < 4.0e-3


@pytest.mark.parametrize("name", ["ur3", "ur5e", "ur10", "ur16e", "ur20"])
def test_a_nominal_table_stays_as_it_is(name):
    nominal = load_model(name)
    assert np.allclose(factory_model(nominal, nominal.dh).dh.to_rows(), nominal.dh.to_rows(), atol=1e-12)


def test_any_small_errors_keep_the_pose():
    rng = np.random.default_rng(4)
    nominal = load_model("ur5e")
    for _ in range(20):
        rows = nominal.dh.to_rows()[:, :4] + rng.normal(scale=(1e-3, 1e-3, 1e-3, 2e-3), size=(6, 4))
        table = DhTable.from_rows(rows)
        raw = RobotModel.from_dh(table, name="raw")
        rewritten = RobotModel.from_dh(to_well_conditioned(table, nominal.dh), name="rewritten")
        assert np.allclose(raw.base_flange(JOINTS), rewritten.base_flange(JOINTS), rtol=0, atol=1e-12)


def test_another_types_table_is_refused():
    with pytest.raises(CalibrationError, match="UR5e"):
        factory_model(load_model("ur5e"), ABSOLUTE)


@pytest.mark.parametrize(
    ("name", "ros_name"), [("ur5e", "calib_12788084448423163542"), ("ur10e", "calib_5119701370761913513")]
)
def test_nominal_tables_have_the_names_that_the_ros_driver_ships(name, ros_name):
    assert calibration_hash(load_model(name).dh) == ros_name


CONF = """
[mounting]
delta_theta = [ -2.4e-07, 1.602339523866945, -1.686071907521713, 0.0837331147700118711, -1.0e-07, 3.9e-08]
delta_a = [ 2.1e-05, 0.632017132627700651, 0.00229833638891230319, -4.6e-05, -6.4e-05, 0]
delta_d = [ -0.00016, 439.140974079900957, -446.027059806332147, 6.88618689642360149, -3.9e-05, -0.00088]
delta_alpha = [ -0.00065, 0.00139416666825590402, 0.00693818880325995126, -0.0008, 0.0004, 0]
joint_checksum = [ 0x8ee5fa3e, 0x81b1b8a5, 0xbc4bc9d5, 0xbee8f2aa, 0xbee8f2ab, 0xbee8f2ac]
calibration_status = 2 # 0 == notInitialized / 1 == notLinearised / 2 == Linearised
"""


def test_a_configuration_file_is_deltas_to_nominal():
    nominal = load_model("ur10e")
    read = parse_calibration_conf(CONF)
    assert read.linearised
    assert read.joint_checksum[0] == 0x8EE5FA3E
    model = factory_model(nominal, read.to_absolute(nominal.dh))
    assert model.dh.a_m[1] == pytest.approx(-0.612541, abs=5e-6)


def test_two_configurations_in_one_file_are_refused():
    with pytest.raises(CalibrationError, match="delta_theta twice"):
        parse_calibration_conf(CONF + CONF)


def test_an_arm_that_was_not_linearised_is_marked():
    assert not parse_calibration_conf(
        CONF.replace("calibration_status = 2", "calibration_status = 1")
    ).linearised


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("delta_a =", "delta_b ="),
        ("delta_a = [ 2.1e-05,", "delta_a = ["),
        ("delta_a = [ 2.1e-05,", "delta_a = [ 2.1e-05.0,"),
        ("delta_a = [ 2.1e-05,", "delta_a = [ 1e999,"),
        ("delta_a = [ 2.1e-05,", "delta_a = [ __import__('os'),"),
    ],
)
def test_a_damaged_configuration_is_refused(old, new):
    assert old in CONF
    with pytest.raises(CalibrationError, match=r"calibration\.conf"):
        parse_calibration_conf(CONF.replace(old, new))
