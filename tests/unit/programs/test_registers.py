"""Position registers of a FANUC's backup: reported, and carried with the programs where they are places."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.drivers.fanuc.program_files.ls_program import read_ls
from cellcal.drivers.fanuc.program_files.ls_registers import UNSURE, registers_used
from cellcal.drivers.fanuc.program_files.programs import BRAND
from cellcal.drivers.fanuc.program_files.va_backup import read_backup
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.project import Project, read_project
from cellcal.service.engineering.programs.project_poses import ProjectError
from cellcal.service.engineering.programs.registers import ProgramRegisters
from tests.unit.helpers.fanuc_va import VariablesController

_PROJECT = """format = 1
name = "cell"
programs = ["*.ls"]
[robot]
serial = "E-1"
model = "fanuc_m6ib"
backup = "saved"
"""
_PLACE = "X:   700.000   Y:   100.000   Z:   300.000"
_ANGLES = "W:   180.000   P:      .000   R:    30.000"


def _listing_bytes(*lines: str) -> bytes:
    statements = "".join(f"{i:4d}:{line} ;\n" for i, line in enumerate(lines, 1))
    return f"/PROG  WELD\n/ATTR\n/MN\n{statements}/POS\n/END\n".encode()


def _cell_with_registers(folder: Path, *lines: str) -> tuple[Project, list]:
    """Return a cell whose PR[1] holds joints and PR[2] a pose in reach, and a program of these lines."""
    saved = VariablesController().save_variables(folder / "saved") / "POSREG.VA"
    text = saved.read_bytes().decode("cp437")
    before, _, rest = text.partition("X:")
    _, _, rest = rest.partition("R:")
    ending = rest.partition("\r\n")[2]
    before = before.replace("N D B", "N U T")
    saved.write_bytes(f"{before}{_PLACE}\r\n{_ANGLES}\r\n{ending}".encode("cp437"))
    (folder / "project.toml").write_text(_PROJECT)
    (folder / "WELD.ls").write_bytes(_listing_bytes(*lines))
    return read_project(folder / "project.toml"), [read_ls("WELD.LS", _listing_bytes(*lines))]


_GOES = ("  UFRAME_NUM=0", "  UTOOL_NUM=0", "J PR[1:Home] 50% FINE", "L PR[2] 100mm/sec FINE")


def test_registers_that_programs_use_are_reported_with_their_values(tmp_path: Path) -> None:
    cell, programs = _cell_with_registers(
        tmp_path, *_GOES, "L P[1] 100mm/sec FINE Offset,PR[4]", "J PR[3] 50% FINE"
    )

    register_texts = [str(register) for register in ProgramRegisters(programs, cell).all]

    assert register_texts[0].startswith("PR[1] 'Höhe': J1 45.000 deg, J2 -45.000 deg")
    assert "used in WELD line 6" in register_texts[0]
    assert "X 700.000 mm, Y 100.000 mm, Z 300.000 mm, W 180.000 deg" in register_texts[1]
    assert "it stays: the backup holds no position in it" in register_texts[2]
    assert "it stays: WELD line 8 does more than go there" in register_texts[3]


def test_places_move_with_the_work_and_nothing_else_in_the_file_changes(tmp_path: Path) -> None:
    cell, programs = _cell_with_registers(tmp_path, *_GOES)
    shift = homogeneous_matrix(np.eye(3), np.array([0.012, 0.0, -0.0035]))
    found = ProgramRegisters(programs, cell)

    assert found.transfer_registers(
        move_transfer(cell, shift, BRAND.configurations), cell
    ).result.excluded_points  # a register in joint angles
    carried = found.transfer_registers(move_transfer(cell, shift, BRAND.configurations, joints="move"), cell)

    assert carried.result.is_complete, carried.result.excluded_points
    poses = cell.controller.base_flange(np.array([found.places.positions.joints[0]]))
    (tmp_path / "saved" / "POSREG.VA").write_bytes(carried.file or b"")
    after = read_backup(tmp_path / "saved")
    moved = after.registers[1, 2].to_pose()
    assert moved is not None
    assert moved.position_m == pytest.approx((0.712, 0.1, 0.2965), abs=1e-9)
    turned = cell.controller.base_flange(np.array([after.registers[1, 1].to_joints()]))
    assert turned[0, :3, 3] == pytest.approx((shift @ poses[0])[:3, 3], abs=5e-5)
    variables = {edit.variable for edit in carried.edits}
    assert {"$POSREG[1,2].X", "$POSREG[1,2].Z"} <= variables
    assert not {"$POSREG[1,2].Y", "$POSREG[1,2].W"} & variables
    before = found.places.to_bytes().split(b"\r\n")
    changed = [i for i, line in enumerate((carried.file or b"").split(b"\r\n")) if line != before[i]]
    spots = {edit.spot.line - 1 for edit in carried.edits}
    assert set(changed) == spots


@pytest.mark.parametrize(
    ("lines", "uses"),
    [
        (("UFRAME_NUM=2", "J PR[1] 50% FINE"), [(1, True, "2", None)]),
        (
            ("PR[1]=LPOS", "!J PR[2] 50% FINE", "PR[3,2]=R[1]"),
            [(1, False, None, None), (3, False, None, None)],
        ),
        (("L PR[5:via] 50mm/sec FINE Tool_Offset,PR[6]",), [(5, False, None, None), (6, False, None, None)]),
        (
            ("UFRAME_NUM=1", "IF R[1]=1,JMP LBL[1]", "UFRAME_NUM=2", "LBL[1]", "J PR[1] 9% FINE"),
            [(1, True, UNSURE, None)],
        ),
        (("UTOOL_NUM=R[1]", "J PR[1] 9% FINE"), [(1, True, None, UNSURE)]),
        (("UTOOL_NUM=3", "CALL GRIP", "C PR[7] 9mm/sec FINE"), [(7, True, None, "3")]),
    ],
)
def test_what_a_register_is_used_for(lines: tuple[str, ...], uses: list) -> None:
    found = registers_used(_listing_bytes(*lines))
    assert [(u.number, u.goes_there, u.user_frame, u.tool) for u in found] == uses


_RECORD = b"P[1]{\n   GP1:\n\tUF : 2, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n%s};\n" % (
    b"\tX = 300.000  mm,\tY = 0.000  mm,\tZ = 300.000  mm,\n\tW = 180.000 deg,\tP = 0.000 deg,\tR = 0.000 deg\n"
)
_TO_5 = "L PR[5] 9mm/sec FINE"


@pytest.mark.parametrize(
    ("lines", "frames"),
    [
        (("UFRAME_NUM=1", "CALL GRIP", "UFRAME_NUM=2", _TO_5), ["2"]),
        (("UFRAME_NUM=1", "CALL GRIP", _TO_5, "UFRAME_NUM=2", _TO_5), [UNSURE, "2"]),
        (("UFRAME_NUM=1", "UFRAME_NUM=2", "GRIPPER OPEN", _TO_5, "L P[1] 9mm/sec FINE", _TO_5), [UNSURE, "2"]),
        (("IF (R[1]=1) THEN", "UFRAME_NUM=1", "ELSE", "UFRAME_NUM=2", _TO_5, "ENDIF", _TO_5), ["2", UNSURE]),
        (("UFRAME_NUM=1", "LBL[1]", _TO_5, "UFRAME_NUM=2", _TO_5, "JMP LBL[1]"), [UNSURE, "2"]),
        (("UFRAME_NUM=1", "FOR R[1]=1 TO 2", _TO_5, "UFRAME_NUM=2", "ENDFOR", _TO_5), [UNSURE, UNSURE]),
        (("UFRAME_NUM=1", "SELECT R[1]=1,JMP LBL[2]", "       =2,CALL A", "UFRAME_NUM=2", "LBL[2]", _TO_5),
         [UNSURE]),
        (("UFRAME_NUM=1", "IF (PR[1,3]>5),UFRAME_NUM=2", _TO_5), ["1", UNSURE]),
        (("UFRAME_NUM=1", "END", "LBL[9]", "UFRAME_NUM=2", _TO_5), ["2"]),
        (("UFRAME_NUM=2", "UFRAME_NUM=1", "C PR[5]    ", "  :  PR[6] 9mm/sec FINE", ), ["1", "1"]),
    ],
)  # fmt: skip
def test_the_frame_of_a_register_is_followed_along_the_ways_of_the_program(
    lines: tuple[str, ...], frames: list
) -> None:
    data = _listing_bytes(*lines).replace(b"/POS\n", b"/POS\n" + _RECORD)

    found = registers_used(data, read_ls("WELD.LS", data).positions)

    assert [use.user_frame for use in found] == frames


def test_a_project_without_a_backup_says_what_is_missing(tmp_path: Path) -> None:
    cell, programs = _cell_with_registers(tmp_path, *_GOES)
    with pytest.raises(ProjectError, match="no backup of the controller"):
        ProgramRegisters(programs, replace(cell, backup=None))


def test_the_command_prints_what_to_type_and_writes_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _cell_with_registers(tmp_path, *_GOES, "J PR[3] 50% FINE")
    project, out = str(tmp_path / "project.toml"), str(tmp_path / "new")

    code = run_command_line(
        ["program", "registers", "--project", project, "--offset=12,0,-3.5", "--out", out]
    )

    output = capsys.readouterr().out
    assert code == 4  # PR[3] holds nothing
    assert "$POSREG[1,2].X from 700.000 mm to 712.000 mm" in output
    assert b"712.000" in (tmp_path / "new" / "POSREG.VA").read_bytes()


@pytest.mark.parametrize(
    ("weld", "deep", "stays"),
    [
        (("UFRAME_NUM=0", "UTOOL_NUM=0", "CALL DEEP", "L PR[2] 100mm/sec FINE"), ("UFRAME_NUM=3",), True),
        (("UFRAME_NUM=0", "UTOOL_NUM=0", "CALL DEEP", "L PR[2] 100mm/sec FINE"), ("UFRAME_NUM=0",), False),
        (("UFRAME_NUM=0", "UTOOL_NUM=0", "CALL DEEP"), ("L PR[2] 100mm/sec FINE",), False),
        (
            ("UFRAME_NUM=0", "UTOOL_NUM=0", "CALL DEEP", "UFRAME_NUM=3", "CALL DEEP"),
            ("L PR[2] 9mm/sec FINE",),
            True,
        ),
    ],
)
def test_a_register_is_in_the_frame_that_other_programs_choose(
    weld: tuple[str, ...],
    deep: tuple[str, ...],
    stays: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _cell_with_registers(tmp_path, *weld)
    (tmp_path / "DEEP.ls").write_bytes(_listing_bytes(*deep).replace(b"WELD", b"DEEP"))
    code = run_command_line(
        ["program", "registers", "--project", str(tmp_path / "project.toml"), "--offset=12,0,-3.5"]
    )
    output = capsys.readouterr().out
    assert ("which is not sure" in output) is stays
    assert ("$POSREG[1,2].X from 700.000 mm to 712.000 mm" in output) is not stays
    assert code == (4 if stays else 0)
