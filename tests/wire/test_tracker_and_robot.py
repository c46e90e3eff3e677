"""A robot and a tracker together, through their real drivers: what is fitted is what the world hides."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cellcal.calibration.registration import best_fit_transform
from cellcal.drivers.operator.scripted import ScriptedOperator
from cellcal.procedures.steps.measure_point import PointCapture, check_station, measure_point, measure_pose
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.runs.cell_check import check_cell
from cellcal.service.runs.open_cell import open_cell
from tests.cell_tables import cell_head, fake_table, tracker_table, universal_robots_table
from tests.wire.fake_devices_process import TIME_FACTOR, run_fakes

CELL = "".join(
    (
        cell_head("tracker tests"),
        universal_robots_table(deadline_s=4.0, speed_limit_rad_s=1.0, settle_s=0.1),
        tracker_table(name="at", measures_poses=True, deadline_s=4.0, robot="ur"),
        fake_table(watchdog_factor=10.0, seed=11, time_factor=TIME_FACTOR),
    )
)
HOME = np.array([-1.2, -1.5, 1.6, -1.6, -1.5, 0.2])
POSES = 12


def draw_joints() -> np.ndarray:
    """Return joints around home, every axis well turned."""
    return HOME + np.random.default_rng(4).uniform(-0.5, 0.5, (POSES, 6))


def fit_frames(
    flanges: np.ndarray, captures: list[PointCapture], target_m: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Fit where the tracker stands and where the target sits; return target [m] and weighted residuals (n, 3)."""
    measured_m = np.array([capture.position_m for capture in captures])
    weights = [np.linalg.inv(np.linalg.cholesky(np.array(capture.covariance_m2))) for capture in captures]
    start = best_fit_transform((flanges @ [*target_m, 1.0])[:, :3], measured_m).target_source

    def pose_residuals(x: np.ndarray) -> np.ndarray:
        in_base = (flanges @ [*x[6:], 1.0])[:, :3]
        off = Rotation.from_rotvec(x[:3]).apply(in_base) + x[3:6] - measured_m
        return np.concatenate([w @ r for w, r in zip(weights, off, strict=True)])

    guess = [*Rotation.from_matrix(start.rotation_matrix()).as_rotvec(), *start.position_m, *target_m]
    found = least_squares(pose_residuals, guess, x_scale="jac")
    return found.x[6:], found.fun.reshape(-1, 3)


async def test_twelve_poses_measured_from_one_station_agree_within_the_trackers_noise(tmp_path: Path) -> None:
    with run_fakes(tmp_path, CELL) as (path, fake_client):
        config = read_cell_file(path)
        report = await check_cell(config)
        assert [device.state for device in report.devices] == ["ready", "ready"]
        async with open_cell(config, ScriptedOperator({})) as cell:
            assert cell.tracker_setup is not None
            captures, true_flanges, believed_flanges = [], [], []
            for k, joints in enumerate(draw_joints()):
                await cell.robot.move_joints(tuple(joints), speed_rad_s=1.0)
                captures.append(await measure_point(cell, f"pose {k + 1}", station=2))
                true_flanges.append((await fake_client.read_truth())["robots"]["ur"]["base_flange"])
                believed_flanges.append((await cell.robot.flange_pose()).to_matrix())
            pose = await measure_pose(cell, "the last pose again")
            await cell.robot.move_joints(tuple(draw_joints()[0]), speed_rad_s=1.0)
            again = await measure_point(cell, "pose 1 again", station=2)
            assert check_station(captures[0], again, arm_sigma_m=5e-5) < 3e-4
        truth = (await fake_client.read_truth())["trackers"]["at"]
    start = cell.tracker_setup.target_in_flange_m
    target, off = fit_frames(np.array(true_flanges), captures, start)
    freedom = 3 * POSES - 9
    assert (
        0.4 < (off**2).sum() / freedom < 2.0
    )  # 27 degrees of freedom: chi-square outside is a matter of 1e-3
    assert target == pytest.approx(truth["target_in_flange_m"], abs=3e-4)
    assert np.linalg.norm(target - np.array(start)) > 3e-4  # it was not simply believed
    _, with_robot = fit_frames(np.array(believed_flanges), captures, start)
    rms_m = np.sqrt((with_robot**2).mean()) * 3e-5
    assert 3e-5 < rms_m < 1e-3  # the arm's own errors, which the tracker now shows
    assert pose.station_probe.position_m == pytest.approx(captures[-1].position_m, abs=3e-4)
