"""One column of a file at fault, two targets in turn, and a second fault from some row on: named, whatever robot."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import Array, exp_twist
from cellcal.calibration.identification.misfit import refuse_gross_misfit, refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.misfit_hypotheses import FileNames
from cellcal.calibration.identification.mixed_targets import find_mixed_targets, refuse_mixed_targets
from cellcal.calibration.identification.target_change import series_columns
from tests.unit.helpers.simulated_arm import SimulatedMeasurements, tracker_points

ROBOTS = ["ur10", "abb_irb120", "fanuc_m6ib", "kuka_kr6_r900"]
J = ("A1", "A2", "A3", "A4", "A5", "A6")
INCH = 25.4
AWAY_M = np.array([0.05, -0.04, 0.02])


def refusal_of(
    true: SimulatedMeasurements,
    joints: Array | None = None,
    places: Array | None = None,
    search: bool = False,
) -> MisfitError:
    rows = true.observations
    rows = replace(rows, joints_rad=rows.joints_rad if joints is None else joints)
    rows = replace(rows, positions_m=rows.positions_m if places is None else places)
    with pytest.raises(MisfitError) as refused:
        refuse_misfit(true.model, rows, FileNames(J, length_unit="mm"), search_models=search)
    return refused.value


def second_target(true: SimulatedMeasurements, away_m: Array, rows: Array) -> Array:
    turns = true.truth.seen_from(0).base_flange(true.observations.joints_rad)[:, :3, :3]
    places: Array = true.observations.positions_m.copy()
    places[rows] += (turns @ away_m)[rows]
    return places


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(("factor", "unit"), [(1.0 / INCH, "inch"), (1e-3, "m"), (0.1, "cm")])
def test_one_coordinate_in_another_unit(robot: str, factor: float, unit: str) -> None:
    true = tracker_points(robot, 40, seed=2)
    places = true.observations.positions_m.copy()
    places[:, 2] *= factor
    assert f"Z is in {unit} and the other two are not" in refusal_of(true, places=places).message


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("rows", [1, -2])
def test_one_coordinate_some_rows_apart(robot: str, rows: int) -> None:
    true = tracker_points(robot, 40, seed=2)
    places = true.observations.positions_m.copy()
    places[:, 1] = np.roll(places[:, 1], rows)
    where = "down" if rows > 0 else "up"
    assert f"Y stands {abs(rows)} rows too far {where}" in refusal_of(true, places=places).message


@pytest.mark.parametrize("robot", ROBOTS)
def test_one_coordinate_written_twice_or_without_its_signs(robot: str) -> None:
    true = tracker_points(robot, 40, seed=2)
    twice, without = true.observations.positions_m.copy(), true.observations.positions_m.copy()
    twice[:, 1] = twice[:, 0]
    without[:, 0] = np.abs(without[:, 0] - without[:, 0].mean())
    assert "Y repeats the numbers of X" in refusal_of(true, places=twice).message
    assert "X, which is never negative, does not" in refusal_of(true, places=without).message


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("joint", [1, 3, 4])
def test_one_joint_a_row_apart(robot: str, joint: int) -> None:
    true = tracker_points(robot, 40, seed=2)
    joints = true.observations.joints_rad.copy()
    joints[:, joint] = np.roll(joints[:, joint], 1)
    assert f"{J[joint]} stands 1 rows too far down" in refusal_of(true, joints=joints).message


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("factor", [2.0, 1.03])
def test_one_joint_of_another_gear(robot: str, factor: float) -> None:
    true = tracker_points(robot, 60, seed=2)
    joints = true.observations.joints_rad.copy()
    joints[:, 2] *= factor
    said = refusal_of(true, joints=joints).message
    told = float(said.partition("A3 moves about ")[2].partition(" times")[0])
    assert told == pytest.approx(1.0 / factor, abs=0.01)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_joint_that_counts_together_with_another_of_the_wrist(robot: str) -> None:
    true = tracker_points(robot, 40, seed=2)
    joints = true.observations.joints_rad.copy()
    joints[:, 4] += joints[:, 5]
    assert "A5 holds the angle of the joint plus that of A6" in refusal_of(true, joints=joints).message


@pytest.mark.parametrize("robot", ROBOTS)
def test_readings_sorted_by_the_names_of_their_points(robot: str) -> None:
    true = tracker_points(robot, 40, seed=2)
    as_text = sorted(range(40), key=lambda at: str(at + 1))
    said = refusal_of(true, places=true.observations.positions_m[as_text]).message
    assert "the measured values stand in the order of their points' names as text" in said
    said = refusal_of(true, joints=true.observations.joints_rad[as_text]).message
    assert "the joints stand in the order of their points' names as text" in said


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_joint_sorted_by_itself_is_pointed_at(robot: str) -> None:
    true = tracker_points(robot, 40, seed=2)
    joints = true.observations.joints_rad.copy()
    joints[:, 1] = np.sort(joints[:, 1])
    assert f"{true.model.joint_names[1]} only rises or falls" in refusal_of(true, joints=joints).remedy


def mixed_in(model, rows):
    return find_mixed_targets(series_columns(model, rows), rows)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("every", [2, 3])
@pytest.mark.parametrize("move", [(5e-4, 0, 0, 0, 0, 0), (0, 0, 0, 0, 0, 1e-3), (0.1, 0.1, 0, 0.1, 0.05, 0)])
def test_two_devices_in_turn_are_told_apart_row_by_row(
    robot: str, every: int, move: tuple[float, ...]
) -> None:
    true = tracker_points(robot, 60, seed=5)
    second = np.arange(0, 60, every)
    places, there = true.observations.positions_m.copy(), exp_twist(np.array(move))
    places[second] = places[second] @ there[:3, :3].T + there[:3, 3]
    rows = replace(true.observations, positions_m=places)
    found = mixed_in(true.model, rows)
    assert found is not None
    assert found.is_device
    # Which of two halves is the second one, nothing tells.
    assert found.second.tolist() in (second.tolist(), np.setdiff1d(np.arange(60), second).tolist())
    with pytest.raises(MisfitError, match=r"as seen by one device.*two devices or stations in turn"):
        refuse_mixed_targets(true.model, found, np.arange(60))


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("joint", [0, -1])
def test_play_of_a_joint_is_no_second_device_or_target(robot: str, joint: int) -> None:
    for seed in range(4):
        true = tracker_points(robot, 60, seed=seed)
        joints = true.observations.joints_rad.copy()
        joints[:, joint] += np.deg2rad(0.1) * np.sign(np.diff(joints[:, joint], prepend=0.0))
        assert mixed_in(true.model, replace(true.observations, joints_rad=joints)) is None


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_joint_that_another_turns_along_is_not_two_targets(robot: str) -> None:
    for seed in range(4):
        true = tracker_points(robot, 60, seed=seed)
        joints = true.observations.joints_rad.copy()
        joints[:, 5] += 0.02 * joints[:, 4]
        assert mixed_in(true.model, replace(true.observations, joints_rad=joints)) is None


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("times", [0.03, 1.0])
def test_two_targets_in_turn_are_told_apart_row_by_row(robot: str, times: float) -> None:
    true = tracker_points(robot, 60, seed=5)
    second = np.flatnonzero(np.random.default_rng(3).random(60) < 0.4)
    rows = replace(true.observations, positions_m=second_target(true, AWAY_M * times, second))
    found = mixed_in(true.model, rows)
    assert found is not None
    assert found.second.tolist() == second.tolist()
    assert found.apart_m == pytest.approx(float(np.linalg.norm(AWAY_M)) * times, rel=0.1)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("count", [24, 36, 60, 200])
def test_rows_of_one_target_are_not_divided(robot: str, count: int) -> None:
    for seed in range(6):
        true = tracker_points(robot, count, seed=seed)
        assert mixed_in(true.model, true.observations) is None


@pytest.mark.parametrize("robot", ROBOTS)
def test_two_targets_far_apart_are_named_with_the_rows(robot: str) -> None:
    true = tracker_points(robot, 40, seed=2)
    said = refusal_of(true, places=second_target(true, AWAY_M, np.arange(1, 40, 2))).message
    assert "two targets" in said
    assert "37, 39 are of one" in said or "36, 38 are of one" in said


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_second_fault_from_the_middle_on_leaves_the_first_one_named(robot: str) -> None:
    true = tracker_points(robot, 60, seed=4)
    joints = true.observations.joints_rad.copy()
    joints[:, 3] *= -1.0
    refused = refusal_of(true, joints, second_target(true, AWAY_M, np.arange(30, 60)))
    assert "A4 counts the other way round" in refused.message
    assert "Divide the file" in refused.remedy


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_fault_of_the_last_rows_alone_is_said_of_these(robot: str) -> None:
    true = tracker_points(robot, 60, seed=4)
    rows = true.observations
    joints = rows.joints_rad.copy()
    joints[30:, 3] *= -1.0  # that of A5 is half a turn of A4 as well
    with pytest.raises(MisfitError) as refused:
        refuse_gross_misfit(
            true.model, replace(rows, joints_rad=joints), np.full(60, 0.5), FileNames(J, length_unit="mm")
        )
    assert "the first 20 usable rows fit as they are" in refused.value.message
    assert "the last 20 fit if A4 counts the other way round" in refused.value.message
    assert "The last part: Turn the sign" in refused.value.remedy


@pytest.mark.parametrize("mounting", ["wall", "ceiling", "tilt:x=30"])
def test_another_robot_is_named_as_it_is_mounted(mounting: str) -> None:
    true = tracker_points("ur5", 40, seed=2)
    named = replace(true, model=load_model(f"ur5e@{mounting}"))
    assert f"`--robot ur5@{mounting}`" in refusal_of(named, search=True).remedy


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("count", [2, 3])
def test_far_devices_and_several_targets_in_turn_are_counted(robot: str, count: int) -> None:
    true = tracker_points(robot, 72, seed=7)
    places = true.observations.positions_m.copy()
    for each in range(1, count):
        there, rows = (
            exp_twist(np.array([0.8 * each, 0.1, 0.3, 0.2, 0.1, 0.7 * each])),
            np.arange(each, 72, count),
        )
        places[rows] = places[rows] @ there[:3, :3].T + there[:3, 3]
    said = refusal_of(true, places=places).message
    assert f"{count} targets or devices were measured in turn" in said


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(("joint", "other"), [(4, 3), (5, 4), (5, 3)])
def test_a_share_of_another_joint_that_a_column_lacks_is_named(robot: str, joint: int, other: int) -> None:
    true = tracker_points(robot, 60, seed=7)
    joints = true.observations.joints_rad.copy()
    joints[:, joint] -= 0.08 * joints[:, other]
    said = refusal_of(true, joints=joints).message
    assert f"{J[joint]} turns by about +0.0" in said
    assert f"of {J[other]} more than its column says" in said


@pytest.mark.parametrize("robot", ROBOTS)
def test_two_faults_of_the_joints_are_named_together(robot: str) -> None:
    true = tracker_points(robot, 60, seed=7)
    joints = true.observations.joints_rad[:, [0, 1, 2, 4, 3, 5]].copy()
    joints[:, 2] *= -1.0
    refused = refusal_of(true, joints=joints)
    assert "in another order: A1, A2, A3, A5, A4, A6, and A3 counts the other way round" in refused.message
    assert "joints=A1,A2,-A3,A5,A4,A6" in refused.remedy
    joints = np.roll(true.observations.joints_rad, 1, axis=0)
    joints[:, 1] *= -1.0
    refused = refusal_of(true, joints=joints)
    assert "1 row apart, and A2 counts the other way round" in refused.message
    assert "Move the joints 1 row up in the file." in refused.remedy
    assert "joints=A1,-A2,A3,A4,A5,A6" in refused.remedy
