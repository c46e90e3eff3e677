"""The tool's tip from touches on a pin, and its axes from straight moves."""

import itertools
import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import (
    Pose,
    exp_rotation,
    homogeneous_matrix,
    log_rotation,
    rotation_from_quaternion,
)
from cellcal.calibration.points.tool_point import AxesLimits, locate_tool_point, tool_axes, tool_pose

TIP = np.array([0.012, -0.034, 0.187])
PIN = np.array([1.1, -0.4, 0.3])
TILTS = [(0, 0, 0), (0.7, 0, 0), (0, 0.7, 0), (-0.5, 0.4, 0.9), (0.3, -0.8, -0.6)]


def touch_pose(tilt, noise=(0.0, 0.0, 0.0), tip=TIP, pin=PIN) -> Pose:
    rotation = exp_rotation(np.array([math.pi, 0, 0])) @ exp_rotation(np.array(tilt, dtype=float))
    return Pose.from_matrix(homogeneous_matrix(rotation, pin - rotation @ tip + np.array(noise)))


def noisy_touches(seed: int, sigma_m: float, tilts=TILTS) -> list[Pose]:
    noise = np.random.default_rng(seed).normal(scale=sigma_m, size=(len(tilts), 3))
    return [touch_pose(tilt, n) for tilt, n in zip(tilts, noise, strict=True)]


@pytest.mark.parametrize("count", [3, 4, 5])
def test_exact_touches_give_the_exact_tip_and_pin(count):
    found = locate_tool_point([touch_pose(tilt) for tilt in TILTS[:count]])
    assert np.allclose(found.tip_in_flange_m, TIP, atol=1e-13)
    assert np.allclose(found.pin_in_base_m, PIN, atol=1e-13)
    assert found.max_m < 1e-13
    assert found.degrees_of_freedom == 3 * count - 6


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3), st.lists(st.floats(-3, 3), min_size=3, max_size=3)
)
def test_any_tip_at_any_pin_is_found(tip, pin):
    found = locate_tool_point([touch_pose(t, tip=np.array(tip), pin=np.array(pin)) for t in TILTS])
    assert np.allclose(found.tip_in_flange_m, tip, atol=1e-12)
    assert np.allclose(found.pin_in_base_m, pin, atol=1e-12)


def test_the_stated_uncertainty_covers_the_truth_in_95_of_100_fits():
    inside = 0
    for seed in range(400):
        found = locate_tool_point(noisy_touches(seed, 2e-4))
        inside += int((np.abs(np.array(found.tip_in_flange_m) - TIP) <= found.tip_u_m).sum())
    assert 0.93 < inside / 1200 < 0.97


def test_the_covariance_is_that_of_the_scattered_fits():
    tips = np.array([locate_tool_point(noisy_touches(seed, 2e-4)).tip_in_flange_m for seed in range(1500)])
    stated = np.array(locate_tool_point(noisy_touches(0, 2e-4), sigma_m=2e-4).tip_covariance_m2)
    assert np.allclose(np.sqrt(np.diag(np.cov(tips.T))), np.sqrt(np.diag(stated)), rtol=0.08)


def test_a_bad_touch_is_named_and_shows_more_when_it_is_left_out():
    touches = [touch_pose(tilt) for tilt in TILTS]
    touches[3] = touch_pose(TILTS[3], noise=(0.0, 3e-3, 0.0))
    found = locate_tool_point(touches)
    assert found.worst_touch == 3
    assert found.leave_one_out_max_m is not None
    assert found.leave_one_out_max_m > 2.5e-3 > found.max_m


def test_leaving_one_out_equals_fitting_without_it():
    touches = noisy_touches(7, 3e-4)
    found = locate_tool_point(touches)
    worst = 0.0
    for i in range(len(touches)):
        rest = locate_tool_point(touches[:i] + touches[i + 1 :])
        tip = touches[i].rotation_matrix() @ rest.tip_in_flange_m + touches[i].position_m
        worst = max(worst, float(np.linalg.norm(tip - rest.pin_in_base_m)))
    assert found.leave_one_out_max_m == pytest.approx(worst, rel=1e-9)


def test_three_touches_leave_none_to_spare():
    assert locate_tool_point(noisy_touches(1, 1e-4, TILTS[:3])).leave_one_out_max_m is None


@pytest.mark.parametrize(
    "tilts",
    [
        TILTS[:2],
        [(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0)],
        [(0, 0, 0), (0, 0, 0.8), (0, 0, 1.6), (0, 0, -0.8)],
        [(0.2, 0.1, 0)] * 4,
    ],
    ids=["two touches", "attitudes alike", "one axis only", "the same touch"],
)
def test_touches_that_cannot_tell_the_tip_are_refused(tilts):
    with pytest.raises(DegenerateDataError) as refused:
        locate_tool_point([touch_pose(tilt) for tilt in tilts])
    assert refused.value.remedy


def test_the_result_is_plain_numbers():
    found = locate_tool_point(noisy_touches(3, 1e-4))
    leaves = [getattr(found, f.name) for f in fields(found)]
    while any(isinstance(leaf, tuple) for leaf in leaves):
        leaves = list(itertools.chain.from_iterable(v if isinstance(v, tuple) else (v,) for v in leaves))
    assert {type(leaf) for leaf in leaves} <= {float, int}


TOOL = exp_rotation(np.array([0.3, -1.1, 2.0]))  # flange_tool
SQUARE = Pose.from_matrix(homogeneous_matrix(TOOL.T, np.array([0.9, 0.1, 0.7])))  # tool axes along the base's


def moved_pose(direction, length_m=0.3, turn=(0.0, 0.0, 0.0)) -> Pose:
    rotation = SQUARE.rotation_matrix() @ exp_rotation(np.array(turn, dtype=float))
    position = np.array(SQUARE.position_m) + np.array(direction, dtype=float) * length_m
    return Pose.from_matrix(homogeneous_matrix(rotation, position))


X, Y, Z = np.eye(3)


@pytest.mark.parametrize("axes", ["xyz", "xy", "xz", "yz"])
def test_moves_along_two_or_three_axes_give_the_tool(axes):
    poses = {f"along_{a}": moved_pose(np.eye(3)["xyz".index(a)]) for a in axes}
    found = tool_axes(SQUARE, **poses)
    assert np.allclose(rotation_from_quaternion(np.array(found.quaternion)), TOOL, atol=1e-12)
    assert found.shortest_move_m == pytest.approx(0.3)
    assert found.squareness_rad < 1e-12


def test_crooked_moves_are_made_square_and_reported():
    found = tool_axes(SQUARE, along_x=moved_pose(X), along_y=moved_pose(Y + 0.01 * X), along_z=moved_pose(Z))
    rotation = rotation_from_quaternion(np.array(found.quaternion))
    assert found.squareness_rad == pytest.approx(math.atan(0.01), rel=1e-6)
    assert np.linalg.norm(log_rotation(TOOL.T @ rotation)) == pytest.approx(0.005, rel=0.01)


def test_a_tool_that_turned_is_refused():
    with pytest.raises(CalibrationError, match=r"turned by 0\.57 degrees during the move along x"):
        tool_axes(SQUARE, along_x=moved_pose(X, turn=(0, 0.01, 0)), along_z=moved_pose(Z))


def test_a_turn_within_the_limit_is_reported():
    found = tool_axes(SQUARE, along_x=moved_pose(X, turn=(0, 1e-3, 0)), along_z=moved_pose(Z))
    assert found.turn_rad == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("poses", "says"),
    [
        ({"along_x": moved_pose(X)}, "two moves"),
        ({"along_x": moved_pose(X, 0.05), "along_z": moved_pose(Z)}, r"only 50\.0 mm"),
        ({"along_x": moved_pose(X), "along_z": moved_pose(Z + 0.2 * X)}, "right angles"),
        ({"along_x": moved_pose(X), "along_y": moved_pose(X)}, "right angles"),
        ({"along_x": moved_pose(X), "along_y": moved_pose(Y), "along_z": moved_pose(-Z)}, "left-handed"),
    ],
)
def test_moves_that_make_no_frame_are_refused(poses, says):
    with pytest.raises(CalibrationError, match=says):
        tool_axes(SQUARE, **poses)


def test_limits_can_be_widened():
    short = tool_axes(
        SQUARE, along_x=moved_pose(X, 0.05), along_z=moved_pose(Z, 0.05), limits=AxesLimits(min_move_m=0.04)
    )
    assert short.shortest_move_m == pytest.approx(0.05)


def test_tip_and_axes_make_the_tool_frame():
    found = tool_axes(SQUARE, along_x=moved_pose(X), along_z=moved_pose(Z))
    pose = tool_pose((0.1, 0.2, 0.3), found)
    assert pose.position_m == (0.1, 0.2, 0.3)
    assert np.allclose(pose.rotation_matrix(), TOOL)
    assert tool_pose((0.1, 0.2, 0.3)).quaternion == (1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("count", [3, 5])
def test_the_tip_is_within_u_in_space_in_95_of_100_fits_whatever_the_number_of_touches(count):
    inside = 0
    for seed in range(1200):
        found = locate_tool_point(noisy_touches(seed, 2e-4, TILTS[:count]))
        inside += np.linalg.norm(np.array(found.tip_in_flange_m) - TIP) <= found.tip_u_in_space_m
    assert 0.935 < inside / 1200 < 0.965  # three deviations of a share of 95 % in 1200


@pytest.mark.parametrize("count", [4, pytest.param(20, marks=pytest.mark.soak)])
def test_what_shifts_the_tip_at_all_touches_alike_is_within_u_when_it_is_stated(count):
    inside = 0
    for seed in range(1200):
        random = np.random.default_rng([seed, 7])
        tilts = [TILTS[k % len(TILTS)] + random.uniform(-0.1, 0.1, 3) for k in range(count)]
        found = locate_tool_point(noisy_touches(seed, 2e-4, tilts), arm_sigma_m=3e-4)
        off = np.array(found.tip_in_flange_m) + random.normal(scale=3e-4, size=3) - TIP
        inside += np.linalg.norm(off) <= found.tip_u_in_space_m
    assert 0.93 < inside / 1200 < 0.97


def test_a_touch_off_by_chance_is_rarely_called_stray_and_a_slip_always():
    called = sum(locate_tool_point(noisy_touches(seed, 2e-4)).stray_probability < 0.01 for seed in range(600))
    assert called <= 15
    touches = noisy_touches(3, 2e-5)
    touches[2] = touch_pose(TILTS[2], noise=(2e-3, 0.0, 0.0))
    found = locate_tool_point(touches)
    assert (found.stray_touch, found.stray_probability < 1e-3) == (2, True)
    assert found.leave_one_out_m[2] == found.leave_one_out_max_m
