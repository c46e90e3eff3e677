"""Frames that a program sets so that no axis turns them, in a project that lets a positioner turn them."""

from pathlib import Path

import pytest

from cellcal.drivers.program_registry import brand_named
from cellcal.drivers.programs.cross_file_uses import BatchDeclarations
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.result import LEFT, ProgramResult
from cellcal.service.exit_codes import ExitCode
from tests.programs.external.brands import (
    BRANDS,
    WrittenPoint,
    write_abb,
    write_fanuc,
    write_kuka,
    write_yaskawa,
)
from tests.programs.external.cells import ON_TABLE, HandCell, rail, table
from tests.programs.external.test_rails_and_positioners import CHANGE

DIRECT = ("$BASE=BASE_DATA[2]", "BAS(#BASE,2)")
COUPLED = "$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,BASE_DATA[2])"
SEEN_FROM_TRACK = "$BASE=EK($ERSYSROOT,#EASYS,BASE_DATA[2])"
OBJECT = "[[{x:.6f},{y:.6f},{z:.6f}],[{q[3]:.12f},{q[0]:.12f},{q[1]:.12f},{q[2]:.12f}]]"


def cell_of(brand: str) -> HandCell:
    axis = table(BRANDS[brand])
    return HandCell(BRANDS[brand], (axis,), frame=axis.frame @ ON_TABLE)


def transfer(cell: HandCell, files: dict[str, str], folder: Path) -> list[ProgramResult]:
    brand = brand_named(cell.spelling.brand)
    read = [brand.read(name, text.encode()) for name, text in files.items()]
    across = BatchDeclarations({name: one.declarations for name, one in zip(files, read, strict=True)})  # type: ignore[attr-defined]
    read = [
        one.with_external_uses(across.uses_of_file(name))  # type: ignore[attr-defined]
        for name, one in zip(files, read, strict=True)
    ]
    change = move_transfer(cell.project(folder), CHANGE, brand.configurations, joints="move")
    return list(change.transfer_programs(read))


def krl_poses(points: list[WrittenPoint]) -> list[str]:
    text = write_kuka(points, "2")
    return [line.partition("=")[2] for line in text.splitlines() if line.startswith("DECL E6POS")]


def krl_source(*lines: str) -> str:
    return "\n".join(["DEF WELD()", "BAS(#TOOL,1)", *lines, "END", ""])


@pytest.mark.parametrize("coupled", [COUPLED, SEEN_FROM_TRACK])
@pytest.mark.parametrize("direct", DIRECT)
def test_moves_in_a_base_set_from_the_table_are_left(direct: str, coupled: str, tmp_path: Path) -> None:
    """And those of the same program in the same base as EK() are moved."""
    cell = cell_of("kuka")
    one, two, three, *_ = krl_poses(cell.points([{"E2": 40.0}]))
    text = krl_source(coupled, f"LIN {one}", direct, f"LIN {two}", coupled, f"LIN {three}")
    (result,) = transfer(cell, {"weld.src": text}, tmp_path)
    assert [status == LEFT for status in result.status] == [False, True, False]
    assert "that no axis turns" in result.reason[1]
    assert "table turns it" in result.reason[1]


def test_points_of_a_list_are_left_where_any_program_sets_their_base_so(tmp_path: Path) -> None:
    cell = cell_of("kuka")
    taught = write_kuka(cell.points([{"E2": 40.0}]), "2")
    alone = "\n".join(line for line in taught.splitlines() if "FDAT" not in line).replace("XP", "XQ")
    inline = ["$BWDSTART=FALSE", "PDAT_ACT=PPDAT1", "FDAT_ACT=FP1", "BAS(#PTP_PARAMS,100)", "PTP XP1"]
    files = {
        "rail.dat": taught,
        "rail.src": krl_source(*inline, DIRECT[0], "LIN XP2").replace("WELD", "RAIL"),
        "weld.dat": alone.replace("RAIL", "WELD"),
        "weld.src": krl_source(COUPLED, "LIN XQ1", "LIN XQ2", DIRECT[0], "LIN XQ2", "LIN XQ3"),
    }
    by_file = dict(zip(files, transfer(cell, files, tmp_path), strict=True))
    assert [status == LEFT for status in by_file["rail.dat"].status] == [False, True, False, False, False]
    assert [status == LEFT for status in by_file["weld.dat"].status][:3] == [False, True, True]


def test_a_work_object_that_no_unit_moves_is_not_turned(tmp_path: Path) -> None:
    cell = cell_of("abb")
    axis = cell.axes[0]
    points = cell.points([{axis.axis: 40.0}])
    for has_unit, left in (("FALSE", False), ("TRUE", True)):
        (x, y, z), turn = ON_TABLE[:3, 3] * 1e3, [0.0, 0.0, 0.14943813247, 0.98877107794]
        on_table = OBJECT.format(x=x, y=y, z=z, q=turn)
        work = f'PERS wobjdata wTab:=[FALSE,{has_unit},"STN1",[[0,0,0],[1,0,0,0]],{on_table}];'
        text = write_abb(points, "wTab", declarations=(work,))
        (result,) = transfer(cell, {"rail.mod": text}, tmp_path / has_unit)
        assert {status == LEFT for status in result.status} == {left}


def test_a_base_correction_that_is_switched_on_is_a_finding(tmp_path: Path) -> None:
    cell = HandCell(BRANDS["kuka"], ())
    (pose, *_) = krl_poses(cell.points([{}]))
    for corrected, code in (("TRUE", ExitCode.REFUSED), ("FALSE", ExitCode.PASS)):
        text = krl_source(f"BASE_CORR_ON={corrected}", DIRECT[1], f"LIN {pose}")
        (result,) = transfer(cell, {"weld.src": text}, tmp_path / corrected)
        assert result.exit_code is code


@pytest.mark.parametrize("joints", [False, True])
def test_stars_of_an_extended_axis_leave_that_point_alone(joints: bool, tmp_path: Path) -> None:
    cell = HandCell(BRANDS["fanuc"], (rail(BRANDS["fanuc"]),))
    text = write_fanuc(cell.points([{"E1": 125.0}], joints=joints), "2")
    text = text.replace("E1= 125.000000 mm", "E1= ******** mm", 1)
    program = brand_named("fanuc").read("rail.ls", text.encode())
    result = move_transfer(
        cell.project(tmp_path), CHANGE, brand_named("fanuc").configurations, joints="move"
    ).transfer_programs([program])[0]
    assert [status == LEFT for status in result.status] == [True, False, False, False, False]


def test_the_mark_that_dos_put_behind_a_text_cuts_no_job_short() -> None:
    cell = HandCell(BRANDS["yaskawa"], ())
    data = write_yaskawa(cell.points([{}]), "2").encode() + b"\x1a"
    program = brand_named("yaskawa").read("rail.jbi", data)
    assert len(program.positions) == 5
    assert program.to_bytes() == data
