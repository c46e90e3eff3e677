"""The fake world's own arithmetic: against published poses, against the product's, and against itself."""

import asyncio

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellcal.calibration.arm.kinematics import load_model
from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.arm_models import COUNTS_PER_TURN, MODELS
from cellcal.fake_devices.clock import WorldClock
from cellcal.fake_devices.encoders import PulseCoders
from cellcal.fake_devices.kinematics import (
    flange_poses,
    invert_pose,
    link_frames,
    matrix_from_xyzwpr,
    wpr_from_matrix,
)
from cellcal.fake_devices.motion import SpeedChange, TrapezoidMotion
from cellcal.fake_devices.wire_gauge import WireGauge
from cellcal.fake_devices.world import World
from tests.machine_speed import stretched_s


def perfect_arm(model: str) -> SimulatedArm:
    return SimulatedArm.from_model(model, seed=1, hidden=False, clock=WorldClock(0.0))


def flange_at(arm: SimulatedArm, degrees: list[float]) -> np.ndarray:
    return arm.believed_flange(np.radians(degrees))[0]


# published poses


def test_a_fanuc_stands_at_its_makers_zero_pose():
    pose = flange_at(perfect_arm("fanuc_m6ib"), [0.0] * 6)
    assert pose[:3, 3] == pytest.approx([0.865, 0.0, 0.700], abs=1e-12)
    w, p, _ = wpr_from_matrix(pose[:3, :3])
    assert (abs(w), p) == pytest.approx((180.0, -90.0), abs=1e-6)


def test_a_fanuc_with_j5_down_points_its_tool_at_the_floor():
    pose = flange_at(perfect_arm("fanuc_m6ib"), [0, 0, 0, 0, -90, 0])
    assert pose[:3, 3] == pytest.approx([0.765, 0.0, 0.600], abs=1e-12)
    w, p, r = wpr_from_matrix(pose[:3, :3])
    assert (abs(w), p, r) == pytest.approx((180.0, 0.0, 0.0), abs=1e-6)


def test_a_fanucs_wrist_centre_reaches_what_the_data_sheet_says():
    arm = perfect_arm("fanuc_m6ib")
    stretch = np.degrees(np.arctan2(0.100, 0.615))  # forearm and upper arm in one line
    angles = np.radians([[0.0, 90.0, -stretch, 0.0, 0.0, 0.0]]) @ arm.coupling.T
    wrist = link_frames(arm.nominal_dh, angles)[0, 4, :3, 3]
    assert wrist[0] == pytest.approx(1.373, abs=5e-4)


def test_a_fanucs_j2_alone_does_not_turn_the_forearm():
    arm = perfect_arm("fanuc_m6ib")
    leaning, upright = flange_at(arm, [0, 40, 10, 20, 30, 40]), flange_at(arm, [0, -20, 10, 20, 30, 40])
    assert leaning[:3, :3] == pytest.approx(upright[:3, :3], abs=1e-12)
    assert np.linalg.norm(leaning[:3, 3] - upright[:3, 3]) > 0.1


@pytest.mark.parametrize(
    ("model", "position"),
    [
        ("ur5e", (-0.8172, -0.2329, 0.0628)),
        ("ur10e", (-1.18425, -0.2907, 0.06085)),
        ("ur10", (-1.1843, -0.256141, 0.0116)),
    ],
)
def test_a_universal_robot_stretched_out_stands_where_its_maker_says(model, position):
    pose = flange_at(perfect_arm(model), [0.0] * 6)
    assert pose[:3, 3] == pytest.approx(position, abs=1e-9)
    assert pose[:3, 2] == pytest.approx([0.0, -1.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("model", ["fanuc_m6ib", "ur5e", "ur10", "ur10e"])
def test_two_kinematics_written_apart_agree(model):
    ours, theirs = perfect_arm(model), load_model(model)
    joints = np.random.default_rng(3).uniform(-3.0, 3.0, (40, 6))
    assert ours.believed_flange(joints) == pytest.approx(theirs.base_flange(joints), abs=1e-9)


def test_hayatis_beta_tilts_the_next_axis_about_y():
    dh = np.array([[0.0, 0.1, 0.2, 0.0, 0.3]])
    pose = flange_poses(dh, np.zeros((1, 1)))[0]
    assert pose[:3, 2] == pytest.approx([np.sin(0.3), 0.0, np.cos(0.3)])
    assert pose[:3, 3] == pytest.approx([0.2, 0.0, 0.1])


angle = st.floats(-179.0, 179.0)


@given(angle, st.floats(-89.0, 89.0), angle)
def test_wpr_goes_there_and_back(w, p, r):
    pose = matrix_from_xyzwpr([10.0, -20.0, 30.0, w, p, r])
    assert wpr_from_matrix(pose[:3, :3]) == pytest.approx((w, p, r), abs=1e-6)
    assert invert_pose(pose) @ pose == pytest.approx(np.eye(4), abs=1e-12)


@pytest.mark.parametrize("p", [90.0, -90.0])
def test_wpr_survives_the_pole(p):
    rotation = matrix_from_xyzwpr([0, 0, 0, 25.0, p, 40.0])[:3, :3]
    again = matrix_from_xyzwpr([0, 0, 0, *wpr_from_matrix(rotation)])[:3, :3]
    assert again == pytest.approx(rotation, abs=1e-6)


# motion


def test_every_axis_of_a_move_ends_together_and_none_is_faster_than_asked():
    move = TrapezoidMotion(np.zeros(3), np.array([1.0, -0.5, 0.1]), 0.4, 2.0, begin_s=5.0)
    times = np.linspace(5.0, move.end_s, 400)
    speeds = np.array([move.velocity_at(t) for t in times])
    assert np.abs(speeds).max() == pytest.approx(0.4)
    assert move.end_s - 5.0 == pytest.approx(1.0 / 0.4 + 0.4 / 2.0)
    assert move.position_at(move.end_s) == pytest.approx([1.0, -0.5, 0.1], abs=1e-15)
    travelled = np.trapezoid(speeds, times, axis=0)
    assert travelled == pytest.approx([1.0, -0.5, 0.1], rel=1e-4)


def test_a_short_move_never_reaches_its_speed():
    move = TrapezoidMotion(np.zeros(1), np.array([0.01]), 1.0, 1.0, begin_s=0.0)
    assert move.end_s == pytest.approx(0.2)
    assert move.velocity_at(0.1) == pytest.approx([0.1])


def test_a_move_to_where_it_stands_takes_no_time():
    move = TrapezoidMotion(np.ones(2), np.ones(2), 0.5, 2.0, begin_s=3.0)
    assert move.end_s == pytest.approx(3.0)
    assert move.position_at(3.0) == pytest.approx([1.0, 1.0])


def test_braking_ends_in_standstill_further_along_the_path():
    brake = SpeedChange(np.zeros(2), np.array([0.4, -0.2]), np.zeros(2), 2.0, begin_s=1.0)
    assert brake.end_s == pytest.approx(1.2)
    assert brake.position_at(9.0) == pytest.approx([0.04, -0.02])
    assert brake.velocity_at(9.0) == pytest.approx([0.0, 0.0])


def test_a_constant_speed_goes_on():
    run = SpeedChange(np.zeros(1), np.zeros(1), np.array([0.5]), 1.0, begin_s=0.0)
    assert run.position_at(2.5) == pytest.approx([0.125 + 1.0])
    assert run.velocity_at(2.5) == pytest.approx([0.5])


def test_a_leap_of_the_clock_ends_where_small_steps_end():
    leaping, stepping = (World(4, 0.0).add_arm("a", "fanuc_m6ib") for _ in range(2))
    for arm in (leaping, stepping):
        arm.start_move(np.zeros(6), 0.5, 2.0)
    leaping.clock.advance(1000.0)
    for _ in range(1000):
        stepping.clock.advance(1.0)
        stepping.update_backlash()
        stepping.base_flange()
    assert leaping.base_flange() == pytest.approx(stepping.base_flange(), abs=1e-12)


def test_a_stop_can_be_dated_back():
    arm = World(4, 0.0).add_arm("a", "fanuc_m6ib")
    start = arm.joints_rad
    arm.start_move(start + np.array([1.0, 0, 0, 0, 0, 0]), 0.5, 5.0)
    arm.clock.advance(1.0)
    arm.stop(5.0, at_s=0.5)
    assert not arm.is_moving
    assert arm.joints_rad[0] - start[0] == pytest.approx(0.5 * 0.5 - 0.025 + 0.025)


def test_a_followed_set_point_has_a_speed_and_comes_to_rest():
    arm = World(4, 0.0).add_arm("a", "ur10e")
    goal = arm.joints_rad
    for _ in range(5):
        goal = goal + 0.001
        arm.follow_set_point(goal)
        arm.clock.advance(0.008)
    assert arm.is_moving
    assert arm.joint_velocity == pytest.approx(np.full(6, 0.125), rel=1e-6)
    arm.clock.advance(1.0)
    assert not arm.is_moving
    assert arm.joints_rad == pytest.approx(goal)


# hidden errors


def test_a_seed_draws_the_same_arm_again_and_another_seed_another():
    first, again, other = (SimulatedArm.from_model("fanuc_m6ib", seed, name="a") for seed in (5, 5, 6))
    assert np.array_equal(first.true_dh, again.true_dh)
    assert not np.array_equal(first.true_dh, other.true_dh)


def test_the_errors_of_an_arm_have_the_size_of_a_real_ones():
    worst = []
    for seed in range(20):
        arm = World(seed, 0.0).add_arm("a", "fanuc_m6ib")
        joints = np.random.default_rng(seed).uniform(arm.lower_rad, arm.upper_rad, (50, 6))
        gap = (arm.flange_at(joints) - arm.believed_flange(joints))[:, :3, 3]
        worst.append(np.linalg.norm(gap, axis=1).mean())
    assert 0.3e-3 < np.mean(worst) < 3e-3


def test_a_ur_controller_knows_its_factory_errors_but_for_a_small_rest():
    arm = World(2, 0.0).add_arm("ur", "ur10e")
    joints = np.random.default_rng(2).uniform(-2.0, 2.0, (50, 6))
    truth = arm.flange_at(joints)[:, :3, 3]
    nominal = flange_poses(arm.nominal_dh, joints)[:, :3, 3]
    believed_m = arm.believed_flange(joints)[:, :3, 3]
    assert (
        np.linalg.norm(believed_m - truth, axis=1).mean()
        < 0.5 * np.linalg.norm(nominal - truth, axis=1).mean()
    )


def test_an_unloaded_axis_stops_short_on_the_side_it_comes_from():
    arm = World(7, 0.0).add_arm("a", "fanuc_m6ib")
    target = np.radians([0.0, 10.0, -20.0, 0.0, -60.0, 0.0])
    arrivals = []
    for detour in (-0.1, 0.1):
        for goal in (target + np.array([detour, 0, 0, 0, 0, 0]), target):
            arm.start_move(goal, 1.0, 5.0)
            arm.clock.advance(100.0)
        arrivals.append(arm.base_flange()[:3, 3])
    radius = np.hypot(*arrivals[0][:2])
    turned = np.arctan2(arrivals[1][1], arrivals[1][0]) - np.arctan2(arrivals[0][1], arrivals[0][0])
    assert turned == pytest.approx(arm.hidden.backlash_rad[0], rel=2e-2)
    assert radius * turned < 0.3e-3


def test_an_arm_bends_down_under_its_own_weight():
    arm = World(7, 0.0).add_arm("a", "fanuc_m6ib")
    stretched = np.radians([0.0, 80.0, -60.0, 0.0, 0.0, 0.0])
    stiff = SimulatedArm("a", arm.model, arm.hidden, arm.clock, arm.known_dh)
    stiff.hidden = type(arm.hidden)(**{**vars(arm.hidden), "compliance_rad_nm": np.zeros(6)})
    sag = (arm.flange_at(stretched) - stiff.flange_at(stretched))[0, 2, 3]
    assert -1e-3 < sag < -0.02e-3


def test_what_is_left_after_a_move_dies_away():
    arm = World(7, 0.0).add_arm("a", "fanuc_m6ib")
    arm.start_move(np.zeros(6), 1.0, 5.0)
    arm.clock.advance(arm.settled_at_s)
    fresh = arm.base_flange()[:3, 3]
    arm.clock.advance(2.0)
    assert 1e-6 < np.linalg.norm(fresh - arm.base_flange()[:3, 3]) < 1e-3
    settled = arm.base_flange()[:3, 3]
    arm.clock.advance(2.0)
    assert np.linalg.norm(settled - arm.base_flange()[:3, 3]) < 1e-9


# pulse coders


def pulse_coders(seed: int = 1) -> PulseCoders:
    world = World(seed, 0.0)
    return PulseCoders(world.add_arm("a", "fanuc_m6ib"), world.make_rng("coders"))


def turn_coders(subject: PulseCoders, joints: np.ndarray) -> None:
    subject._arm.put_joints(subject._arm.joints_rad + joints)


def test_joints_come_from_counts_through_the_wrist_coupling():
    subject = pulse_coders()
    zero = tuple(int(count) for count in subject.factory_counts_at_zero)
    assert subject.joints_from_counts(zero) == pytest.approx(subject._arm.joints_rad, abs=1e-6)
    before = np.array(subject.read_counts())
    turn_coders(subject, np.array([0, 0, 0, 0.5, 0, 0]))
    moved = np.array(subject.read_counts()) - before
    assert moved[3] != 0
    assert moved[4] != 0  # motor 5 has to hold its joint against motor 4
    assert not moved[:3].any()


def test_a_lost_coder_counts_from_zero_until_its_index_gives_the_fraction_back():
    subject = pulse_coders()
    before = np.array(subject.read_counts())
    subject.lose_turns([2])
    assert subject.read_counts()[2] == 0
    subject.acknowledge_alarm()
    turn_coders(subject, 1.2 * subject.radians_per_count[:, 2] * COUNTS_PER_TURN)
    travelled = subject.read_counts()[2] - before[2]
    assert subject.established.all()
    fraction = (travelled - round(1.2 * COUNTS_PER_TURN)) % COUNTS_PER_TURN
    assert fraction in (0, 1, COUNTS_PER_TURN - 1)
    lost = subject.turns_lost()
    assert lost[2] != 0
    assert [lost[axis] for axis in (0, 1, 3, 4, 5)] == [0] * 5
    assert subject.true_counts_at_zero()[2] == subject.factory_counts_at_zero[2] - lost[2] * COUNTS_PER_TURN


def test_the_index_is_not_found_while_the_battery_alarm_stands():
    subject = pulse_coders()
    subject.lose_turns([0])
    turn_coders(subject, 1.5 * subject.radians_per_count[:, 0] * COUNTS_PER_TURN)
    subject.read_counts()
    assert not subject.established[0]


def test_less_than_a_turn_that_passes_no_index_establishes_nothing():
    subject = pulse_coders()
    inside = COUNTS_PER_TURN - int(subject.true_counts()[1]) % COUNTS_PER_TURN
    subject.lose_turns([1])
    subject.acknowledge_alarm()
    turn_coders(subject, 0.9 * inside * subject.radians_per_count[:, 1])
    subject.read_counts()
    assert not subject.established[1]
    turn_coders(subject, 0.2 * inside * subject.radians_per_count[:, 1])
    subject.read_counts()
    assert subject.established[1]


def test_a_new_motor_shifts_the_fraction_too():
    subject = pulse_coders()
    subject.replace_motor(2, 123_456)
    subject.lose_turns([2])
    subject.acknowledge_alarm()
    turn_coders(subject, 1.5 * subject.radians_per_count[:, 2] * COUNTS_PER_TURN)
    subject.read_counts()
    shift = subject.true_counts_at_zero()[2] - int(subject.factory_counts_at_zero[2])
    assert shift % COUNTS_PER_TURN == -123_456 % COUNTS_PER_TURN


def test_an_arm_without_gears_has_no_pulse_coders():
    world = World(1, 0.0)
    with pytest.raises(ValueError, match="no pulse coders"):
        PulseCoders(world.add_arm("ur", "ur10e"), world.make_rng("coders"))


# wire


def world_and_gauge(seed: int = 3, hidden: bool = True) -> tuple[World, WireGauge]:
    world = World(seed, 0.0, hidden=hidden)
    world.add_arm("fanuc", "fanuc_m6ib")
    return world, WireGauge(world, {"name": "wire", "robot": "fanuc"})


def test_without_hidden_errors_a_wire_is_the_straight_distance():
    _, wire = world_and_gauge(hidden=False)
    straight = np.linalg.norm(wire.hook_in_base_m() - wire.anchor_in_base_m)
    assert wire.anchor_in_base_m == pytest.approx([0.9, -0.7, -0.45])
    assert wire.true_length_m() == pytest.approx(straight, abs=1e-12)
    assert wire.read_m() == (pytest.approx(straight, abs=1e-12), True)


def test_the_exit_lip_lengthens_a_bent_wire_by_radius_times_phi_minus_sin_phi():
    _, wire = world_and_gauge()
    wire.exit_radius_m = 0.002
    way = wire.hook_in_base_m() - wire.anchor_in_base_m
    phi = np.arccos(way @ wire._exit_axis / np.linalg.norm(way))
    extra = wire.true_length_m() - np.linalg.norm(way)
    assert extra == pytest.approx(0.002 * (phi - np.sin(phi)), abs=3e-6)


def test_a_wire_leaves_towards_the_place_that_the_cell_file_names():
    """A small arm's wire that looked where a large one works was bent by half a turn."""
    world = World(3, 0.0)
    world.add_arm("fanuc", "fanuc_m6ib")
    wire = WireGauge(world, {"name": "wire", "robot": "fanuc", "mouth_at_mm": [200.0, -700.0, 300.0]})
    wire.go_home()
    assert np.allclose(np.cross([0.2, -0.7, 0.3] - wire.anchor_in_base_m, wire._exit_axis), 0.0, atol=1e-12)


def test_readings_scatter_around_the_drum():
    _, wire = world_and_gauge()
    samples = np.array([wire.read_m()[0] for _ in range(400)])
    assert samples.std() == pytest.approx(0.5 * 2e-4, rel=0.2)
    assert samples.mean() == pytest.approx(wire.exact_reading_m(), abs=3e-5)


def test_linearity_is_a_small_smooth_error():
    world, wire = world_and_gauge()
    arm = world.arms["fanuc"]
    errors = []
    for j1 in np.linspace(-0.6, 0.6, 100):
        joints = arm.joints_rad
        joints[0] = j1
        arm.put_joints(joints)
        length = wire.true_length_m()
        errors.append(wire.exact_reading_m() - length * (1.0 + wire.scale_error) - wire.zero_m)
    assert 1e-6 < np.std(errors) < 2e-4


def test_slack_snap_slip_and_outliers_show_and_go_away():
    world, wire = world_and_gauge()
    arm = world.arms["fanuc"]
    here = wire.exact_reading_m()
    wire.let_catch()
    way = wire.anchor_in_base_m - wire.hook_in_base_m()
    nearer = min(
        (arm.joints_rad + step for step in np.vstack([np.eye(6)[0], -np.eye(6)[0]]) * 0.1),
        key=lambda joints: np.linalg.norm(arm.flange_at(joints)[0, :3, 3] - wire.anchor_in_base_m),
    )
    assert np.linalg.norm(way) > 0.2
    arm.put_joints(nearer)
    assert wire.exact_reading_m() < here - 0.005
    assert wire.read_m()[0] == pytest.approx(here, abs=1e-3)
    wire.restore_hook()
    assert wire.read_m()[0] == pytest.approx(wire.exact_reading_m(), abs=1e-3)
    wire.let_go()
    assert wire.read_m()[0] < 0.002
    wire.restore_hook()
    wire.corrupt_next(0.008, 2)
    off = [wire.read_m()[0] - wire.exact_reading_m() for _ in range(3)]
    assert off == pytest.approx([0.008, 0.008, 0.0], abs=5e-4)
    wire.lengthen_readings(0.005)
    assert wire.read_m()[0] - wire.exact_reading_m() == pytest.approx(0.0, abs=5e-4)


def test_beyond_its_end_a_drum_stands_still():
    _, wire = world_and_gauge()
    wire.range_m = 0.5
    assert wire.read_m() == (0.5, False)


# the clock, and the error that matters


def test_a_standing_clock_moves_only_on_request():
    clock = WorldClock(0.0)
    assert clock.now_s() == 0.0
    clock.advance(12.5)
    assert clock.now_s() == 12.5
    with pytest.raises(ValueError, match="backwards"):
        clock.advance(-1.0)
    with pytest.raises(ValueError, match="time_factor"):
        WorldClock(-1.0)


async def test_a_sleeper_wakes_when_the_clock_leaps():
    clock = WorldClock(0.0)
    sleeper = asyncio.create_task(clock.sleep(100.0))
    await asyncio.sleep(0)
    clock.advance(99.0)
    await asyncio.sleep(0.01)
    assert not sleeper.done()
    clock.advance(1.5)
    async with asyncio.timeout(stretched_s(30.0)):
        await sleeper


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_model_parks_inside_its_limits(name):
    model = MODELS[name]
    assert all(
        low < park < high
        for low, park, high in zip(model.lower_deg, model.park_deg, model.upper_deg, strict=True)
    )
