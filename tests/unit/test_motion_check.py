"""What may be commanded, and above all what may not."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.motion.motion_check import (
    MotionLimits,
    WirePath,
    allowed_postures,
    check_moves,
    seems_free,
)

MODEL = load_model("fanuc_m6ib")
HOME = np.deg2rad([0.0, 0, 0, 0, -45, 0])
WIRE = WirePath((0.9, -0.7, -0.45), (0.06, 0.05, 0.12), 3.0)
WIDE = MotionLimits(tip_speed_m_s=1.0)
SPEED = 0.05


def move_axis(axis, degrees):
    target = HOME.copy()
    target[axis] += np.deg2rad(degrees)
    return target


def check_names(verdict):
    return {finding.check for finding in verdict.findings}


def test_a_plain_move_is_allowed_and_says_what_was_not_checked():
    verdict = check_moves(MODEL, HOME, move_axis(0, 20)[None], WIDE, speed_rad_s=SPEED)
    assert verdict.allowed
    assert any("no obstacles known" in words for words in verdict.not_checked)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_before_anything_else(bad):
    targets = np.array([move_axis(0, 5), move_axis(1, 5)])
    targets[1, 3] = bad
    verdict = check_moves(MODEL, HOME, targets, WIDE, speed_rad_s=SPEED)
    assert not verdict.allowed
    assert check_names(verdict) == {"finite"}
    assert verdict.findings[0].target == 1
    for start, speed, tip in (
        (HOME * np.nan, SPEED, (0.0, 0.0, 0.0)),
        (HOME, bad, (0.0, 0.0, 0.0)),
        (HOME, SPEED, (bad, 0.0, 0.0)),
    ):
        found = check_moves(MODEL, start, targets[:1], WIDE, speed_rad_s=speed, tip_in_flange_m=tip)
        assert check_names(found) == {"finite"}
    assert allowed_postures(MODEL, targets, WIDE).tolist() == [True, False]


def test_joint_limits_keep_a_margin_and_the_doubt_of_the_mastering():
    edge = HOME.copy()
    edge[0] = MODEL.upper_rad[0] - np.deg2rad(4.0)
    assert check_moves(MODEL, HOME, edge[None], WIDE, speed_rad_s=SPEED).allowed
    doubtful = replace(WIDE, mastering_uncertainty_rad=(np.deg2rad(2.0),) + (0.0,) * 5)
    verdict = check_moves(MODEL, HOME, edge[None], doubtful, speed_rad_s=SPEED)
    assert check_names(verdict) == {"joint limits"}
    assert verdict.findings[0].limit == pytest.approx(MODEL.upper_rad[0] - np.deg2rad(5.0))


def test_speeds_above_the_caps_are_refused():
    target = move_axis(0, 20)[None]
    assert check_names(check_moves(MODEL, HOME, target, WIDE, speed_rad_s=0.2)) == {"joint speed"}
    assert check_names(check_moves(MODEL, HOME, target, WIDE, speed_rad_s=0.0)) == {"joint speed"}
    slow = replace(WIDE, tip_speed_m_s=0.04)
    verdict = check_moves(MODEL, HOME, target, slow, speed_rad_s=SPEED)
    assert check_names(verdict) == {"tip speed"}
    reach = np.linalg.norm(MODEL.tip_positions(HOME[None], np.zeros(3))[0, :2])
    assert verdict.findings[0].found == pytest.approx(SPEED * reach, rel=0.02)


def test_the_box_is_kept_on_the_way_not_only_at_the_end():
    around = np.array([HOME, HOME])
    around[0, 0], around[1, 0] = np.deg2rad(-80), np.deg2rad(80)
    boxed = replace(WIDE, box_low_m=(-1.0, -1.5, -1.0), box_high_m=(0.5, 1.5, 2.0))
    assert allowed_postures(MODEL, around, boxed).all()
    verdict = check_moves(MODEL, around[0], around[1:], boxed, speed_rad_s=SPEED)
    assert check_names(verdict) == {"workspace box"}
    assert verdict.findings[0].limit == 0.5


def test_a_tool_that_leaves_the_box_counts():
    boxed = replace(WIDE, box_low_m=(-2, -2, -2), box_high_m=(1.1, 2, 2))
    arguments = (MODEL, HOME, move_axis(0, 2)[None], boxed)
    assert check_moves(*arguments, speed_rad_s=0.01).allowed
    long = check_moves(*arguments, speed_rad_s=0.01, tip_in_flange_m=(0.0, 0.0, 0.5))
    assert check_names(long) == {"workspace box"}


def test_a_stretched_wrist_is_singular():
    limits = replace(WIDE, smallest_singular_value=0.02)
    straight = HOME.copy()
    straight[4] = 0.0
    assert allowed_postures(MODEL, np.array([HOME, straight]), limits).tolist() == [True, False]
    assert "singularity" in check_names(check_moves(MODEL, HOME, straight[None], limits, speed_rad_s=SPEED))


@pytest.mark.parametrize(("range_m", "check"), [(1.0, "wire too long"), (60.0, "wire too short")])
def test_the_wire_stays_within_3_and_97_per_cent(range_m, check):
    limits = replace(WIDE, wire=replace(WIRE, range_m=range_m))
    assert check_moves(
        MODEL, HOME, move_axis(0, 5)[None], replace(WIDE, wire=WIRE), speed_rad_s=SPEED
    ).allowed
    assert check_names(check_moves(MODEL, HOME, move_axis(0, 5)[None], limits, speed_rad_s=SPEED)) == {check}


def test_every_target_is_reported_with_a_sentence():
    far = np.array([move_axis(0, 200), move_axis(1, 10), move_axis(0, 200)])
    verdict = check_moves(MODEL, HOME, far, WIDE, speed_rad_s=SPEED)
    assert {finding.target for finding in verdict.findings} == {0, 1, 2}  # the way back breaks it too
    assert verdict.findings[0].sentence.startswith("target 1, joint limits")


def test_a_refusal_has_angles_in_degrees_and_names_the_joint():
    near = check_moves(MODEL, HOME, move_axis(0, 175)[None], WIDE, speed_rad_s=SPEED).findings[0]
    assert near.sentence == "target 1, joint limits of J1: 175 deg, limit 167 deg"
    assert near.found == pytest.approx(np.deg2rad(175.0))
    far = check_moves(MODEL, HOME, move_axis(1, 4000)[None], WIDE, speed_rad_s=SPEED).findings[0]
    assert far.sentence.startswith("target 1, joint limits of J2: 4000 deg, limit ")
    fast = check_moves(MODEL, HOME, move_axis(0, 20)[None], WIDE, speed_rad_s=np.deg2rad(30.0)).findings[0]
    assert fast.sentence.startswith("joint speed: 30 deg/s is not within 0 and ")
    wound = replace(WIRE, anchor_in_base_m=(0.0, 0.0, 2.0), wrap_rad=0.1)
    limits = replace(WIDE, wire=wound)
    turned = check_moves(MODEL, HOME, move_axis(5, 90)[None], limits, speed_rad_s=SPEED)
    assert [f.sentence for f in turned.findings if f.check == "wire wrap"] == [
        "target 1, wire wrap: 90 deg, limit 5.73 deg"
    ]


def test_targets_of_another_robot_are_refused():
    with pytest.raises(CalibrationError):
        check_moves(MODEL, HOME, np.zeros((2, 5)), WIDE, speed_rad_s=SPEED)


def test_a_robot_beyond_a_limit_may_come_back_but_go_no_further():
    inside, beyond, further = HOME.copy(), HOME.copy(), HOME.copy()
    edge = MODEL.upper_rad[0] - WIDE.joint_margin_rad
    beyond[0], further[0] = edge + 0.02, edge + 0.04
    assert check_moves(MODEL, beyond, inside[None], WIDE, speed_rad_s=SPEED).allowed
    assert not check_moves(MODEL, inside, beyond[None], WIDE, speed_rad_s=SPEED).allowed
    assert not check_moves(MODEL, beyond, beyond[None], WIDE, speed_rad_s=SPEED).allowed  # nor stay there
    way = np.array([further, inside])
    assert not check_moves(MODEL, beyond, way, WIDE, speed_rad_s=SPEED, stops=(False, True)).allowed


def test_where_no_target_is_left_none_seems_free() -> None:
    free = seems_free(MODEL, np.zeros(6), np.array([]), MotionLimits())
    assert free.shape == (0,)
