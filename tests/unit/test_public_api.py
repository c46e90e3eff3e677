"""``import cellcal`` gives the documented functions, quickly, and nothing else is promised."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cellcal

PROGRAMS = Path(__file__).parents[2] / "deploy" / "example_projects"


def test_every_public_name_can_be_had_and_is_documented() -> None:
    for name in cellcal.__all__:
        assert getattr(cellcal, name).__doc__, name
    assert dir(cellcal) == sorted(cellcal.__all__)
    with pytest.raises(AttributeError, match="no attribute 'told'"):
        cellcal.told  # noqa: B018


def test_importing_it_loads_no_mathematics() -> None:
    script = "import sys, cellcal; print('numpy' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "False"


def test_a_robot_is_loaded_by_name_and_a_wrong_name_gets_the_nearest() -> None:
    assert "ur10" in cellcal.robot_names()
    robot = cellcal.load_robot("ur10")
    assert robot.base_flange(np.zeros((1, 6))).shape == (1, 4, 4)
    with pytest.raises(cellcal.CellError) as refused:
        cellcal.load_robot("ur11")
    assert "ur10" in refused.value.remedy


def test_a_program_is_read_whatever_its_brand() -> None:
    program = next(path for path in sorted(PROGRAMS.rglob("*")) if path.suffix.lower() == ".ls")
    assert len(cellcal.read_program(program).positions) > 0
    with pytest.raises(cellcal.CellError):
        cellcal.read_program(__file__)


def test_measurements_are_read_and_identified(tmp_path: Path) -> None:
    robot = cellcal.load_robot("ur10")
    rng = np.random.default_rng(1)
    joints_rad = rng.uniform(-2.0, 2.0, (40, 6))
    points_m = robot.base_flange(joints_rad)[:, :3, 3] + rng.normal(0, 2e-5, (40, 3))
    path = tmp_path / "measured.csv"
    head = "q1 [rad],q2 [rad],q3 [rad],q4 [rad],q5 [rad],q6 [rad],x [m],y [m],z [m]"
    np.savetxt(path, np.hstack([joints_rad, points_m]), delimiter=",", header=head, comments="")
    assert len(cellcal.read_measurements(path, "ur10").rows) == 40
    report = cellcal.identify(path, robot.name)
    assert report.held_out.rmse_m < 1e-4
    ahead = cellcal.predict_readings(report.identification, joints_rad[:3])
    assert (ahead.expanded_m > 0).all()
