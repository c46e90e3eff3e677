"""Programs that hold Cartesian points only: the posture in which they begin tells the branch of their joints."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellcal.calibration.compensation.compensate import ProgramDirection
from cellcal.drivers.program_registry import brand_named
from cellcal.service.engineering.programs.compensate import compensation_transfer
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.project_poses import ProjectError
from cellcal.service.engineering.programs.result import LEFT, ProgramResult
from cellcal.service.exit_codes import ExitCode
from tests.programs.external.brands import BRANDS, BrandSpelling
from tests.programs.external.cells import TOOL, HandCell
from tests.programs.external.hand_geometry import apart, arm, flange_of
from tests.programs.external.test_clones_and_compensation import joints_of, real_arm, write_project

POSTURES = np.radians(
    [[10, -80, 90, -100, -85, 15], [25, -70, 80, -95, -80, 30], [-15, -95, 105, -100, -95, 5]]
)
ELBOW_DOWN = np.radians([10, 5, -90, -10, -85, 15])


def script_of(postures: np.ndarray) -> str:
    model = arm("ur5")
    lines = ["def weld():", "  set_tcp(p[0,0,0,0,0,0])"]
    for joints in postures:
        flange = flange_of(model, joints)
        values = [*flange[:3, 3], *Rotation.from_matrix(flange[:3, :3]).as_rotvec()]
        lines.append(f"  movel(p[{', '.join(f'{v:.9f}' for v in values)}], a=1.2, v=0.25)")
    return "\n".join([*lines, "end", ""])


def compensate(tmp_path: Path, text: str, lines: str, more: str = "") -> ProgramResult:
    spelling = BrandSpelling(
        "universal_robots", "ur5", "weld.script", "", "", "x", "y", (), lambda *_: "", lambda _: []
    )
    write_project(HandCell(spelling, ()), tmp_path / "cell", real=real_arm(arm("ur5"), 3), serial="U")
    path = tmp_path / "cell" / "project.toml"
    path.write_text(
        path.read_text().replace('parameters = "robot.toml"', f'parameters = "robot.toml"\n{lines}', 1) + more
    )
    brand = brand_named("universal_robots")
    program = brand.read("weld.script", text.encode())
    return compensation_transfer(
        read_project(path), ProgramDirection.UPLOAD, brand.configurations
    ).transfer_programs([program])[0]


def tips_of(text: str) -> list[np.ndarray]:
    found = []
    for line in text.splitlines():
        if "movel(p[" in line:
            values = np.array([float(v) for v in line.partition("[")[2].partition("]")[0].split(",")])
            tip = np.eye(4)
            tip[:3, :3], tip[:3, 3] = Rotation.from_rotvec(values[3:]).as_matrix(), values[:3]
            found.append(tip)
    return found


def test_a_script_of_poses_only_is_left_without_a_starting_posture(tmp_path: Path) -> None:
    text = script_of(POSTURES)
    result = compensate(tmp_path, text, "")
    assert set(result.status) == {LEFT}
    assert result.after.to_bytes() == text.encode()
    assert result.exit_code is ExitCode.REFUSED


@pytest.mark.parametrize("down", [False, True])
def test_a_script_of_poses_only_is_compensated_in_the_branch_where_it_begins(
    tmp_path: Path, down: bool
) -> None:
    """The same poses in two postures of the elbow get different corrections."""
    text = script_of(POSTURES)
    begin = ELBOW_DOWN if down else POSTURES[0]
    model, real = arm("ur5"), real_arm(arm("ur5"), 3)
    lines = f"starting_posture_deg = {np.degrees(begin).tolist()}"
    result = compensate(tmp_path, text, lines)
    assert not result.excluded_points
    start = begin
    for old, new in zip(tips_of(text), tips_of(result.after.to_bytes().decode()), strict=True):
        start = joints_of(model, new, np.array([start]))
        assert (start[2] < 0) == down
        distance, angle = apart(flange_of(real, start), old)
        assert distance < 1e-3
        assert angle < 1e-4


def test_a_posture_of_one_program_goes_before_that_of_all(tmp_path: Path) -> None:
    text = script_of(POSTURES)
    usual = f"starting_posture_deg = {np.degrees(POSTURES[0]).tolist()}"
    own = f"[starting_postures]\nweld = {np.degrees(ELBOW_DOWN).tolist()}\n"
    result = compensate(tmp_path, text, usual, own)
    model = arm("ur5")
    first = joints_of(model, tips_of(result.after.to_bytes().decode())[0], ELBOW_DOWN[None])
    assert apart(flange_of(real_arm(model, 3), first), tips_of(text)[0])[0] < 1e-3
    assert first[2] < 0


def test_krl_without_status_and_turn(tmp_path: Path) -> None:
    spelling = BRANDS["kuka"]
    cell = HandCell(spelling, ())
    text = spelling.write(cell.points([{}]), spelling.frame)
    bare = "\n".join(line.partition(",S 2")[0] + "}" if ",S 2" in line else line for line in text.split("\n"))
    real = real_arm(arm(spelling.model), 4)
    write_project(cell, tmp_path / "a", real=real, serial="K")
    path = tmp_path / "a" / "project.toml"
    brand = brand_named("kuka")

    def run() -> ProgramResult:
        transfer = compensation_transfer(read_project(path), ProgramDirection.UPLOAD, brand.configurations)
        return transfer.transfer_programs([brand.read(spelling.file, bare.encode())])[0]

    assert set(run().status) == {LEFT}
    begin = list(spelling.postures[0])
    path.write_text(path.read_text().replace("[robot]\n", f"[robot]\nstarting_posture_deg = {begin}\n", 1))
    result = run()
    assert not result.excluded_points
    for old, new in zip(spelling.read(bare), spelling.read(result.after.to_bytes().decode()), strict=True):
        assert old.tip is not None
        assert new.tip is not None
        flange = cell.frame @ new.tip @ np.linalg.inv(TOOL)
        joints = joints_of(arm(spelling.model), flange, np.radians(spelling.postures))
        distance, angle = apart(flange_of(real, joints) @ TOOL, cell.frame @ old.tip)
        assert distance < 1e-3
        assert angle < 1e-4


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("starting_posture_deg = [1, 2]", "6 finite numbers"),
        ("starting_posture_deg = [900, 0, 0, 0, 0, 0]", "joint 1 at 900 is beyond its limit"),
    ],
)
def test_a_starting_posture_that_is_none(line: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "project.toml"
    path.write_text(HandCell(BRANDS["kuka"], ()).project_text().replace("[robot]\n", f"[robot]\n{line}\n", 1))
    with pytest.raises(ProjectError) as refused:
        read_project(path)
    assert says in refused.value.message
