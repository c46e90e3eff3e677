"""Two changes within a series, and a joint whose zero changed, are named; effects that drift are none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import exp_twist
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.series_changes import (
    DEVICE,
    JOINT,
    TARGET,
    SeriesChanges,
    find_series_changes,
    refuse_series_changes,
)
from cellcal.calibration.identification.target_change import series_columns
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.unit.helpers.simulated_arm import SimulatedMeasurements, tracker_points
from tests.unit.test_divided_rows import HEADING, cells_of, with_other_target, write

ROBOTS = ["ur10", "abb_irb120", "fanuc_m6ib", "kuka_kr6_r900"]
AWAY_M = [0.0, 1.2e-3, 1.6e-3]


def series_changes_of(model: RobotModel, rows: PointObservations) -> SeriesChanges | None:
    return find_series_changes(series_columns(model, rows), rows)


def frames_of(true: SimulatedMeasurements) -> np.ndarray:
    return true.truth.seen_from(0).base_flange(true.observations.joints_rad)[:, :3, :3]


def with_device_moved(rows: PointObservations, first: int) -> PointObservations:
    move = exp_twist(np.array([2e-3, -1e-3, 1.5e-3, 0.0, 4e-4, 1e-3]))
    places = rows.positions_m.copy()
    places[first:] = places[first:] @ move[:3, :3].T + move[:3, 3]
    return replace(rows, positions_m=places)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("count", [60, 90])
def test_a_target_that_was_away_for_a_while(robot: str, count: int) -> None:
    true = tracker_points(robot, count, seed=3)
    found = series_changes_of(true.model, with_other_target(true, 20, AWAY_M, until=42))
    assert found is not None
    (change,) = found.changes
    assert (change.kind, change.row, change.until) == (TARGET, 20, 42)
    assert change.size == pytest.approx(2e-3, rel=0.1)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_target_that_changed_twice(robot: str) -> None:
    true = tracker_points(robot, 70, seed=4)
    places = with_other_target(true, 20, AWAY_M).positions_m.copy()
    places[45:] += (frames_of(true) @ np.array([2e-3, 0.0, 0.5e-3]))[45:]
    found = series_changes_of(true.model, replace(true.observations, positions_m=places))
    assert found is not None
    assert [(each.kind, each.row) for each in found.changes] == [(TARGET, 20), (TARGET, 45)]


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(("of_device", "of_target"), [(22, 44), (44, 22), (33, 33)])
def test_a_target_that_changed_and_a_device_that_was_moved(
    robot: str, of_device: int, of_target: int
) -> None:
    true = tracker_points(robot, 66, seed=5)
    found = series_changes_of(
        true.model, with_device_moved(with_other_target(true, of_target, AWAY_M), of_device)
    )
    assert found is not None
    assert {(each.kind, each.row) for each in found.changes} == {(TARGET, of_target), (DEVICE, of_device)}


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("joint", [1, 2, 3, 4])
def test_a_joint_whose_zero_changed(robot: str, joint: int) -> None:
    true = tracker_points(robot, 60, seed=6)
    joints = true.observations.joints_rad.copy()
    # A motor's zero turns one axis of the arm, also where the controller shows two joints coupled.
    joints[28:] += np.linalg.solve(true.model.joint_coupling, np.eye(6)[joint] * np.deg2rad(0.3))
    found = series_changes_of(true.model, replace(true.observations, joints_rad=joints))
    assert found is not None
    (change,) = found.changes
    assert (change.kind, change.joint) == (JOINT, f"J{joint + 1}")
    assert abs(change.row - 28) <= 1
    assert np.rad2deg(change.size) == pytest.approx(0.3, rel=0.1)


@pytest.mark.parametrize("robot", ["ur10", "abb_irb120"])
def test_what_drifts_or_was_moved_once_or_twice_is_no_such_change(robot: str) -> None:
    for seed in range(3):
        true = tracker_points(robot, 60, seed=seed)
        rows: PointObservations = true.observations
        ramp = np.linspace(0.0, 1.0, 60)[:, None]
        turn = true.truth.seen_from(0).base_flange(rows.joints_rad + np.eye(6)[1] * 5e-4)[:, :3, 3]
        turn = turn - true.truth.seen_from(0).base_flange(rows.joints_rad)[:, :3, 3]
        outliers = np.random.default_rng(seed).normal(0.0, 3e-3, (60, 3)) * (np.arange(60) % 17 == 3)[:, None]
        for effect in (0.0 * ramp, ramp * [1e-3, 0.0, 5e-4], turn * ramp, turn * np.sin(9 * ramp), outliers):
            moved = replace(rows, positions_m=rows.positions_m + effect)
            assert series_changes_of(true.model, moved) is None
        twice = with_device_moved(with_device_moved(rows, 20), 41)
        assert series_changes_of(true.model, twice) is None


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("upwards", [False, True])
def test_the_play_of_a_joint_that_sweeps_up_and_back_is_no_change(
    robot: str, joint: int, upwards: bool
) -> None:
    true = tracker_points(robot, 80, seed=6)
    order = np.argsort(true.observations.joints_rad[:, joint])
    rows = true.observations.select_rows(np.concatenate([order[::2], order[1::2][::-1]]))
    joints = rows.joints_rad.copy()
    one_side = np.arange(80) < 40 if upwards else np.arange(80) >= 40
    joints[one_side] += np.linalg.solve(true.model.joint_coupling, np.eye(6)[joint] * np.deg2rad(0.1))
    assert series_changes_of(true.model, replace(rows, joints_rad=joints)) is None


def test_the_refusal_names_rows_of_the_file() -> None:
    true = tracker_points("abb_irb120", 60)
    found = series_changes_of(true.model, with_other_target(true, 20, AWAY_M, until=40))
    with pytest.raises(
        MisfitError, match=r"2\.0\d mm elsewhere on the flange in the rows 24 to 43"
    ) as refused:
        refuse_series_changes(true.model, found, np.arange(60) + 4)
    assert "Divide the file at these rows" in refused.value.remedy


def test_the_command_refuses_a_target_that_was_away(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    true = tracker_points("abb_irb120", 60)
    rows = cells_of(with_other_target(true, 20, [0.0, 0.0, 0.04], until=40))
    file = write(tmp_path / "away.csv", HEADING, *rows)
    assert run_command_line(["identify", str(file), "--robot", "abb_irb120"]) == ExitCode.REFUSED
    assert "in the rows 20 to 39" in " ".join(capsys.readouterr().err.split())
