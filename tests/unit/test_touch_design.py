"""Which attitudes tell a tool's tip, before and while they are taught."""

import math

import numpy as np
import pytest

from cellcal.calibration.geometry import Pose, exp_rotation, homogeneous_matrix
from cellcal.calibration.points.tool_point import locate_tool_point
from cellcal.calibration.points.touch_design import (
    alike_touch,
    cone_attitudes,
    fixed_plan_touches,
    next_turn,
    planned_attitudes,
    predicted_u_m,
    tip_gain,
)


def flange_attitudes(*degrees: tuple[float, float, float]) -> list[Pose]:
    return [
        Pose.from_matrix(homogeneous_matrix(exp_rotation(np.radians(turn)), np.zeros(3)))
        for turn in (np.array(t, dtype=float) for t in degrees)
    ]


def test_the_gain_is_the_covariance_of_the_fit():
    touches = flange_attitudes((0, 0, 0), (40, 0, 0), (0, -50, 0), (10, 20, 60))
    gain = tip_gain([touch.rotation_matrix() for touch in touches])
    found = locate_tool_point(touches, sigma_m=2e-4)
    assert np.allclose(gain * 2e-4**2, found.tip_covariance_m2, rtol=1e-9, atol=1e-20)
    foreseen = predicted_u_m([touch.rotation_matrix() for touch in touches], 2e-4)
    assert foreseen == pytest.approx(found.tip_u_in_space_m, rel=1e-9)


def test_two_touches_and_turns_about_one_axis_foretell_nothing():
    assert predicted_u_m([t.rotation_matrix() for t in flange_attitudes((0, 0, 0), (60, 0, 0))], 1e-4) is None
    assert (
        predicted_u_m(
            [t.rotation_matrix() for t in flange_attitudes((0, 0, 0), (0, 0, 60), (0, 0, 120))], 1e-4
        )
        is None
    )


def test_the_least_turn_that_is_asked_for_is_enough_and_no_smaller_one_is():
    touches = flange_attitudes((0, 0, 0), (12, 0, 0))
    found = alike_touch(touches, min_turn_rad=math.radians(20), worst_gain=4.0)
    assert found is not None
    assert (found.touch, found.like) == (1, 0)
    assert found.apart_rad == pytest.approx(math.radians(12))
    assert found.turn.describe_turn() == "10 degrees about +x"
    mended = touches[1].rotation_matrix() @ found.turn.rotation_matrix()
    again = [touches[0], Pose.from_matrix(homogeneous_matrix(mended, np.zeros(3)))]
    assert alike_touch(again, min_turn_rad=math.radians(20), worst_gain=4.0) is None


def test_a_third_touch_about_the_same_axis_is_alike_whatever_its_angle():
    found = alike_touch(
        flange_attitudes((0, 0, 0), (0, 0, 45), (0, 0, 90)), min_turn_rad=math.radians(20), worst_gain=4.0
    )
    assert found is not None
    assert found.like is None
    assert found.turn.about[1] in "xy"


def test_each_next_turn_tells_more_than_a_fixed_cone():
    for count in (5, 6, 8):
        ours = predicted_u_m(planned_attitudes(count, math.radians(60)), 2e-4)
        cone = predicted_u_m(cone_attitudes(count, math.radians(60)), 2e-4)
        assert ours is not None
        assert cone is not None
        assert ours < cone


def test_the_next_turn_stays_within_what_the_tool_can_do_and_repeats_no_attitude():
    taken = flange_attitudes((0, 0, 0))
    for _ in range(9):
        turn = next_turn(taken, math.radians(50))
        assert turn.angle_rad <= math.radians(50) + 1e-12
        matrix = taken[0].rotation_matrix() @ turn.rotation_matrix()
        assert all(np.abs(matrix - one.rotation_matrix()).max() > 0.05 for one in taken)
        taken.append(Pose.from_matrix(homogeneous_matrix(matrix, np.zeros(3))))


def test_a_fixed_plan_grows_with_the_noise_and_ends():
    tilt = math.radians(30)
    plans = [fixed_plan_touches(4e-4, sigma, tilt) for sigma in (5e-5, 1e-4, 2e-4)]
    assert plans == sorted(plans)
    assert fixed_plan_touches(1e-4, 1e-3, tilt) is None
