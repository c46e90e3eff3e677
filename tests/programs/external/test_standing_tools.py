"""Tools that stand in the cell, and work in the gripper, against plain numpy."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.drivers.program_registry import brand_named
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.result import LEFT, ProgramResult
from cellcal.service.exit_codes import ExitCode
from tests.programs.external.brands import BRANDS, WrittenPoint, write_abb, write_fanuc, write_kuka
from tests.programs.external.cells import FRAME, TOOL, HandCell, pose_text, rail
from tests.programs.external.hand_geometry import Array, apart, arm, flange_of, pose

STAND = pose((0.42, 0.1, 0.35), (0.3, 0.0, 1.0))  # the tool in the cell
WORK = pose((0.02, 0.01, 0.09), (0.0, 0.3, 0.1))  # on the flange
CHANGE = pose((0.012, -0.008, 0.006), (0.01, -0.02, 0.06))
SHIFT = pose((0.012, -0.008, 0.006))
STATED = {
    "kuka": "[standing_tools.2.entered]\n{stand}[held_work.1.entered]\n{work}",
    "abb": "[standing_tools.tStand.entered]\n{stand}[held_work.wHeld.entered]\n{work}",
    "fanuc": "[standing_tools.2.entered]\n{stand}",
}
DECLARED = (
    "PERS tooldata tStand:=[FALSE,[[420,100,350],[1,0,0,0]],[1,[0,0,20],[1,0,0,0],0,0,0]];",
    'PERS wobjdata wHeld:=[TRUE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
)


def stated(name: str) -> str:
    return STATED[name].format(stand=pose_text(STAND), work=pose_text(WORK))


def points_of(name: str, base: Array | None = None) -> list[WrittenPoint]:
    """Return poses of the standing tool, seen from the work in the gripper."""
    model = arm(BRANDS[name].model)
    stand = np.linalg.inv(np.eye(4) if base is None else base) @ STAND
    return [
        WrittenPoint(np.linalg.inv(flange_of(model, np.radians(posture)) @ WORK) @ stand, None, {})
        for posture in BRANDS[name].postures
    ]


def text_of(name: str, points: list[WrittenPoint]) -> str:
    if name == "kuka":
        return write_kuka(points, "2", "#TCP")
    return write_abb(points, "wHeld", "tStand", DECLARED)


def move(name: str, text: str, lines: str, folder: Path, change: Array = CHANGE) -> ProgramResult:
    spelling = BRANDS[name]
    brand = brand_named(name)
    project = HandCell(spelling, (), lines=lines).project(folder)
    program = brand.read(spelling.file, text.encode())
    return move_transfer(project, change, brand.configurations, joints="move").transfer_programs([program])[0]


@pytest.mark.parametrize("name", ["kuka", "abb"])
def test_work_in_the_gripper_follows_the_tool_in_the_cell(name: str, tmp_path: Path) -> None:
    text = text_of(name, points_of(name))
    result = move(name, text, stated(name), tmp_path)
    assert not result.excluded_points
    assert result.exit_code is ExitCode.PASS
    read = BRANDS[name].read
    for old, new in zip(read(text), read(result.after.to_bytes().decode()), strict=True):
        assert old.tip is not None
        assert new.tip is not None
        before, after = (STAND @ np.linalg.inv(one.tip) for one in (old, new))  # the work, in the cell
        distance, angle = apart(CHANGE @ before, after)
        assert distance < 1e-3
        assert angle < 1e-4


@pytest.mark.parametrize("name", ["kuka", "abb"])
def test_work_in_the_gripper_is_left_where_the_project_states_no_tool(name: str, tmp_path: Path) -> None:
    text = text_of(name, points_of(name))
    result = move(name, text, "", tmp_path)
    assert set(result.status) == {LEFT}
    assert "tool" in result.reason[0]
    assert "not taught" not in result.reason[0]
    assert result.after.to_bytes() == text.encode()
    assert result.exit_code is ExitCode.REFUSED


def test_a_robot_on_a_rail_with_work_in_its_gripper(tmp_path: Path) -> None:
    spelling = BRANDS["kuka"]
    cell = HandCell(spelling, (rail(spelling),), lines=stated("kuka"))
    points = [
        WrittenPoint(one.tip, None, {"E1": 250.0}) for one in points_of("kuka", cell.base({"E1": 250.0}))
    ]
    text = text_of("kuka", points)
    brand = brand_named("kuka")
    program = brand.read(spelling.file, text.encode())
    result = move_transfer(
        cell.project(tmp_path), CHANGE, brand.configurations, joints="move"
    ).transfer_programs([program])[0]
    assert not result.excluded_points
    for old, new in zip(spelling.read(text), spelling.read(result.after.to_bytes().decode()), strict=True):
        assert old.tip is not None
        assert new.tip is not None
        before, after = (STAND @ np.linalg.inv(one.tip) for one in (old, new))
        distance, angle = apart(CHANGE @ before, after)
        assert distance < 1e-3
        assert angle < 1e-4


def test_a_shift_along_the_standing_tool_leaves_the_work_where_its_axes_turn(tmp_path: Path) -> None:
    text = text_of("abb", points_of("abb")).replace("MoveL p1,", "MoveL RelTool(p1,0,0,-20),")
    turned = move("abb", text, stated("abb"), tmp_path)
    assert set(turned.status) == {LEFT}
    assert "axes of the tool in the cell" in turned.reason[0]
    shifted = move("abb", text, stated("abb"), tmp_path, SHIFT)
    assert not shifted.excluded_points or "axes of the tool" not in shifted.reason[0]


def test_a_fanuc_point_with_rtcp_goes_along_where_the_project_states_the_tool(tmp_path: Path) -> None:
    spelling = BRANDS["fanuc"]
    model = arm(spelling.model)
    points = [
        WrittenPoint(np.linalg.inv(FRAME) @ flange_of(model, np.radians(posture)) @ TOOL, None, {})
        for posture in spelling.postures
    ]
    text = write_fanuc(points, "2", "RTCP")
    result = move("fanuc", text, stated("fanuc"), tmp_path)
    assert not result.excluded_points
    for old, new in zip(spelling.read(text), spelling.read(result.after.to_bytes().decode()), strict=True):
        assert old.tip is not None
        assert new.tip is not None
        distance, angle = apart(np.linalg.inv(FRAME) @ CHANGE @ FRAME @ old.tip, new.tip)
        assert distance < 1e-3
        assert angle < 1e-4
    assert any("(RTCP, #TCP)" in warning for warning in result.warnings)
    unstated = move("fanuc", text, "", tmp_path / "other")
    assert set(unstated.status) == {LEFT}
    assert "stands in the cell" in unstated.reason[0]
