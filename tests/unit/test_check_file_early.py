"""Files are looked at before the work: a check file that cannot be used, or results already there, cost nothing."""

import numpy as np
import pytest

from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.identification import identify as use_case
from cellcal.service.engineering.identification import pose_planning
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from cellcal.service.engineering.measured.table import MeasurementError
from tests.unit.helpers.simulated_arm import tracker_points


def write(path, observations, order):
    joints, places = np.rad2deg(observations.joints_rad), observations.positions_m[order] * 1e3
    lines = [",".join(f"{v:.5f}" for v in row) for row in np.hstack([joints, places])]
    path.write_text("\n".join(["J1,J2,J3,J4,J5,J6,X,Y,Z", *lines]), encoding="utf-8")


@pytest.fixture
def no_work(monkeypatch):
    def work(*_):
        raise AssertionError("the work began")

    monkeypatch.setattr(use_case, "fit_rows", work)


@pytest.mark.parametrize(
    ("check", "refusal"),
    [("missing.csv", MeasurementError), ("turned.csv", MisfitError), ("empty.csv", MeasurementError)],
)
@pytest.mark.usefixtures("no_work")
def test_a_check_file_that_cannot_be_used_is_refused_before_the_work(tmp_path, check, refusal):
    rows = tracker_points("ur10", 40).observations
    write(tmp_path / "fit.csv", rows, np.arange(40))
    write(tmp_path / "turned.csv", rows, np.arange(40)[::-1])
    (tmp_path / "empty.csv").write_text("J1,J2,J3,J4,J5,J6,X,Y,Z\n", encoding="utf-8")
    with pytest.raises(refusal):
        use_case.identify_file(tmp_path / "fit.csv", "ur10", IdentifyOptions(check=tmp_path / check))


@pytest.fixture
def no_plan(monkeypatch):
    def plan(*_):
        raise AssertionError("the work began")

    monkeypatch.setattr(pose_planning, "plan_poses", plan)


@pytest.mark.parametrize(
    "command",
    [
        ("identify", "fit.csv", "--robot", "ur10", "--at", "at.csv", "--at-csv", "there.csv"),
        ("poses", "--robot", "ur10", "--sigma-mm", "0.1", "--csv", "there.csv"),
        ("ur-model", "127.0.0.1", "--arm", "ur15", "--out", "there.csv"),
    ],
)
@pytest.mark.usefixtures("no_work", "no_plan")
def test_a_result_that_is_there_already_is_refused_before_the_work(tmp_path, command, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "fit.csv", tracker_points("ur10", 40).observations, np.arange(40))
    (tmp_path / "at.csv").write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n0,0,0,0,0,0\n")
    (tmp_path / "there.csv").write_text("of its owner\n")
    assert run_command_line(list(command)) != 0
    assert "there.csv is there already." in capsys.readouterr().err
    assert (tmp_path / "there.csv").read_text() == "of its owner\n"
