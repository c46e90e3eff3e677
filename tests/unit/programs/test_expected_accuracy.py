"""What an expected error says beside its figure: which parameters, assumed and not measured, make it up."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.geometry import Array
from cellcal.service.engineering.programs.expected_accuracy import Expectation, TransferEnds
from cellcal.service.engineering.programs.project import Project, read_project
from tests.example_projects import FOLDER

J1_SPREAD_RAD = 0.005
POSTURES_RAD = np.array([[0.1 * k, 0.2, 0.1 * k - 0.2, 0.1, -0.9 + 0.05 * k, 0.2] for k in range(6)])


@pytest.fixture(scope="module")
def project() -> Project:
    """The cell without a fixture, its first joint's zero assumed."""
    found = read_project(FOLDER / "cell_1" / "project.toml")
    arm = found.identified
    assert arm is not None
    assert arm.covariance is not None
    assert arm.layout is not None
    row = [p.name for p in arm.layout.parameters].index("J1 offset")
    covariance = arm.covariance.copy()
    covariance[row, :] = covariance[:, row] = 0.0
    covariance[row, row] = J1_SPREAD_RAD**2
    assumed = replace(arm, covariance=covariance, undetermined=("J1 offset", "base x"))
    return replace(found, identified=assumed, alignment=None)


def foretell(project: Project, joints_rad: Array) -> tuple[Array, tuple[str, ...]]:
    expectation = Expectation(project, project, np.eye(4), nominal=True)
    ends = TransferEnds(joints_rad, joints_rad, project.tools["1"], project.tools["1"])
    errors_m = expectation.errors_m(ends)
    return errors_m, expectation.undetermined_remarks(ends, errors_m)


def test_an_error_that_an_assumed_zero_makes_up_names_that_zero(project: Project) -> None:
    errors_m, remarks = foretell(project, POSTURES_RAD[:1])
    tip = project.nominal.base_flange(POSTURES_RAD[:1])[0] @ project.tools["1"].entered
    assert errors_m[0] == pytest.approx(2.0 * J1_SPREAD_RAD * np.hypot(*tip[:2, 3]), rel=0.02)
    (remark,) = remarks
    assert remark.startswith(
        f"the expected error of up to {errors_m[0] * 1e3:.2f} mm is mostly that of J1 offset of"
    )


def test_a_zero_that_all_points_share_is_not_blamed(project: Project) -> None:
    errors_m, remarks = foretell(project, POSTURES_RAD)
    assert errors_m.max() < 1e-3
    assert remarks == ()


def test_a_measured_parameter_is_not_blamed(project: Project) -> None:
    arm = project.identified
    assert arm is not None
    measured = replace(project, identified=replace(arm, undetermined=()))
    assert foretell(measured, POSTURES_RAD[:1])[1] == ()


def test_an_arm_of_which_nothing_was_measured_names_what_is_assumed(project: Project) -> None:
    arm = project.identified
    assert arm is not None
    assert arm.covariance is not None
    assert arm.layout is not None
    assumed = tuple(p.name for p in arm.layout.parameters)
    nothing = replace(project, identified=replace(arm, undetermined=assumed))
    (remark,) = foretell(nothing, POSTURES_RAD[:1])[1]
    assert "mostly that of J1 offset of" in remark
