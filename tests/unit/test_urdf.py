"""URDF in through Pinocchio, calibrated URDF out."""

import re
import sys

import numpy as np
import pinocchio as pin
import pytest

from cellcal.calibration.arm.kinematics import load_model, model_names
from cellcal.calibration.arm.urdf import bare_urdf, calibrated_urdf, read_urdf
from cellcal.calibration.errors import CalibrationError

ARM = """<robot name="bench"><link name="world"/><link name="foot"/><link name="a"/><link name="bracket"/>
<link name="b"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
<link name="c"/><link name="tool0"/><link name="lamp"/>
<joint name="stand" type="fixed"><origin xyz="0.1 0 0.4"/><parent link="world"/><child link="foot"/></joint>
<joint name="j1" type="revolute"><origin xyz="0 0 0.3" rpy="0.1 0 0"/><parent link="foot"/><child link="a"/>
  <axis xyz="0 0.6 0.8"/><limit lower="-1" upper="2" velocity="3" effort="0"/></joint>
<joint name="clamp" type="fixed"><origin xyz="0.02 0 0" rpy="0 0 1"/><parent link="a"/>
  <child link="bracket"/></joint>
<joint name="j2" type="continuous"><origin xyz="0.4 0 0" rpy="0 1.5707963267948966 0"/>
  <parent link="bracket"/><child link="b"/><axis xyz="0 0 -1"/><limit velocity="2" effort="0"/></joint>
<joint name="j3" type="revolute"><parent link="b"/><child link="c"/><axis xyz="1 0 0"/>
  <limit lower="-2" upper="2" velocity="1" effort="0"/></joint>
<joint name="swing" type="prismatic"><parent link="b"/><child link="lamp"/><axis xyz="1 0 0"/>
  <limit lower="-2" upper="2" velocity="1" effort="0"/></joint>
<joint name="mount" type="fixed"><origin xyz="0 0 0.1" rpy="0.3 0.2 0.1"/><parent link="c"/>
  <child link="tool0"/></joint>
</robot>"""
JOINTS = np.random.default_rng(2).uniform(-1, 1, (10, 3))


def pinocchio_flange(text: str, joints: np.ndarray, base: str, tip: str, names) -> np.ndarray:
    """Return base_tip as Pinocchio finds it from a description, joint by joint by name."""
    arm = pin.buildModelFromXML(text)
    data, found = arm.createData(), []
    for row in joints:
        q = pin.neutral(arm)
        for name, angle in zip(names, row, strict=True):
            joint = arm.getJointId(name)
            i = arm.idx_qs[joint]
            q[i : i + arm.nqs[joint]] = [angle] if arm.nqs[joint] == 1 else [np.cos(angle), np.sin(angle)]
        pin.framesForwardKinematics(arm, data, q)
        frames = [data.oMf[arm.getFrameId(link)] for link in (base, tip)]
        found.append((frames[0].inverse() * frames[1]).homogeneous)
    return np.array(found)


@pytest.mark.parametrize("base", ["world", "foot", "a"])
def test_a_chain_reaches_where_pinocchio_says(base):
    arm = read_urdf(ARM, tip_link="tool0", base_link=base)
    names = arm.model.joint_names
    joints = JOINTS[:, -len(names) :]
    assert names == ("j1", "j2", "j3")[3 - len(names) :]
    assert np.allclose(
        arm.model.base_flange(joints), pinocchio_flange(ARM, joints, base, "tool0", names), atol=1e-12
    )


def test_limits_and_speeds_are_read_and_an_endless_joint_has_a_turn():
    model = read_urdf(ARM, tip_link="tool0").model
    assert np.allclose(model.lower_rad, (-1, -np.pi, -2))
    assert np.allclose(model.upper_rad, (2, np.pi, 2))
    assert np.allclose(model.max_speed_rad_s, (3, 2, 1))


def test_a_calibrated_description_reaches_where_the_calibrated_model_does():
    arm = read_urdf(ARM, tip_link="tool0")
    twists = np.random.default_rng(5).normal(scale=0.01, size=(4, 6))
    calibrated = arm.model.with_twists(twists)
    text = calibrated_urdf(arm, calibrated)
    ours = calibrated.base_flange(JOINTS)
    assert np.allclose(pinocchio_flange(text, JOINTS, "world", "tool0", ("j1", "j2", "j3")), ours, atol=1e-9)
    assert np.abs(ours - arm.model.base_flange(JOINTS)).max() > 1e-3
    assert '<box size="1 1 1"' in text
    assert 'type="prismatic"' in text


def test_a_calibrated_origin_states_its_turn_once():
    text = re.sub(r'rpy="[^"]*"', 'quat_xyzw="0.6 0 0 0.8"', ARM)
    arm = read_urdf(text, tip_link="tool0")
    again = read_urdf(calibrated_urdf(arm, arm.model), tip_link="tool0")
    np.testing.assert_allclose(again.model.placements, arm.model.placements, atol=1e-12)


def test_an_unchanged_model_leaves_every_pose():
    arm = read_urdf(ARM, tip_link="tool0")
    text = calibrated_urdf(arm, arm.model)
    assert np.allclose(
        pinocchio_flange(text, JOINTS, "world", "tool0", ("j1", "j2", "j3")),
        arm.model.base_flange(JOINTS),
        atol=1e-9,
    )


@pytest.mark.parametrize("name", model_names())
def test_every_model_survives_a_bare_description(name):
    model = load_model(name).with_dh_errors(np.random.default_rng(1).normal(scale=0.003, size=(6, 5)))
    joints = np.random.default_rng(3).uniform(model.lower_rad, model.upper_rad, (10, 6))
    again = read_urdf(bare_urdf(model, geometric_joints=True), tip_link="flange", base_link="base").model
    coupled = name.startswith("fanuc")
    driven = joints @ model.joint_coupling.T if coupled else joints
    assert again.joint_names == model.joint_names
    assert np.allclose(again.base_flange(driven), model.base_flange(joints), atol=1e-9)
    assert np.allclose(again.upper_rad, model.upper_rad)


def test_coupled_joints_are_not_hidden():
    with pytest.raises(CalibrationError, match="couples joints"):
        bare_urdf(load_model("fanuc_m6ib"))
    assert "joint_coupling @" in bare_urdf(load_model("fanuc_m6ib"), geometric_joints=True)


def test_signs_become_axes():
    assert 'xyz="0 0 -1"' in bare_urdf(load_model("kuka_kr6_r900"))


def test_reading_needs_no_library_of_robots(monkeypatch):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    assert read_urdf(ARM, tip_link="tool0").model.axis_count == 3


@pytest.mark.parametrize(
    ("text", "links"),
    [
        ("<robot", {}),
        ("<sdf/>", {}),
        ("<robot/>", {}),
        ('<!DOCTYPE r [<!ENTITY e "x">]><robot name="&e;"/>', {}),
        (ARM, {"tip_link": "nose"}),
        (ARM, {"tip_link": "a", "base_link": "c"}),
        (ARM, {"tip_link": "tool0", "base_link": "c"}),
        (ARM.replace('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><mimic joint="j1"/>', 1), {}),
    ],
    ids=[
        "broken",
        "not urdf",
        "empty",
        "entities",
        "no link",
        "upside down",
        "nothing moves",
        "mimic",
    ],
)
def test_a_description_that_is_no_arm_is_refused(text, links):
    with pytest.raises(CalibrationError):
        read_urdf(text, **{"tip_link": "tool0", **links})


def test_a_description_of_meshes_alone_is_told_to_lack_joints():
    with pytest.raises(CalibrationError, match="has no joints") as refused:
        read_urdf('<robot name="m"><link name="body"/></robot>')
    assert "<joint>" in refused.value.remedy


@pytest.mark.parametrize(
    "axis", ["0 0.999 0", "0 1.001 0", "0.57735 0.57735 0.578", "0 0 1.00001", "0 0 1.1e0"]
)
def test_an_axis_whose_length_no_rounding_explains_is_refused(axis):
    with pytest.raises(CalibrationError, match="not a unit vector") as refused:
        read_urdf(ARM.replace('axis xyz="1 0 0"', f'axis xyz="{axis}"'), tip_link="tool0")
    assert "length of one" in refused.value.remedy


@pytest.mark.parametrize(
    "axis", ["0.577 0.577 0.577", "0.71 0.7042 0", "0 0 1.0000000002", "-4e-8 1.0 -2e-17"]
)
def test_an_axis_that_was_rounded_is_taken(axis):
    assert (
        read_urdf(ARM.replace('axis xyz="1 0 0"', f'axis xyz="{axis}"'), tip_link="tool0").model.axis_count
        == 3
    )


def test_a_speed_below_zero_is_refused():
    with pytest.raises(CalibrationError, match="speed of joint 'j1' is -3") as refused:
        read_urdf(ARM.replace('velocity="3"', 'velocity="-3"'), tip_link="tool0")
    assert "positive" in refused.value.remedy


def test_a_flange_that_turns_has_no_place_for_its_correction():
    arm = read_urdf(ARM, tip_link="c")
    with pytest.raises(CalibrationError, match="not fixed behind the last joint"):
        calibrated_urdf(arm, arm.model)


def test_another_arms_calibration_is_refused():
    arm = read_urdf(ARM, tip_link="tool0")
    with pytest.raises(CalibrationError, match="other joints"):
        calibrated_urdf(arm, load_model("ur5e"))


def test_a_description_of_one_joint_is_read() -> None:
    text = (
        '<robot name="one"><link name="base"/><link name="tip"/><joint name="j" type="revolute"><parent link="base"/>'
        '<child link="tip"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    assert read_urdf(text, tip_link="tip").model.axis_count == 1
