"""A tool whose pose a program writes: its measured tip counts, several are refused, and none is said.

Arms are nominal here, so that what a correction must write is known without them: the tip of a point p is expected at p,
and the controller is told ``p T^-1 t`` for a tool that it has at t and that is at T.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.compensation.compensate import ProgramDirection
from cellcal.calibration.geometry import Pose
from cellcal.calibration.points.alignment import Alignment, alignment_text
from cellcal.drivers.program_registry import brand_named
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.batches import read_batches
from cellcal.service.engineering.programs.clone import clone_transfer
from cellcal.service.engineering.programs.compensate import compensation_transfer
from cellcal.service.engineering.programs.files import find_programs
from cellcal.service.engineering.programs.project import Project, read_project
from cellcal.service.engineering.programs.result import ProgramResult
from cellcal.service.exit_codes import ExitCode
from tests.programs.external.hand_geometry import Array, apart, pose
from tests.programs.external.test_clones_and_compensation import POINTS, write_parameters
from tests.programs.test_universal_robots_urp import _urp_bytes, _waypoint_xml

SCRIPT = """{before}def prog():
  {setting}
  movej([0.1,-1.2,1.4,-1.7,-1.5,0.2], a=1.4, v=1.05)
  movel(p[0.4,-0.5,0.5,2.2,2.2,0.1], a=1.2, v=0.25)
end
"""
LITERAL = "set_tcp(p[0, 0, 0.15, 0, 0, 0])"
VARIABLE = "grip = p[0, 0, 0.15, 0, 0, 0]\n  set_tcp(grip)"
FUNCTION = "def choose():\n  set_tcp(p[0, 0, 0.15, 0, 0, 0])\nend\n"
TOOL = "[tools.{}.entered]\nposition_mm = [0, 0, {}]\n[tools.{}.real]\nposition_mm = [{}, -0.5, 150.4]\n"
ENTERED = pose((0.0, 0.0, 0.15))
Tool = tuple[str, float, float]  # name, entered length [mm], real x [mm]
GRIPPER: Tool = ("gripper", 150.0, 0.8)


def real_tip(x_mm: float) -> Array:
    return pose((x_mm * 1e-3, -0.0005, 0.1504))


def write_cell(
    folder: Path, model: str, tools: Sequence[Tool], serial: str = "S", more: str = "", base_x: float = 0.3
) -> Project:
    """Return a cell whose arm is nominal; ``base_x`` is where its robot sees the fixture [m]."""
    folder.mkdir(exist_ok=True)
    nominal = load_model(model)
    write_parameters(folder / "robot.toml", nominal, nominal, serial)
    alignment = Alignment(
        fixture="door",
        robot_serial=serial,
        model=nominal.name,
        points_in_fixture_m=tuple(map(tuple, POINTS.tolist())),
        base_fixture=Pose((base_x, 0.0, 0.1)),
        covariance=tuple(map(tuple, (np.eye(6) * 1e-12).tolist())),
    )
    (folder / "door.json").write_text(alignment_text([alignment]), encoding="utf-8")
    head = f'format = 1\n[robot]\nserial = "{serial}"\nmodel = "{model}"\nparameters = "robot.toml"\n'
    texts = [TOOL.format(name, entered, name, real_x) for name, entered, real_x in tools]
    text = head + "".join(texts) + more + '[fixture]\nalignment = "door.json"\n'
    (folder / "project.toml").write_text(text, encoding="utf-8")
    return read_project(folder / "project.toml")


def read_script(setting: str, before: str = "") -> ProgramFile:
    text = SCRIPT.format(setting=setting, before=before)
    return brand_named("universal_robots").read("a.script", text.encode())


def correct_programs(project: Project, *programs: ProgramFile) -> ProgramResult:
    rule = brand_named(programs[0].brand).configurations
    transfer = compensation_transfer(project, ProgramDirection.UPLOAD, rule)
    return transfer.transfer_programs(list(programs))[0]


def assert_told(result: ProgramResult, row: int, correction: Array) -> None:
    """Check that a point became what it was, and then the correction in its own axes."""
    assert result.status[row] == "changed", result.reason[row]
    before, after = (p.positions.frame_tip[row] for p in (result.before, result.after))
    distance_mm, angle_deg = apart(before @ correction, after)
    assert distance_mm < 1e-3
    assert angle_deg < 1e-4


@pytest.mark.parametrize(("setting", "before"), [(LITERAL, ""), (VARIABLE, ""), ("choose()", FUNCTION)])
def test_the_measured_tip_of_a_written_tool_counts(tmp_path: Path, setting: str, before: str) -> None:
    project = write_cell(tmp_path, "ur10e", [GRIPPER, ("camera", 90.0, 3.0)])
    result = correct_programs(project, read_script(setting, before))

    assert_told(result, 1, np.linalg.inv(real_tip(0.8)) @ ENTERED)
    assert not result.findings


def test_the_controller_computes_with_a_tool_as_the_program_rounds_it(tmp_path: Path) -> None:
    project = write_cell(tmp_path, "ur10e", [("gripper", 150.004, 0.8)])

    assert_told(correct_programs(project, read_script(LITERAL)), 1, np.linalg.inv(real_tip(0.8)) @ ENTERED)


def test_two_measured_tools_at_one_written_pose_leave_the_points(tmp_path: Path) -> None:
    project = write_cell(tmp_path, "ur10e", [("left", 150.0, 0.8), ("right", 150.0, 3.0)])
    result = correct_programs(project, read_script(LITERAL))

    assert result.status[1] == "left"
    assert f"left, right of {tmp_path.name}/project.toml" in result.reason[1]


def test_two_tools_that_are_alike_throughout_are_one(tmp_path: Path) -> None:
    project = write_cell(tmp_path, "ur10e", [("left", 150.0, 0.8), ("right", 150.0, 0.8)])

    assert_told(correct_programs(project, read_script(LITERAL)), 1, np.linalg.inv(real_tip(0.8)) @ ENTERED)


def test_a_written_tool_that_the_project_does_not_have_is_said(tmp_path: Path) -> None:
    result = correct_programs(write_cell(tmp_path, "ur10e", [("gripper", 150.1, 0.8)]), read_script(LITERAL))

    assert result.status[1] == "unchanged"
    assert any("no measured tip counts there" in one.text for one in result.findings)
    assert result.exit_code is ExitCode.REFUSED


@pytest.mark.parametrize(
    ("setting", "before"),
    [
        (VARIABLE.replace("\n", "\n  grip[2] = 0.09\n"), ""),
        (VARIABLE.replace("\n", "\n  grip[2] = grip[2] + 0.01\n"), ""),
        (
            "grip = p[0, 0, 0.15, 0, 0, 0]\n  choose(p[0, 0, 0.09, 0, 0, 0])",
            "def choose(grip):\n  set_tcp(grip)\nend\n",
        ),
    ],
)
def test_a_tool_of_which_a_part_is_set_or_that_is_passed_is_not_the_one_declared(
    tmp_path: Path, setting: str, before: str
) -> None:
    result = correct_programs(write_cell(tmp_path, "ur10e", [GRIPPER]), read_script(setting, before))

    assert set(result.status) == {"left"}
    assert result.before.to_bytes() == result.after.to_bytes()


@pytest.mark.parametrize(
    ("clones", "clone_tip"),
    [
        ([("gripper", 150.0, -0.3)], real_tip(-0.3)),
        ([("gripper", 151.0, -0.3)], real_tip(-0.3)),
        ([("gripper", 151.0, -0.3), ("other", 150.0, 3.0)], real_tip(-0.3)),
        ([("greifer", 150.0, -0.3)], real_tip(-0.3)),
        ([("other", 90.0, 3.0)], ENTERED),
        ([], ENTERED),
    ],
)
def test_a_clone_has_its_own_measured_tip_of_the_written_tool(
    tmp_path: Path, clones: Sequence[Tool], clone_tip: Array
) -> None:
    master = write_cell(tmp_path / "a", "ur10e", [GRIPPER], "A")
    clone = write_cell(tmp_path / "b", "ur10e", clones, "B", base_x=0.305)
    (result,) = clone_transfer(master, clone, None).transfer_programs([read_script(LITERAL)])

    before, after = (p.positions.frame_tip[1] for p in (result.before, result.after))
    expected = (
        pose((0.005, 0, 0)) @ before @ np.linalg.inv(ENTERED) @ real_tip(0.8) @ np.linalg.inv(clone_tip)
    )
    assert apart(expected @ ENTERED, after)[0] < 1e-3
    assert any("no measured tip" in one.text for one in result.findings) == (clone_tip is ENTERED)


@pytest.mark.parametrize(("length", "status"), [(150.0, "changed"), (151.0, "left")])
def test_a_saved_waypoint_does_not_set_the_clones_tool(tmp_path: Path, length: float, status: str) -> None:
    """A script's set_tcp is the clone's tool while it runs; a .urp runs with the tool of the clone's installation."""
    master = write_cell(tmp_path / "a", "ur10e", [GRIPPER], "A")
    clone = write_cell(tmp_path / "b", "ur10e", [("gripper", length, -0.3)], "B", base_x=0.305)
    waypoint = _waypoint_xml(tool="0, 0, 0.15, 0, 0, 0")
    program = brand_named("universal_robots").read("lid.urp", _urp_bytes(waypoint))
    arm = program.frames.kinematics
    assert arm is not None
    cells = (replace(cell, controller=arm) for cell in (master, clone))
    (result,) = clone_transfer(*cells, None).transfer_programs([program])

    assert result.status[0] == status, result.reason[0]
    assert ("at another pose" in result.reason[0]) == (status == "left")


# KUKA ------------------------------------------------------------------------------------------------------------------

POINT = "LIN {X 565.551492,Y 95.174559,Z 682.823362,A 164.335957,B 33.774641,C 158.204637,S 2,T 43}\n"
GRIP = "$TOOL={X 0,Y 0,Z 150,A 0,B 0,C 0}\n"
OTHER = "$TOOL={X 0,Y 0,Z 90,A 0,B 0,C 0}\n"


def krl(name: str, *lines: str) -> ProgramFile:
    text = f"DEF {name}()\n$BASE=$NULLFRAME\n{''.join(lines)}END\n"
    return brand_named("kuka").read(f"{name}.src", text.encode())


def read_together(folder: Path, files: Mapping[str, str]) -> Mapping[str, ProgramFile]:
    """Return files with what each says of the others, by name."""
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="ascii")
    sources = find_programs([str(folder)]).sources
    batches = read_batches(sources, lambda _: None, [])
    return {read.program.name: read.program for batch in batches for read in batch}


def test_the_measured_tip_of_a_tool_that_krl_writes_out_counts(tmp_path: Path) -> None:
    project = write_cell(tmp_path, "kuka_kr6_r900", [("3", 150.0, 0.8), ("4", 90.0, 3.0)])
    result = correct_programs(project, krl("A", GRIP, POINT))

    assert_told(result, 0, np.linalg.inv(real_tip(0.8)) @ ENTERED)
    assert not result.findings


def test_each_routine_has_the_tool_that_it_writes_out_and_not_what_holds_where_none_is_said(
    tmp_path: Path,
) -> None:
    more = '[unsaid]\ntool = "3"\n'
    project = write_cell(tmp_path, "kuka_kr6_r900", [("3", 150.0, 0.8), ("4", 90.0, 3.0)], more=more)
    second = krl("B", OTHER, POINT).to_bytes().decode()
    source = krl("A", GRIP, POINT).to_bytes().decode() + second
    result = correct_programs(project, brand_named("kuka").read("A.src", source.encode()))

    assert_told(result, 0, np.linalg.inv(real_tip(0.8)) @ ENTERED)
    assert_told(result, 1, np.linalg.inv(real_tip(3.0)) @ pose((0, 0, 0.09)))


@pytest.mark.parametrize("which", ["TOOL", "BASE"])
def test_what_another_file_writes_out_for_its_caller_is_not_the_callers_own(
    tmp_path: Path, which: str
) -> None:
    """Both wrote numbers, and were taken for the same ones."""
    own, others = (f"${which}={{X 0,Y 0,Z {z},A 0,B 0,C 0}}\n" for z in (150, 90))
    for own_or_not, theirs, barred_count in (("others", others, 1), ("own", own, 0)):
        files = {
            "A.src": f"DEF A()\n$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\n{own}B()\n{POINT}END\n".replace(
                f"${which}=$NULLFRAME\n", ""
            ),
            "B.src": f"DEF B()\n{theirs}END\n",
        }
        assert len(read_together(tmp_path / own_or_not, files)["A"].positions.barred) == barred_count


def test_a_tool_of_another_file_that_the_project_does_not_have_is_said(tmp_path: Path) -> None:
    project = write_cell(tmp_path, "kuka_kr6_r900", [("4", 150.0, 0.8)])
    files = {
        "A.src": f"DEF A()\n$BASE=$NULLFRAME\n$TOOL=TOOL_DATA[3]\n{POINT}END\n",
        "$config.dat": "DEFDAT $CONFIG PUBLIC\nDECL FRAME TOOL_DATA[16]\n"
        "TOOL_DATA[3]={X 0,Y 0,Z 150,A 0,B 0,C 0}\nENDDAT\n",
    }
    result = correct_programs(project, read_together(tmp_path / "in", files)["A"])

    assert result.status[0] == "unchanged"
    assert any(f"tool 3 of A is none of {tmp_path.name}/project.toml" in one.text for one in result.findings)


def test_a_name_in_another_case_is_the_projects_tool(tmp_path: Path) -> None:
    project = write_cell(tmp_path, "abb_irb120", [("tGrip", 150.0, 0.8)])
    text = (
        "MODULE A\nPERS tooldata TGRIP:=[TRUE,[[0,0,150],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
        "CONST robtarget p1:=[[301,21,350],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
        "PROC main()\nMoveL p1,v100,fine,TGRIP;\nENDPROC\nENDMODULE\n"
    )
    result = correct_programs(project, brand_named("abb").read("A.mod", text.encode()))

    assert_told(result, 0, np.linalg.inv(real_tip(0.8)) @ ENTERED)
    assert not result.findings


def test_a_tip_that_was_measured_without_a_turn_has_that_of_the_entered_tool(tmp_path: Path) -> None:
    text = "[tools.gripper.entered]\nposition_mm = [0, 0, 150]\nur_rotation_vector_rad = [0, 0.2, 0]\n"
    text += "[tools.gripper.real]\nposition_mm = [0.8, 0, 150]\n"
    tool = write_cell(tmp_path, "ur10e", [], more=text).tools["gripper"]

    turn = Rotation.from_rotvec([0, 0.2, 0]).as_matrix()
    assert np.allclose(tool.real[:3, :3], turn)
    assert np.allclose(tool.entered[:3, :3], turn)
    assert np.allclose(tool.real[:3, 3], [0.0008, 0, 0.15])
