"""Programs with a rail or a positioner, moved, against a calculation by plain numpy: 1e-3 mm and 1e-4 deg."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.drivers.program_registry import brand_named
from cellcal.drivers.programs.cross_file_uses import BatchDeclarations
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.result import LEFT, ProgramResult
from cellcal.service.exit_codes import ExitCode
from tests.programs.external.brands import BRANDS, BrandSpelling, WrittenPoint, write_abb, write_fanuc
from tests.programs.external.cells import FRAME, ON_TABLE, TOOL, HandCell, rail, table
from tests.programs.external.hand_geometry import Array, apart, arm, flange_of, pose

CHANGE = pose((0.012, -0.008, 0.006), (0.01, -0.02, 0.06))
WITHIN_MM, WITHIN_DEG = 1e-3, 1e-4
brands = pytest.mark.parametrize("name", list(BRANDS))
coordination = pytest.mark.parametrize("coordinated", [True, False])


def move(project: Project, spelling: BrandSpelling, text: str, change: Array = CHANGE) -> ProgramResult:
    brand = brand_named(spelling.brand)
    program = brand.read(spelling.file, text.encode())
    return move_transfer(project, change, brand.configurations, joints="move").transfer_programs([program])[0]


def moved_points(result: ProgramResult, spelling: BrandSpelling) -> list[WrittenPoint]:
    return spelling.read(result.after.to_bytes().decode())


def expected_tips(cell: HandCell, points: list[WrittenPoint], change: Array) -> list[Array]:
    """Return where each tip shall be in its user frame."""
    found = []
    for point in points:
        frame = cell.entered_frame(point.axes)
        assert point.tip is not None
        in_cell = cell.base(point.axes) @ frame @ point.tip
        work = cell.work(point.axes)
        new = work @ change @ np.linalg.inv(work) @ in_cell
        found.append(np.linalg.inv(frame) @ np.linalg.inv(cell.base(point.axes)) @ new)
    return found


def assert_moved(
    cell: HandCell, result: ProgramResult, before: list[WrittenPoint], exit_code: ExitCode = ExitCode.PASS
) -> None:
    after = moved_points(result, cell.spelling)
    assert not result.excluded_points
    assert result.exit_code is exit_code
    assert len(after) == len(before)
    for old, new, tip in zip(before, after, expected_tips(cell, before, CHANGE), strict=True):
        assert new.axes == old.axes
        assert new.tip is not None
        distance, angle = apart(new.tip, tip)
        assert distance < WITHIN_MM
        assert angle < WITHIN_DEG
        assert apart(new.tip, old.tip)[0] > 1  # type: ignore[arg-type]


@brands
@coordination
def test_a_rail_s_points_go_along_with_the_work(name: str, coordinated: bool, tmp_path: Path) -> None:
    spelling = BRANDS[name]
    cell = HandCell(spelling, (rail(spelling, coordinated=coordinated, sign=-1, zero=150.0),))
    values = [{spelling.rail: value} for value in (150.0, 400.0, -220.5, 1250.25, 80.0)]
    text = spelling.write(cell.points(values), spelling.frame)
    result = move(cell.project(tmp_path), spelling, text)
    assert_moved(cell, result, spelling.read(text))


@brands
@coordination
def test_a_positioner_s_points_go_along_with_the_work(name: str, coordinated: bool, tmp_path: Path) -> None:
    spelling = BRANDS[name]
    axis = table(spelling, coordinated=coordinated, zero=30.0)
    cell = HandCell(spelling, (axis,), frame=axis.frame @ ON_TABLE if coordinated else FRAME)
    values = [{spelling.table: value} for value in (30.0, 75.0, -40.25, 120.0, 0.0)]
    text = spelling.write(cell.points(values), spelling.frame)
    result = move(cell.project(tmp_path), spelling, text)
    assert_moved(cell, result, spelling.read(text))


@brands
def test_a_robot_on_a_rail_beside_a_table(name: str, tmp_path: Path) -> None:
    spelling = BRANDS[name]
    axes = (rail(spelling), table(spelling, coordinated=False, sign=-1))
    cell = HandCell(spelling, axes)
    values = [{spelling.rail: 300.0 * k, spelling.table: 25.0 * k - 40} for k in range(5)]
    text = spelling.write(cell.points(values), spelling.frame)
    result = move(cell.project(tmp_path), spelling, text)
    assert_moved(cell, result, spelling.read(text))


@pytest.mark.parametrize("name", [name for name, one in BRANDS.items() if one.in_joints])
def test_joint_points_on_a_rail_go_along(name: str, tmp_path: Path) -> None:
    spelling = BRANDS[name]
    unsaid = '[unsaid]\ntool = "tGrip"\n' if name == "abb" else ""
    cell = HandCell(spelling, (rail(spelling, sign=-1),), lines=unsaid)
    values = [{spelling.rail: value} for value in (0.0, 400.0, -220.5, 1250.25, 80.0)]
    text = spelling.write(cell.points(values, joints=True), spelling.frame)
    result = move(cell.project(tmp_path), spelling, text)
    assert not result.excluded_points
    model = arm(spelling.model)
    for old, new in zip(spelling.read(text), moved_points(result, spelling), strict=True):
        assert old.joints is not None
        assert new.joints is not None
        base = cell.base(old.axes)
        before, after = (base @ flange_of(model, joints) @ TOOL for joints in (old.joints, new.joints))
        distance, angle = apart(CHANGE @ before, after)
        assert distance < WITHIN_MM
        assert angle < WITHIN_DEG
        assert new.axes == old.axes


@brands
@pytest.mark.parametrize("sort", ["rail", "table"])
def test_axes_that_the_project_does_not_state_leave_their_points(
    name: str, sort: str, tmp_path: Path
) -> None:
    spelling = BRANDS[name]
    axis = rail(spelling) if sort == "rail" else table(spelling, coordinated=False)
    cell = HandCell(spelling, (axis,))
    text = spelling.write(cell.points([{axis.axis: 100.0}]), spelling.frame)
    result = move(HandCell(spelling, ()).project(tmp_path), spelling, text)
    assert result.after.to_bytes() == text.encode()
    assert set(result.status) == {LEFT}
    assert any("external axes" in reason for reason in result.reason)
    assert result.exit_code is ExitCode.REFUSED


@brands
def test_a_point_that_states_no_value_or_one_beyond_the_range_is_left(name: str, tmp_path: Path) -> None:
    spelling = BRANDS[name]
    cell = HandCell(spelling, (rail(spelling),))
    points = cell.points([{spelling.rail: 100.0}])
    points[2] = WrittenPoint(points[2].tip, None, {spelling.rail: 4000.5})
    if name != "yaskawa":
        points[3] = WrittenPoint(points[3].tip, None, {})
    text = spelling.write(points, spelling.frame)
    result = move(cell.project(tmp_path), spelling, text)
    reasons = dict(result.excluded_points)
    assert "beyond its range" in result.reason[2]
    assert len(reasons) == (1 if name == "yaskawa" else 2)
    if name != "yaskawa":
        assert "does not say where" in result.reason[3]
    assert result.exit_code is ExitCode.REFUSED


def test_a_led_motion_goes_along_where_the_project_states_the_leader(tmp_path: Path) -> None:
    spelling = BRANDS["fanuc"]
    cell = HandCell(spelling, (table(spelling, coordinated=False),))
    text = write_fanuc(cell.points([{spelling.table: 20.0 * k} for k in range(5)]), spelling.frame, "COORD")
    result = move(cell.project(tmp_path), spelling, text)
    assert_moved(cell, result, spelling.read(text), ExitCode.REFUSED)
    assert [one.row for one in result.findings] == [0, 2, 4, 6, 8]  # of the robot, and not of the table
    assert all("(COORD)" in one.text for one in result.findings)
    unstated = move(HandCell(spelling, ()).project(tmp_path / "other"), spelling, text)
    assert unstated.after.to_bytes() == text.encode()
    assert unstated.exit_code is ExitCode.REFUSED


@pytest.mark.parametrize(
    ("name", "old", "new", "why"),
    [
        ("abb", "PROC main()", "PROC main()\np1.extax.eax_a:=500;", "sets a component of it while it runs"),
        ("fanuc", "/POS", "   9:  PR[1,7]=500    ;\n/POS", "sets values of external axes"),
        ("yaskawa", "NOP", "NOP\nSETE BP001 (1) 500", "sets values of external axes"),
    ],
)
def test_a_program_that_sets_an_axis_while_it_runs_leaves_its_points(
    name: str, old: str, new: str, why: str, tmp_path: Path
) -> None:
    spelling = BRANDS[name]
    cell = HandCell(spelling, (rail(spelling),))
    text = spelling.write(cell.points([{spelling.rail: 100.0}]), spelling.frame).replace(old, new, 1)
    result = move(cell.project(tmp_path), spelling, text)
    assert set(result.status) == {LEFT}
    assert why in result.reason[0]
    assert result.exit_code is ExitCode.REFUSED


@pytest.mark.parametrize("turned", [True, False])
def test_krl_that_takes_its_base_from_a_turning_table(turned: bool, tmp_path: Path) -> None:
    spelling = BRANDS["kuka"]
    axis = table(spelling)
    cell = HandCell(spelling, (axis,), frame=axis.frame @ ON_TABLE)
    point = spelling.read(spelling.write(cell.points([{"E2": 40.0}]), "2"))[0]
    assert point.tip is not None
    data = spelling.write([point], "2").splitlines()[1].partition("=")[2]
    text = (
        "DEF RAIL()\n$BASE = EK(MACHINE_DEF[2].ROOT, MACHINE_DEF[2].MECH_TYPE, BASE_DATA[2])\n"
        f"$TOOL = TOOL_DATA[1]\nLIN {data}\nEND\n"
    )
    brand = brand_named("kuka")
    stated = cell if turned else HandCell(spelling, (table(spelling, coordinated=False),))
    program = brand.read("rail.src", text.encode())
    result = move_transfer(
        stated.project(tmp_path), CHANGE, brand.configurations, joints="move"
    ).transfer_programs([program])[0]
    if not turned:
        assert result.reason == ("an external axis turns its base, and no program file holds how",)
        return
    assert not result.excluded_points
    moved = result.after.to_bytes().decode().replace("LIN {", "DECL E6POS X={")
    new = spelling.read(moved)[0]
    assert new.tip is not None
    distance, angle = apart(new.tip, expected_tips(cell, [point], CHANGE)[0])
    assert distance < WITHIN_MM
    assert angle < WITHIN_DEG


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_work_object_that_a_mechanical_unit_moves(elsewhere: bool, tmp_path: Path) -> None:
    """The work object may stand in another module; without a coordinated positioner its targets are left."""
    spelling = BRANDS["abb"]
    axis = table(spelling)
    cell = HandCell(spelling, (axis,), frame=axis.frame @ ON_TABLE)
    declared = 'PERS wobjdata wTab:=[FALSE,FALSE,"STN1",[[0,0,0],[1,0,0,0]],[[30,20,50],[1,0,0,0]]];'
    points = cell.points([{spelling.table: 30.0 * k} for k in range(5)])
    text = write_abb(points, "wTab", declarations=() if elsewhere else (declared,))
    files = {"cell.mod": f"MODULE CELL\n{declared}\nENDMODULE\n"} if elsewhere else {}
    files[spelling.file] = text
    brand = brand_named("abb")

    def run(project: Project) -> ProgramResult:
        read = [brand.read(name, one.encode()) for name, one in files.items()]
        across = BatchDeclarations({name: one.declarations for name, one in zip(files, read, strict=True)})  # type: ignore[attr-defined]
        read = [
            one.with_external_uses(across.uses_of_file(name))  # type: ignore[attr-defined]
            for name, one in zip(files, read, strict=True)
        ]
        return move_transfer(project, CHANGE, brand.configurations, joints="move").transfer_programs(read)[-1]

    assert_moved(cell, run(cell.project(tmp_path / "stated")), spelling.read(text))
    still = HandCell(spelling, (table(spelling, coordinated=False),), frame=cell.frame)
    left_result = run(still.project(tmp_path / "still"))
    assert set(left_result.status) == {LEFT}
    assert "mechanical unit" in left_result.reason[0]
    assert left_result.after.to_bytes() == text.encode()
