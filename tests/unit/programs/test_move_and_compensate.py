"""Work that was moved, and programs corrected for their own robot: judged by where the real robot then stands."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.compensation.compensate import ProgramDirection
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Pose, exp_twist, homogeneous_matrix, inverse_transform, log_rotation
from cellcal.calibration.orientation import values_from
from cellcal.drivers.abb.program_files.programs import BRAND as ABB_BRAND
from cellcal.drivers.fanuc.program_files.ls_program import read_ls
from cellcal.drivers.fanuc.program_files.programs import BRAND
from cellcal.drivers.programs.positions import CARTESIAN
from cellcal.drivers.universal_robots.program_files.script_program import read_script
from cellcal.service.engineering.programs.clone import clone_transfer
from cellcal.service.engineering.programs.compensate import compensation_transfer
from cellcal.service.engineering.programs.joint_points import UNDECIDED, JointPoints
from cellcal.service.engineering.programs.move import change_of_frame, move_transfer, redefined_frame
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.project_poses import ProjectError
from cellcal.service.engineering.programs.reach import reach_of
from tests.unit.helpers.cloned_cells import ENTERED_TOOL, fanuc_listing
from tests.unit.helpers.cloned_program import ClonedCells

RULE = BRAND.configurations
OFFSET = exp_twist(np.array([0.06, -0.04, 0.03, 0.02, -0.03, 0.15]))


@pytest.fixture(scope="module")
def cloned_cells(tmp_path_factory: pytest.TempPathFactory) -> ClonedCells:
    return ClonedCells.make(8, tmp_path_factory.mktemp("cells"))


def test_moved_points_keep_their_place_at_the_moved_work(cloned_cells: ClonedCells) -> None:
    master, project = cloned_cells.master, cloned_cells.master_project
    change = change_of_frame(master.base_frame, OFFSET)

    result = move_transfer(project, change, RULE).transfer_programs([cloned_cells.program])[0]

    joints = master.commanded_joints(result.after.positions.frame_tip, cloned_cells.joints)
    before = master.true_flanges(cloned_cells.joints) @ master.flange_tool
    after = master.true_flanges(joints) @ master.flange_tool
    missed = np.linalg.norm((change @ before - after)[:, :3, 3], axis=1)
    assert result.is_complete
    assert missed.max() < 0.3e-3
    assert (missed <= result.expected_error_m).mean() > 0.9
    assert result.shift_m.min() > 0.02


def test_without_parameters_a_move_is_eq_7(cloned_cells: ClonedCells) -> None:
    plain = replace(cloned_cells.master_project, identified=None)
    tools = {"1": replace(plain.tools["1"], real=plain.tools["1"].entered, measured=False)}
    change = change_of_frame(cloned_cells.master.base_frame, OFFSET)

    result = move_transfer(replace(plain, tools=tools), change, RULE).transfer_programs(
        [cloned_cells.program]
    )[0]

    before, after = result.before.positions, result.after.positions
    assert np.abs(after.frame_tip - OFFSET @ before.frame_tip)[:, :3, 3].max() < 1e-6
    assert result.uncorrected_m.max() < 1e-6
    assert np.isnan(result.expected_error_m).all()


def test_only_points_of_the_named_frame_move(cloned_cells: ClonedCells) -> None:
    text = cloned_cells.program.to_bytes().replace(b"UF : 1,", b"UF : 2,", 5)
    project = replace(
        cloned_cells.master_project,
        frames={**cloned_cells.master_project.frames, "2": cloned_cells.master.base_frame},
    )
    change = change_of_frame(cloned_cells.master.base_frame, OFFSET)

    result = move_transfer(project, change, RULE, frame="2").transfer_programs([read_ls("A.LS", text)])[0]

    assert result.status == ("changed",) * 5 + ("unchanged",) * 35
    assert result.is_complete
    assert result.after.to_bytes().splitlines()[-200:] == text.splitlines()[-200:]


def test_a_frame_may_be_entered_anew_instead(cloned_cells: ClonedCells) -> None:
    change = change_of_frame(cloned_cells.master.base_frame, OFFSET)

    pose, words = redefined_frame(cloned_cells.master_project, "1", change)

    assert np.abs(pose - cloned_cells.master.base_frame @ OFFSET).max() < 1e-9
    x, y, z = pose[:3, 3] * 1e3
    w, p, r = np.degrees(values_from("fanuc_wpr", pose[:3, :3]))
    assert words == f"user frame 1 at X {x:.3f}, Y {y:.3f}, Z {z:.3f} mm, W {w:.4f}, P {p:.4f}, R {r:.4f} deg"
    with pytest.raises(ProjectError, match="no user frame 5"):
        redefined_frame(cloned_cells.master_project, "5", change)
    with pytest.raises(CalibrationError, match="rigid"):
        move_transfer(cloned_cells.master_project, 2.0 * np.eye(4), RULE)


def test_compensated_points_stand_where_the_program_says(cloned_cells: ClonedCells) -> None:
    master = cloned_cells.master
    frame_tip = master.recorded_tips(cloned_cells.joints)

    result = compensation_transfer(
        cloned_cells.master_project, ProgramDirection.UPLOAD, RULE
    ).transfer_programs([cloned_cells.program])[0]

    joints = master.commanded_joints(result.after.positions.frame_tip, cloned_cells.joints)
    # The base of the world is the drawing's; that of the calibration differs by what its fit put into the base.
    real = _fit_transform(master.true_flanges(joints) @ master.flange_tool, master.base_frame @ frame_tip)
    plain = _fit_transform(
        master.true_flanges(cloned_cells.joints) @ master.flange_tool, master.base_frame @ frame_tip
    )
    assert result.is_complete
    assert real.mean() < 0.15e-3
    assert plain.mean() > 2 * real.mean()


def test_upload_and_download_are_each_others_way_back(cloned_cells: ClonedCells) -> None:
    up = compensation_transfer(cloned_cells.master_project, ProgramDirection.UPLOAD, RULE).transfer_programs(
        [cloned_cells.program]
    )[0]
    down = compensation_transfer(
        cloned_cells.master_project, ProgramDirection.DOWNLOAD, RULE
    ).transfer_programs([up.after])[0]

    apart = down.after.positions.frame_tip[:, :3, 3] - cloned_cells.program.positions.frame_tip[:, :3, 3]
    assert np.abs(up.shift_m).min() > 1e-4
    assert np.abs(apart).max() < 3e-6


def test_compensation_asks_for_parameters(cloned_cells: ClonedCells) -> None:
    with pytest.raises(ProjectError, match="no parameters"):
        compensation_transfer(
            replace(cloned_cells.master_project, identified=None), ProgramDirection.UPLOAD, RULE
        )


def test_points_of_the_wrong_configuration_are_named(cloned_cells: ClonedCells) -> None:
    frame_tip = cloned_cells.master.recorded_tips(cloned_cells.joints)
    text = fanuc_listing("A", frame_tip, cloned_cells.joints)
    first = RULE.write_configurations(
        cloned_cells.master_project.controller, cloned_cells.joints[:1], ["N U T, 0, 0, 0"]
    )[0]
    wrong = text.replace(first.encode(), first.replace("T", "B").encode(), 1)

    result = compensation_transfer(
        cloned_cells.master_project, ProgramDirection.UPLOAD, RULE
    ).transfer_programs([read_ls("A.LS", wrong)])[0]

    assert result.reason[0].startswith("no posture of the arm reaches this pose with the configuration")
    assert set(result.status[1:]) == {"changed"}


@pytest.mark.parametrize("way", ["cloned", "compensated", "moved"])
def test_no_way_changes_an_increment(cloned_cells: ClonedCells, way: str) -> None:
    old = cloned_cells.program.to_bytes()
    data = old.replace(b"L P[2] 250mm/sec FINE ", b"L P[2] 250mm/sec FINE INC ")
    assert data != old
    program = read_ls("A.LS", data)
    carriers = {
        "cloned": lambda: clone_transfer(cloned_cells.master_project, cloned_cells.clone_project, RULE),
        "compensated": lambda: compensation_transfer(
            cloned_cells.master_project, ProgramDirection.UPLOAD, RULE
        ),
        "moved": lambda: move_transfer(cloned_cells.master_project, OFFSET, RULE),
    }

    result = carriers[way]().transfer_programs([program])[0]

    assert result.status[1] == "left"
    assert "increment" in result.reason[1]
    assert np.array_equal(result.after.positions.frame_tip[1], program.positions.frame_tip[1])
    assert "changed" in result.status


def _fit_transform(poses: np.ndarray, target_poses: np.ndarray) -> np.ndarray:
    a, b = poses[:, :3, 3], target_poses[:, :3, 3]
    u, _, vt = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt).T
    return np.linalg.norm((a - a.mean(axis=0)) @ turn.T - (b - b.mean(axis=0)), axis=1)


def test_the_tool_as_entered_is_what_positions_are_written_in(cloned_cells: ClonedCells) -> None:
    result = compensation_transfer(
        cloned_cells.master_project, ProgramDirection.UPLOAD, RULE
    ).transfer_programs([cloned_cells.program])[0]

    flange = result.base_tip_after @ inverse_transform(ENTERED_TOOL)
    joints = cloned_cells.master.commanded_joints(result.after.positions.frame_tip, cloned_cells.joints)
    assert np.abs(cloned_cells.master.arm.believed_flange(joints) - flange).max() < 5e-5


ABB = """MODULE Teil
PERS wobjdata wTable:=[FALSE,TRUE,"",[[300,50,100],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
PERS tooldata tGrip:=[TRUE,[[0,0,80],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
CONST robtarget p1:=[[100,0,300],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
PROC main()
MoveL p1,v100,fine,tGrip\\WObj:=wTable;
ENDPROC
ENDMODULE
"""
PROJECT = """format = 1
name = "cell"
[robot]
serial = "S"
model = "abb_irb120"
[unsaid]
tool = "tGrip"
frame = "wTable"
[tools.tGrip.entered]
position_mm = [0, 0, 80]
abb_quaternion = [1, 0, 0, 0]
[frames.wTable]
position_mm = [300, 50, 100]
abb_quaternion = [1, 0, 0, 0]
"""


@pytest.mark.parametrize(
    ("old", "new", "project_old", "project_new", "words"),
    [
        ("", "", "", "", ""),
        ("[[300,50,100]", "[[300,50,101]", "", "", "its own user frame wTable, 1.00 mm and 0.00 deg"),
        ("", "", "[0, 0, 80]", "[0, 0, 79.9]", "its own tool tGrip, 0.10 mm"),
        ("tGrip\\WObj", "tGrips{1}\\WObj", "", "", "computed"),
        ("ENDPROC", "MoveL p1,v100,fine,tGrip;\nENDPROC", "", "", "different"),
    ],
)
def test_a_frame_that_is_not_one_in_program_and_cell_leaves_its_points(
    tmp_path: Path, old: str, new: str, project_old: str, project_new: str, words: str
) -> None:
    file = tmp_path / "project.toml"
    file.write_text(PROJECT.replace(project_old, project_new), encoding="utf-8")
    project, program = read_project(file), ABB_BRAND.read("a.mod", ABB.replace(old, new).encode())

    result = move_transfer(
        project, homogeneous_matrix(np.eye(3), np.array([0.01, 0, 0])), ABB_BRAND.configurations
    ).transfer_programs([program])[0]
    reach = reach_of([program], project)[0]

    assert result.status == (("left",) if words else ("changed",))
    assert words in result.reason[0]
    assert words in reach.why[0]
    assert bool(reach.why[0]) == bool(words)


def test_a_quadrant_that_an_axis_leaves_is_written_anew_and_is_no_other_posture(tmp_path: Path) -> None:
    file = tmp_path / "project.toml"
    file.write_text(PROJECT, encoding="utf-8")
    program = ABB_BRAND.read("a.mod", ABB.encode())
    shift = homogeneous_matrix(np.eye(3), np.array([0, -0.1, 0]))

    result = move_transfer(read_project(file), shift, ABB_BRAND.configurations).transfer_programs([program])[
        0
    ]

    assert (result.status, result.reason) == (("changed",), ("",))
    assert program.positions.configurations == ("[0,0,0,0]",)
    assert result.after.positions.configurations == ("[-1,0,-1,0]",)
    assert any("project.toml names no parameters of S" in warning for warning in result.warnings)


def test_a_pose_without_a_configuration_is_taken_near_the_posture_that_is_taught_before_it(
    tmp_path: Path,
) -> None:
    arm = load_model("ur10e")
    near = np.array([[0.2, -1.3, 1.5, -1.4, -1.5, 0.5], [2.5, -1.7, -1.5, -1.4, 1.5, 0.5]])
    there = near + 0.05
    tip = [Pose.from_matrix(pose) for pose in arm.base_flange(np.vstack([near, there]))]
    vectors = log_rotation(np.array([pose.rotation_matrix() for pose in tip]))
    texts = [",".join(f"{x:.9f}" for x in (*p.position_m, *v)) for p, v in zip(tip, vectors, strict=True)]
    lines = [
        line
        for k in (0, 1)
        for line in (f"movej([{','.join(map(str, near[k].tolist()))}])", f"movel(p[{texts[2 + k]}])")
    ]
    text = "\n".join(["def a():", "set_tcp(p[0,0,0,0,0,0])", *lines, "end", ""])
    file = tmp_path / "project.toml"
    file.write_text('format = 1\nname = "u"\n[robot]\nserial = "S"\nmodel = "ur10e"\n', encoding="utf-8")
    shift = homogeneous_matrix(np.eye(3), np.array([0.01, 0, 0]))
    program = read_script("a.script", text.encode())

    result = move_transfer(read_project(file), shift, None, joints="move").transfer_programs([program])[0]

    assert result.status == ("changed",) * 4, result.reason
    moved = result.after.positions
    assert np.abs(moved.frame_tip[[1, 3]] - shift @ program.positions.frame_tip[[1, 3]]).max() < 2e-8


WITH_A_HOME = """MODULE M
PERS tooldata tGrip:=[TRUE,[[0,0,80],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
PERS wobjdata wTable:=[FALSE,TRUE,"",[[300,50,100],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
CONST jointtarget jHome:=[[0,-20,20,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget p1:=[[100,50,200],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
PROC main()
MoveAbsJ jHome,v1000,fine,tGrip;
MoveL p1,v100,fine,tGrip\\WObj:=wTable;
ENDPROC
ENDMODULE
"""


@pytest.mark.parametrize(
    ("joints", "status"),
    [(None, {"left", "changed"}), ("keep", {"unchanged", "changed"}), ("move", {"changed"})],
)
def test_joint_angles_without_a_frame_move_or_stay_as_requested(
    tmp_path: Path, joints: JointPoints | None, status: set[str]
) -> None:
    file = tmp_path / "project.toml"
    file.write_text(PROJECT, encoding="utf-8")
    program = ABB_BRAND.read("a.mod", WITH_A_HOME.encode())
    shift = homogeneous_matrix(np.eye(3), np.array([0.01, 0, 0]))
    at_home = [kind == CARTESIAN for kind in program.positions.kinds].index(False)

    result = move_transfer(
        read_project(file), shift, ABB_BRAND.configurations, joints=joints
    ).transfer_programs([program])[0]

    assert set(result.status) == status, result.reason
    assert result.reason[at_home] == (UNDECIDED if joints is None else "")
    line = "CONST jointtarget jHome:=[[0,-20,20,0,30,0],"
    assert (line in result.after.to_bytes().decode()) == (joints != "move")
    if joints == "move":
        arm = load_model("abb_irb120")
        before, after = (arm.base_flange(p.positions.joints[[at_home], :6]) for p in (program, result.after))
        assert np.abs(shift @ before - after)[:, :3, 3].max() < 1e-5
