"""How fast a leg is gone: no part of the arm exceeds its cap there, and no other leg makes it slower."""

from itertools import pairwise

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.procedures.motion.approach import from_below
from cellcal.procedures.motion.speed_limit import SpeedLimit, TimedMotion

MODEL = load_model("fanuc_m6ib")
HOOK = (0.06, 0.05, 0.12)
PACE = SpeedLimit("fanuc_m6ib", HOOK, joint_speed_rad_s=0.5, tip_speed_m_s=0.05)
HOME = (0.0,) * 6


def fastest_m_s(
    here: tuple[float, ...], there: tuple[float, ...], speed_rad_s: float, hook: object = HOOK
) -> float:
    """Return the speed of the fastest of hook, flange and joints' centres, by small steps along a joint move."""
    turn = np.subtract(there, here)
    duration_s = float(np.abs(turn).max()) / speed_rad_s
    share = np.linspace(0.0, 1.0, 401)[:, None]
    path = np.array(here) + share * turn
    points = [MODEL.tip_positions(path, np.array(hook)), MODEL.tip_positions(path, np.zeros(3))]
    return max(float(np.linalg.norm(np.diff(p, axis=0), axis=1).max()) * 400 / duration_s for p in points)


def draw_legs(count: int) -> list[tuple[float, ...]]:
    draw = np.random.default_rng(7).uniform(-0.8, 0.8, (count, 6))
    return [tuple(float(q) for q in pose) for pose in draw]


def test_on_every_leg_the_tip_keeps_its_cap_and_comes_near_it() -> None:
    poses = draw_legs(12)
    speeds = PACE.leg_speeds(HOME, poses)
    for (here, there), speed_rad_s in zip(pairwise([HOME, *poses]), speeds, strict=True):
        assert speed_rad_s <= 0.5
        found_m_s = fastest_m_s(here, there, speed_rad_s)
        assert found_m_s <= 0.05
        assert found_m_s > 0.6 * 0.05  # an elbow may be faster than flange and hook


def test_a_joint_far_from_the_tip_is_slow_and_the_last_one_is_not() -> None:
    first, last = (0.5, 0, 0, 0, 0, 0), (0.5, 0, 0, 0, 0, 0.5)
    slow, fast = PACE.leg_speeds(HOME, (first, last))
    assert slow < 0.06
    assert fast == pytest.approx(0.5)
    assert PACE.leg_speeds(first, (last,)) == (fast,)


def test_ways_take_as_long_as_their_legs_the_last_degree_from_below_among_them() -> None:
    ways = tuple((pose,) for pose in draw_legs(4))
    paced = PACE.time_ways(HOME, ways)
    here, seconds, travel = HOME, 0.0, 0.0
    for way in ways:
        corners = from_below(here, way[0])
        for corner, speed in zip(corners, PACE.leg_speeds(here, corners), strict=True):
            turn = max(abs(a - b) for a, b in zip(corner, here, strict=True))
            seconds, travel, here = seconds + turn / speed, travel + turn, corner
    assert paced.moving_s == pytest.approx(seconds)
    assert paced.travel_rad == pytest.approx(travel)
    assert PACE.time_ways(HOME, ()) == TimedMotion(0.0, 0.0, 0.0)


def test_sums_of_ways() -> None:
    one, other = TimedMotion(1.0, 10.0, 0.3), TimedMotion(2.0, 5.0, 0.4)
    assert one + other == TimedMotion(3.0, 15.0, 0.4)
    assert one.repeat_motion(3) == TimedMotion(3.0, 30.0, 0.3)
    assert one.repeat_motion(0) == TimedMotion(0.0, 0.0, 0.0)
