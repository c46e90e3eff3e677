"""Where an arm was at a time: the bound must hold whatever the times do, and it must not be lavish."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import DegenerateDataError
from cellcal.procedures.motion.joint_history import TimedJoints, position_between, reading_times
from cellcal.procedures.motion.probe_line import joints_for_tip, probe_line

SPEED_M_S = 0.001
TIP = (0.01, -0.02, 0.16)
HOME = (0.1, 0.17, -0.44, 0.26, -1.05, 0.35)


def steady_travel(rng: np.random.Generator, *, stamped: bool, offset_s: float = 500.0) -> list[TimedJoints]:
    """Return readings of an arm that travels along x at a steady speed: joint 1 is the place [m]."""
    readings, now_s = [], 10.0
    for _ in range(30):
        asked_s = now_s
        true_s = asked_s + float(rng.uniform(0.001, 0.02))
        now_s = true_s + float(rng.uniform(0.001, 0.02))
        place = SPEED_M_S * true_s
        readings.append(
            TimedJoints(asked_s, now_s, (place,) + (0.0,) * 5, true_s - offset_s if stamped else None)
        )
    return readings


def tip_positions(readings: list[TimedJoints]) -> np.ndarray:
    return np.array([[reading.joints_rad[0], 0.0, 0.0] for reading in readings])


@given(seed=st.integers(0, 10_000), stamped=st.booleans(), part=st.floats(0.1, 0.9))
def test_the_bound_holds_the_true_place(seed: int, stamped: bool, part: float) -> None:
    rng = np.random.default_rng(seed)
    readings = steady_travel(rng, stamped=stamped)
    begin_s, end_s = readings[0].answered_s, readings[-1].asked_s
    touched_s = begin_s + part * (end_s - begin_s)
    before_s, after_s = rng.uniform(0.0, 0.005, 2)
    earliest_s, latest_s = touched_s - float(before_s), touched_s + float(after_s)
    found = position_between(readings, tip_positions(readings), earliest_s, latest_s)
    # the readings' own times are known within half a width each: a speed from two of them is, too
    assert abs(found.joints_rad[0] - SPEED_M_S * touched_s) <= 2.0 * found.bound_m
    if stamped:
        assert abs(found.joints_rad[0] - SPEED_M_S * touched_s) <= found.bound_m * (1 + 1e-9)


def test_a_controllers_own_time_tells_more_than_question_and_answer() -> None:
    rng = np.random.default_rng(3)
    with_stamps, without = steady_travel(rng, stamped=True), steady_travel(rng, stamped=False)
    assert reading_times(with_stamps)[1].max() < 0.3 * reading_times(without)[1].max()


def test_clocks_that_run_apart_are_not_believed() -> None:
    readings = steady_travel(np.random.default_rng(5), stamped=True)
    fast = [
        TimedJoints(r.asked_s, r.answered_s, r.joints_rad, 30.0 * (r.device_time_s or 0.0)) for r in readings
    ]
    times, halves = reading_times(fast)
    assert times == pytest.approx([(r.asked_s + r.answered_s) / 2 for r in readings])
    assert halves == pytest.approx([(r.answered_s - r.asked_s) / 2 for r in readings])


@pytest.mark.parametrize("span", [(0.0, 1.0), (99.0, 100.0)])
def test_a_touch_outside_the_readings_is_refused(span: tuple[float, float]) -> None:
    readings = steady_travel(np.random.default_rng(1), stamped=False)
    with pytest.raises(DegenerateDataError, match="both sides"):
        position_between(readings, tip_positions(readings), *span)


def test_the_line_is_measured_along_the_tip() -> None:
    model = load_model("fanuc_m6ib")
    start = model.tip_positions(np.array([HOME]), np.array(TIP))[0]
    end = joints_for_tip(model, TIP, HOME, start - np.array([0.0, 0.0, 0.02]))
    line = probe_line(model, TIP, HOME, end)
    assert line.length_m == pytest.approx(0.02, rel=1e-3)
    for distance_m in (0.0, 0.004, 0.02):
        assert line.distance_of(line.joints_at(distance_m)) == pytest.approx(distance_m, abs=1e-9)
    assert line.joints_at(-1.0) == pytest.approx(HOME)
    assert line.joints_at(1.0) == pytest.approx(end)


@given(seed=st.integers(0, 500))
def test_no_joint_speed_makes_the_tip_faster_than_asked(seed: int) -> None:
    model, rng = load_model("ur10e"), np.random.default_rng(seed)
    start = rng.uniform(-1.5, 1.5, 6)
    end = start + rng.uniform(-0.1, 0.1, 6)
    line = probe_line(model, TIP, tuple(start), tuple(end))
    way_rad = np.abs(end - start).max()
    duration_s = way_rad / line.joint_speed_rad_s(0.002)
    fine = line.tips_m(start + np.linspace(0, 1, 801)[:, None] * (end - start))
    speeds = np.linalg.norm(np.diff(fine, axis=0), axis=1) / (duration_s / 800)
    assert speeds.max() <= 0.002 * 1.001


def test_joints_for_a_tip_keep_the_attitude() -> None:
    model = load_model("ur10e")
    near = (-1.57, -1.57, -1.57, -1.57, 1.57, 0.0)
    pose = model.base_flange(np.array([near]))[0]
    target_tip = model.tip_positions(np.array([near]), np.array(TIP))[0] + np.array([0.05, -0.03, 0.02])
    found = joints_for_tip(model, TIP, near, target_tip)
    assert model.tip_positions(np.array([found]), np.array(TIP))[0] == pytest.approx(target_tip, abs=1e-8)
    assert model.base_flange(np.array([found]))[0, :3, :3] == pytest.approx(pose[:3, :3], abs=1e-8)


def test_what_cannot_be_reached_is_refused() -> None:
    model = load_model("ur10e")
    near = (-1.57, -1.57, -1.57, -1.57, 1.57, 0.0)
    with pytest.raises(DegenerateDataError, match="cannot be brought there"):
        joints_for_tip(model, TIP, near, np.array([5.0, 0.0, 0.0]))
    with pytest.raises(DegenerateDataError, match="finite"):
        probe_line(model, TIP, near, (float("inf"),) * 6)
    with pytest.raises(DegenerateDataError, match="does not move"):
        probe_line(model, TIP, near, near)
