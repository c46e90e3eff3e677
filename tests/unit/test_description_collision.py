"""Collision checks with the shapes of a description, beside the capsules that need none."""

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.urdf import bare_urdf, read_urdf
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.calibration.motion.cell_shapes import (
    BoxObstacle,
    CellShape,
    LinkCapsule,
    PlaneObstacle,
    SphereObstacle,
)
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.calibration.motion.description_collision import DescriptionCheck

MODEL = load_model("ur10e")
RNG = np.random.default_rng(2)
JOINTS = RNG.uniform(-3, 3, (300, 6))
SHAPES = {
    "base": '<origin xyz="0 0 0.05"/><geometry><cylinder radius="0.1" length="0.1"/></geometry>',
    "link_2": '<origin xyz="-0.3 0 0"/><geometry><box size="0.6 0.12 0.12"/></geometry>',
    "flange": '<geometry><sphere radius="0.08"/></geometry>',
}


def described_robot(shapes=SHAPES):
    text = bare_urdf(MODEL)
    for link, shape in shapes.items():
        text = text.replace(
            f'<link name="{link}" />', f'<link name="{link}"><collision>{shape}</collision></link>'
        )
    return read_urdf(text, tip_link="flange")


def flange_shape_robot():
    return described_robot({"flange": SHAPES["flange"]})


OBSTACLES = (
    SphereObstacle("ball", (0.7, 0.2, 0.5), 0.2),
    BoxObstacle("crate", homogeneous_matrix(np.eye(3), np.array([-0.6, 0.0, 0.2])), (0.4, 0.8, 0.5)),
    PlaneObstacle("floor", (0.0, 0.0, -0.1), (0.0, 0.0, 1.0)),
)


def test_both_checks_agree_where_both_know_the_shapes():
    arm = (LinkCapsule("hand", 6, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.08),)
    ours = CollisionCheck(MODEL, CellShape(arm, OBSTACLES)).is_free(JOINTS)
    theirs = DescriptionCheck.from_description(flange_shape_robot(), OBSTACLES).is_free(JOINTS)
    assert np.array_equal(ours, theirs)
    assert 0.1 < ours.mean() < 0.9


def test_a_hand_in_the_own_arm_is_seen():
    many = RNG.uniform(-3, 3, (20000, 6))
    hand = MODEL.base_flange(many)[:, :3, 3]
    in_base = many[np.linalg.norm(hand - [0.0, 0.0, 0.05], axis=1) < 0.1]
    assert len(in_base) > 5
    check = DescriptionCheck.from_description(described_robot())
    assert not check.is_free(in_base).any()
    assert 0.5 < check.is_free(JOINTS).mean() <= 1.0


def test_the_margin_is_kept():
    flange = MODEL.base_flange(JOINTS[:1])[0, :3, 3]
    for gap, free in ((0.0201, True), (0.0199, False)):
        ball = SphereObstacle("ball", tuple(flange + np.array([0.0, 0.0, 0.08 + 0.05 + gap])), 0.05)
        assert DescriptionCheck.from_description(flange_shape_robot(), (ball,)).is_free(JOINTS[:1])[0] == free


def test_what_always_touches_is_left_out_and_named():
    shapes = {
        **SHAPES,
        "link_5": '<geometry><sphere radius="0.3"/></geometry>',
        "link_3": '<geometry><sphere radius="0.5"/></geometry>',
    }
    words = DescriptionCheck.from_description(described_robot(shapes)).not_checked
    assert any("link_3_0 and link_5_0" in word for word in words)
    assert any("no obstacles" in word for word in words)


def test_coupled_joints_are_turned_into_those_of_the_description():
    model = load_model("fanuc_m6ib")
    text = bare_urdf(model, geometric_joints=True).replace(
        '<link name="flange" />', f'<link name="flange"><collision>{SHAPES["flange"]}</collision></link>'
    )
    arm = read_urdf(text, tip_link="flange")
    hand = (LinkCapsule("hand", 6, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.08),)
    ours = CollisionCheck(model, CellShape(hand, OBSTACLES)).is_free(JOINTS)
    theirs = DescriptionCheck.from_description(arm, OBSTACLES, joint_matrix=model.joint_coupling).is_free(
        JOINTS
    )
    assert np.array_equal(ours, theirs)


def test_numbers_that_are_not_finite_are_not_free():
    joints = JOINTS[:3].copy()
    joints[0, 0], joints[2, 5] = np.nan, np.inf
    far = DescriptionCheck.from_description(
        flange_shape_robot(), (SphereObstacle("far", (9.0, 9.0, 9.0), 0.1),)
    )
    assert far.is_free(joints).tolist() == [False, True, False]


def test_descriptions_without_shapes_or_with_lost_meshes_are_refused():
    with pytest.raises(CalibrationError, match="no collision shapes"):
        DescriptionCheck.from_description(described_robot({}))
    lost = {"flange": '<geometry><mesh filename="package://nowhere/hand.stl"/></geometry>'}
    with pytest.raises(CalibrationError, match="cannot be loaded"):
        DescriptionCheck.from_description(described_robot(lost))
