"""Jobs in encoder pulses: cloned where the project gives the pulses of each axis, left with the reason where not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.drivers.yaskawa.program_files.job_program import JobProgram, read_job
from cellcal.service.engineering.programs.clone import clone_programs
from cellcal.service.engineering.programs.project import Project, read_project
from cellcal.service.engineering.programs.project_poses import ProjectError
from cellcal.service.engineering.programs.result import LEFT, ProgramResult
from tests.unit.helpers.cloned_program import ClonedCells, changed_rows

_RATIOS = np.array([82_000.0, -82_000.0, 65_500.0, -57_300.5, 57_300.5, 41_000.0])
_MODEL = Path(__file__).parents[3] / "calibration" / "arm" / "robot_models" / "fanuc_m6ib.toml"
_PROJECT = """format = 1
[robot]
serial = "Y-1"
model = "an_arm"
arm = "an_arm.toml"
pulses_per_rad = [82000, -82000, 65500, -57300.5, 57300.5, 41000]
[tools.0.entered]
position_mm = [0, 0, 150]
"""


def _pulse_job(joints: np.ndarray) -> JobProgram:
    """Return a job of these postures (N, 6), in pulses."""
    rows = [
        f"C{i:05d}=" + ",".join(str(round(count)) for count in posture)
        for i, posture in enumerate((joints * _RATIOS).tolist())
    ]
    moves = [f"MOVJ C{i:05d} VJ=25.00" for i in range(len(rows))]
    head = ["/JOB", "//NAME WELD", "//POS", f"///NPOS {len(rows)},0,0,0,0,0"]
    header_lines = ["///TOOL 1", "///POSTYPE PULSE", "///PULSE"]
    lines = [*head, *header_lines, *rows, "//INST", "///DATE 2026/11/22 12:00", "NOP", *moves, "END"]
    return read_job("WELD.JBI", ("\r\n".join(lines) + "\r\n").encode())


def _of_a_yaskawa(project: Project, ratios: np.ndarray | None) -> Project:
    """Return a cell's project as that of a robot whose programs are jobs."""
    named = {"nominal": replace(project.nominal, name="an_arm"), "pulses_per_rad": ratios}
    return replace(project, **named)


def _clone_job(cells: ClonedCells, master: np.ndarray | None, clone: np.ndarray | None) -> ProgramResult:
    projects = (
        _of_a_yaskawa(cells.master_project, master),
        _of_a_yaskawa(cells.clone_project, clone),
    )
    return clone_programs([_pulse_job(cells.joints)], *projects, None)[0]


def test_pulses_are_cloned_to_where_the_fixture_is(tmp_path: Path) -> None:
    cells = ClonedCells.make(3, tmp_path, points=12)

    result = _clone_job(cells, _RATIOS, _RATIOS)

    rows = changed_rows(result)
    assert len(rows) >= 10
    written = read_job("WELD.JBI", result.after.to_bytes(), pulses_per_rad=_RATIOS)
    there = cells.clone.tips_at_fixture(written.positions.joints[rows])
    here = cells.master.tips_at_fixture(cells.joints[rows])
    assert np.linalg.norm(there[:, :3, 3] - here[:, :3, 3], axis=1).max() < 0.5e-3
    assert [line for line in result.after.to_bytes().splitlines() if not line.startswith(b"C0")] == [
        line for line in result.before.to_bytes().splitlines() if not line.startswith(b"C0")
    ]


def test_without_ratios_every_point_is_left_and_the_cure_named(tmp_path: Path) -> None:
    cells = ClonedCells.make(3, tmp_path, points=3)

    result = _clone_job(cells, None, None)

    assert set(result.status) == {LEFT}
    assert all("pulses_per_rad under [robot]" in reason for reason in result.reason)
    assert result.after.to_bytes() == result.before.to_bytes()


def test_two_ratios_for_one_type_are_refused(tmp_path: Path) -> None:
    cells = ClonedCells.make(3, tmp_path, points=3)

    with pytest.raises(ProjectError, match="different pulses per radian"):
        _clone_job(cells, _RATIOS, _RATIOS * 2)


def test_a_project_names_an_arm_of_its_own_and_its_pulses(tmp_path: Path) -> None:
    (tmp_path / "an_arm.toml").write_bytes(_MODEL.read_bytes())
    (tmp_path / "project.toml").write_text(_PROJECT)

    project = read_project(tmp_path / "project.toml")

    assert project.nominal.name == "an_arm"
    assert project.pulses_per_rad is not None
    assert project.pulses_per_rad.tolist() == _RATIOS.tolist()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[82000,", "[0,", "holds a zero"),
        ("[82000, -82000,", "[82000,", "6 finite numbers"),
        ('arm = "an_arm.toml"', "", "name a file of another one as arm"),
        ('"an_arm.toml"', '"project.toml"', "missing"),
        ('"an_arm.toml"', '"none.toml"', "cannot be read"),
    ],
)
def test_faults_of_arm_or_pulses_are_named(tmp_path: Path, old: str, new: str, words: str) -> None:
    (tmp_path / "an_arm.toml").write_bytes(_MODEL.read_bytes())
    (tmp_path / "project.toml").write_text(_PROJECT.replace(old, new))

    with pytest.raises(ProjectError) as refused:
        read_project(tmp_path / "project.toml")
    assert words in f"{refused.value.message} {refused.value.remedy}"
