"""What the UR driver makes of a state, without a wire: stops, modes, arrival, path."""

import math
from dataclasses import replace

import pytest

from cellcal.drivers.errors import MotionStoppedError, RefusedError
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.universal_robots.health import (
    condition_error,
    condition_of,
    mode_condition_of,
    safety_stop_of,
    translate_refusal,
)
from cellcal.drivers.universal_robots.motion import (
    MotionTolerances,
    expected_s,
    has_arrived,
    has_stood,
    is_moving,
    path_deviation_rad,
)
from cellcal.drivers.universal_robots.rtde import RuntimeState
from cellcal.drivers.universal_robots.state import Six, StateSample

START: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
TARGET: Six = (1.0, -0.5, 0.0, 0.2, 0.0, 0.0)
REST: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
LIMITS = MotionTolerances(position_rad=5e-4, speed_rad_s=2e-3, settle_s=0.3)
HEALTHY = StateSample(
    timestamp_s=10.0,
    joints_rad=START,
    joint_speeds_rad_s=REST,
    tcp_pose=REST,
    tcp_offset=REST,
    speed_scaling=1.0,
    speed_fraction=1.0,
    robot_mode=7,
    runtime_state=RuntimeState.STOPPED,
    robot_status_bits=1,
    safety_status_bits=1,
    payload_kg=0.0,
    received_at_s=0.0,
    raw=b"",
)


def sample_joints(*joints: Six, period_s: float = 0.05) -> list[StateSample]:
    return [replace(HEALTHY, timestamp_s=10 + k * period_s, joints_rad=q) for k, q in enumerate(joints)]


def test_a_healthy_arm_in_reduced_mode_is_ready() -> None:
    assert condition_of(HEALTHY, program_is_ours=False).readiness is Readiness.READY
    reduced = replace(HEALTHY, safety_status_bits=0b11)
    assert condition_of(reduced, program_is_ours=False).readiness is Readiness.READY
    assert safety_stop_of("arm", reduced) is None


@pytest.mark.parametrize(
    ("bits", "says"),
    [
        ((2, 10), "protective stop"),
        ((4, 10), "safeguard stop"),
        ((5, 7, 10), "emergency stop of the cell"),
        ((6, 7, 10), "emergency stop at the robot"),
        ((2, 6, 7, 10), "emergency stop at the robot"),
        ((7,), "emergency stop"),
        ((8, 10), "violation"),
        ((2, 9, 10), "fault"),
        ((10,), "a safety reason"),
    ],
)
def test_each_safety_stop_is_reported_with_what_to_do(bits: tuple[int, ...], says: str) -> None:
    sample = replace(HEALTHY, robot_mode=3, safety_status_bits=sum(1 << bit for bit in bits))
    condition = condition_of(sample, program_is_ours=True)
    assert condition.readiness is Readiness.STOPPED
    assert says in condition.message
    assert condition.remedy
    assert isinstance(condition_error("arm", condition), MotionStoppedError)
    stop = safety_stop_of("arm", sample)
    assert stop is not None
    assert says in stop.message
    assert stop.remedy == condition.remedy


@pytest.mark.parametrize("mode", [-1, 0, 1, 2, 3, 4, 5, 6, 8, 99])
def test_no_robot_mode_but_running_is_ready(mode: int) -> None:
    condition = condition_of(replace(HEALTHY, robot_mode=mode), program_is_ours=False)
    assert condition.readiness is Readiness.NOT_READY
    assert condition.remedy
    assert isinstance(condition_error("arm", condition), RefusedError)


@pytest.mark.parametrize("state", [state for state in RuntimeState if state is not RuntimeState.STOPPED])
def test_a_program_that_is_not_ours_forbids_a_move_and_ours_does_not(state: RuntimeState) -> None:
    sample = replace(HEALTHY, runtime_state=state)
    assert condition_of(sample, program_is_ours=False).readiness is Readiness.NOT_READY
    assert condition_of(sample, program_is_ours=True).readiness is Readiness.READY


@pytest.mark.parametrize(
    ("library_message", "says"),
    [
        ("One of the RTDE input registers are already in use! …", "another program already commands"),
        ("ur_rtde: Please enable remote control on the robot!", "Local"),
        ("Failed to start control script, before timeout of 5 seconds", "did not start the program"),
        ("An unknown message", "An unknown message"),
    ],
)
def test_library_messages_are_reported_in_our_words(library_message: str, says: str) -> None:
    error = translate_refusal(RefusedError("arm", library_message, vendor_text=library_message))
    assert says in str(error)
    assert error.vendor_text == library_message


def test_an_arm_has_arrived_when_it_stood_at_the_target_for_the_settling_time() -> None:
    assert has_arrived(sample_joints(*[TARGET] * 8), TARGET, LIMITS)
    assert not has_arrived(sample_joints(*[TARGET] * 4), TARGET, LIMITS), "not for long enough"
    assert not has_arrived(sample_joints(*[START] * 8), TARGET, LIMITS), "somewhere else"
    near: Six = (1.0 + 6e-4, -0.5, 0.0, 0.2, 0.0, 0.0)
    assert not has_arrived(sample_joints(*[near] * 8), TARGET, LIMITS)
    assert not has_arrived(sample_joints(*[TARGET] * 4, near, *[TARGET] * 3), TARGET, LIMITS), "it was pushed"


def test_an_arm_that_passes_through_the_target_has_not_arrived() -> None:
    passing = [replace(s, joint_speeds_rad_s=(0.01, 0, 0, 0, 0, 0)) for s in sample_joints(*[TARGET] * 8)]
    assert not has_arrived(passing, TARGET, LIMITS)
    assert is_moving(passing[-1], LIMITS)


def test_an_arm_that_creeps_without_saying_so_does_not_stand() -> None:
    creeping: list[Six] = [(1e-3 * k, 0.0, 0.0, 0.0, 0.0, 0.0) for k in range(8)]
    assert not has_stood(sample_joints(*creeping), LIMITS, 0.1)
    assert has_stood(sample_joints(*[START] * 8), LIMITS, 0.1)
    assert not has_stood([], LIMITS, 0.0)


def test_the_path_of_a_joint_move_is_a_straight_line_in_joint_space() -> None:
    on_it: Six = (0.3, -0.15, 0.0, 0.06, 0.0, 0.0)
    assert path_deviation_rad(replace(HEALTHY, joints_rad=on_it), START, TARGET) == pytest.approx(
        0.0, abs=1e-12
    )
    off_it: Six = (0.3, -0.15, 0.0, 0.06, 0.2, 0.0)
    assert path_deviation_rad(replace(HEALTHY, joints_rad=off_it), START, TARGET) == pytest.approx(0.2)
    behind: Six = (-0.3, 0.15, 0.0, -0.06, 0.0, 0.0)
    assert path_deviation_rad(replace(HEALTHY, joints_rad=behind), START, TARGET) == pytest.approx(0.3)
    beyond: Six = (1.1, -0.5, 0.0, 0.2, 0.0, 0.0)
    assert path_deviation_rad(replace(HEALTHY, joints_rad=beyond), START, TARGET) > 0.02
    assert path_deviation_rad(replace(HEALTHY, joints_rad=off_it), START, START) == pytest.approx(0.3)


def test_a_move_is_expected_to_take_its_ramps_and_its_cruise() -> None:
    assert expected_s(START, TARGET, 0.5, 1.0) == pytest.approx(1.0 / 0.5 + 0.5)
    assert math.isclose(expected_s(START, START, 0.5, 1.0), 0.5)


@pytest.mark.parametrize("mode", ["MANUAL", "SERVICE", "automatic", "NONE", "AUTOMATIC "])
def test_only_the_automatic_mode_lets_an_arm_move(mode: str) -> None:
    condition = mode_condition_of(mode)
    assert condition is not None
    assert condition.readiness is Readiness.NOT_READY
    assert "pendant" in condition.remedy


def test_the_automatic_mode_and_a_controller_without_modes_forbid_nothing() -> None:
    assert mode_condition_of("AUTOMATIC") is None
    assert mode_condition_of("") is None
