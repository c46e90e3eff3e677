"""What instructions of Yaskawa jobs do to positions: increments, shifts, led motions, frames made at run time."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.drivers.programs.cross_file_uses import BatchDeclarations
from cellcal.drivers.programs.shifts import ShiftAxes
from cellcal.drivers.yaskawa.program_files.job_calls import declarations_of
from cellcal.drivers.yaskawa.program_files.job_program import read_job
from cellcal.drivers.yaskawa.program_files.programs import BRAND, read
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.engineering.programs.result import ProgramResult
from cellcal.service.exit_codes import ExitCode
from tests.programs.jobs_to_move import PROJECT

HEAD = """/JOB
//NAME A
//POS
///NPOS 2,0,0,3,0,0
///TOOL 0
///USER 2
///POSTYPE USER
///RECTAN
///RCONF 0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0
C00000=50.000,0.000,200.000,180.0000,0.0000,0.0000
C00001=0.000,40.000,180.000,180.0000,0.0000,0.0000
P00000=10.000,0.000,-50.000,0.0000,0.0000,0.0000
P00001=20.000,30.000,190.000,180.0000,0.0000,0.0000
///POSTYPE TOOL
P00002=0.000,0.000,-30.000,0.0000,0.0000,0.0000
//INST
///DATE 2020/04/25 14:11
///ATTR SC,RW
///GROUP1 RB1
NOP
"""
NAMES = ("C00000", "C00001", "P00000", "P00001", "P00002")


def job_bytes(*lines: str) -> bytes:
    """Return a job of two taught positions and three variables."""
    return (HEAD + "\n".join([*lines, "END", ""])).encode("ascii")


def move_job(
    data: bytes, tmp_path: Path, *, turn: bool = True, about: tuple[float, float] = (0.0, 0.0)
) -> ProgramResult:
    """Return a job whose work moves, by a turn about an upright axis and a step."""
    file = tmp_path / "project.toml"
    file.write_text(PROJECT, encoding="utf-8")
    angle = np.radians(20.0) if turn else 0.0
    c, s = np.cos(angle), np.sin(angle)
    upright, place = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), np.array([*about, 0.0])
    change = homogeneous_matrix(upright, place - upright @ place + np.array([0.02, -0.02, 0.005]))
    return move_transfer(read_project(file), change, BRAND.configurations).transfer_programs(
        [BRAND.read("a.jbi", data)]
    )[0]


def left_variables(result: ProgramResult) -> set[str]:
    """Return what is left beside the variables that no line goes to."""
    return {name for name, _ in result.excluded_points}


@pytest.mark.parametrize(
    ("line", "name", "word"),
    [
        ("IMOV P000 V=50.0 RF", "P00000", "increment"),
        ("IMOV P000 V=50.0 UF#(2) ACC=50", "P00000", "increment"),
        ("SMOVL C00001 V=50.0 +MOVL EC00001", "C00001", "leads"),
        ("SYMOVL C00001 V=50.0 CV#(1) CTP=0.250", "C00001", "conveyor"),
        ("EMOVL C00001 V=50.0 UF#(2)", "C00001", "does not state"),
        ("MOVL P002 V=50.0", "P00002", "axes of the tool"),
        ("IMOV P[I001] V=50.0 RF", "P00001", "register chooses"),
        ("ADD P[I001] P000", "P00001", "register chooses"),
    ],
)
def test_what_is_no_place_is_left_and_named(line: str, name: str, word: str, tmp_path: Path) -> None:
    data = job_bytes("MOVJ C00000 VJ=5.00", "MOVL P001 V=50.0", line)

    result = move_job(data, tmp_path)

    assert word in dict(result.excluded_points)[name]
    assert "C00000" not in left_variables(result)
    assert result.exit_code is ExitCode.REFUSED
    row = HEAD[HEAD.index(f"{name}=") :].partition("\n")[0]
    assert row in result.after.to_bytes().decode()


@pytest.mark.parametrize(
    ("lines", "found"),
    [
        (("SFTON P050 BF", "MOVL C00000 V=1.0", "SFTOF", "MOVL C00001 V=1.0"), {"C00000"}),
        (("SFTON P050 UF#(2)", "MOVL C00000 V=1.0", "MOVL P001 V=1.0"), {"C00000", "P00001"}),
        (("SFTON P050 TF", "MOVL C00000 V=1.0"), set()),
        (("'SFTON P050 BF", "COMM SFTON P050 BF", "MOVL C00000 V=1.0"), set()),
        (("*A", "MOVL C00000 V=1.0", "SFTON P050 BF", "JUMP *A IF B000=1"), {"C00000", "P00001"}),
        (("SFTON P050 BF", "CALL JOB:SUB", "SFTOF"), {"what other jobs go to while it holds"}),
        (("SFTON P050 BF", "SFTOF", "CALL JOB:SUB"), set()),
        (("MOVL C00000 V=1.0", "IMOV P050 V=1.0 BF"), {"P050"}),
        (("MOVL C00000 V=1.0", "IMOV LP050 V=1.0 RF"), {"LP050"}),
        (("MOVL C00000 V=1.0", "IMOV P050 V=1.0 TF"), set()),
        (("GETS PX050 $PX001", "ADD P050 P051", "MOVL P050 V=1.0"), {"P050"}),
        (("GETS PX050 $PX001", "MOVL C00000 V=1.0", "MOVL P050 V=1.0"), set()),
    ],
)
def test_shifts_are_findings_where_the_work_turns(
    lines: tuple[str, ...], found: set[str], tmp_path: Path
) -> None:
    result = move_job(job_bytes("MOVL P001 V=1.0", *lines), tmp_path)

    assert {finding.point for finding in result.findings} == found
    for finding in result.findings:
        assert np.degrees(finding.angle_rad) == pytest.approx(20.0)
    filled = () if "GETS PX050 $PX001" in lines else ("SETE P050 (1) 100", "SETE LP050 (1) 100")
    straight = [
        one.text
        for one in move_job(job_bytes("MOVL P001 V=1.0", *filled, *lines), tmp_path, turn=False).findings
    ]
    assert not straight


def test_an_amount_that_no_job_fills_may_turn(tmp_path: Path) -> None:
    for line in ("SFTON P050 BF", "SFTON P[B000] BF", "SFTON LP050 BF"):
        result = move_job(job_bytes("MOVL P001 V=1.0", line, "MOVL C00000 V=1.0"), tmp_path, turn=False)

        assert [(one.point, one.row >= 0) for one in result.findings] == [("C00000", True)], line


def test_an_amount_computed_from_a_taught_point_is_a_finding_without_a_turn(tmp_path: Path) -> None:
    lines = ("GETPOS PX050 STEP#(1)", "SUB P050 P051", "SFTON P050 BF", "MOVL C00000 V=1.0", "SFTOF")

    result = move_job(job_bytes("MOVL P001 V=1.0", *lines), tmp_path, turn=False)

    assert {finding.point for finding in result.findings} == {"C00000"}
    assert "may turn it" in result.findings[0].text
    assert "0.00" not in result.findings[0].text
    assert result.exit_code is ExitCode.REFUSED


@pytest.mark.parametrize(
    ("lines", "turns"),
    [
        (("MSHIFT PX050 BF PX051 PX052",), True),
        (("MSHIFT PX053 BF PX051 PX052", "SET P050 P053"), True),
        (("SETE P050 (6) 10000",), True),
        (("SETE P050 (B000) D001",), True),
        (("SETE P050 (3) 10000",), False),
        (("SUB P050 P050", "SETE P050 (6) 0"), False),
    ],
)
def test_an_amount_that_turns_is_a_finding_without_a_turn(
    lines: tuple[str, ...], turns: bool, tmp_path: Path
) -> None:
    shifted = (*lines, "SFTON P050 BF", "MOVL C00000 V=1.0", "SFTOF")
    result = move_job(job_bytes("MOVL P001 V=1.0", *shifted), tmp_path, turn=False)
    assert {finding.point for finding in result.findings} == ({"C00000"} if turns else set())


def test_shifts_say_in_which_axes_they_are() -> None:
    program = BRAND.read(
        "a.jbi", job_bytes("SFTON P050 UF#(2)", "MOVL C00001 V=1.0", "SFTON P050 RF", "MOVL C00000 V=1.0")
    )

    assert {(one.axes, one.rows) for one in program.positions.shifts} == {
        (ShiftAxes.USER_FRAME, (1,)), (ShiftAxes.USER_FRAME, (0,)), (ShiftAxes.BASE, (0,)),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("MFRAME UF#(2) PX050 PX051 PX052", set(NAMES)),
        ("MFRAME UF#(7) PX050 PX051 PX052", {"P00000", "P00002"}),
        ("SETTOOL TL#(0) P050", set(NAMES)),
        ("SETTOOL TL#(9) P050", {"P00000", "P00002"}),
        ("MFRAME UF#(B001) PX050 PX051 PX052", set(NAMES)),
    ],
)
def test_positions_in_a_frame_that_the_job_makes_are_left(line: str, names: set[str], tmp_path: Path) -> None:
    result = move_job(job_bytes(line, "MOVL C00000 V=1.0", "MOVL C00001 V=1.0", "MOVL P001 V=1.0"), tmp_path)

    assert left_variables(result) == names


def test_the_current_position_is_no_variable_of_the_job(tmp_path: Path) -> None:
    result = move_job(job_bytes("MOVL P001 V=1.0", "GETS PX050 $PX001", "MOVL C00000 V=1.0"), tmp_path)

    assert "P00001" not in left_variables(result)


def test_one_position_that_needs_another_rconf_is_left_alone(tmp_path: Path) -> None:
    """A turn about the work takes axis T past half a turn for one position; the others still move."""
    row = b"C00001=0.000,40.000,180.000,180.0000,0.0000,"
    data = job_bytes("MOVL C00000 V=1.0", "MOVL C00001 V=1.0", "MOVL P001 V=1.0")
    data = data.replace(row + b"0.0000", row + b"-30.0000")

    result = move_job(data, tmp_path, about=(1.2, 0.1))

    assert left_variables(result) == {"C00001", "P00000", "P00002"}
    assert "RCONF" in dict(result.excluded_points)["C00001"]
    assert result.exit_code is ExitCode.REFUSED


def named_job(name: str, *lines: str) -> bytes:
    """Return a job of this name."""
    return job_bytes(*lines).replace(b"//NAME A", f"//NAME {name}".encode())


@pytest.mark.parametrize(
    ("lines", "found"),
    [
        (("SFTON P050 BF", "CALL JOB:PICK", "SFTOF"), {"C00000"}),
        (("SFTON P050 BF", "CALL JOB:MIDDLE IF IN#(1)=ON", "SFTOF"), {"C00000"}),
        (("SFTON P050 BF", "SFTOF", "CALL JOB:PICK"), set()),
        (("CALL JOB:PICK",), set()),
    ],
)
def test_a_shift_is_on_in_jobs_that_are_called(lines: tuple[str, ...], found: set[str]) -> None:
    files = {
        "MAIN.JBI": named_job("MAIN", *lines),
        "MIDDLE.JBI": named_job("MIDDLE", "CALL JOB:PICK"),
        "PICK.JBI": named_job("PICK", "MOVL C00000 V=1.0"),
    }
    across = BatchDeclarations({name: declarations_of(name, data) for name, data in files.items()})
    pick = read("PICK.JBI", files["PICK.JBI"]).with_external_uses(across.uses_of_file("PICK.JBI"))

    assert {pick.positions.names[row] for one in pick.positions.shifts for row in one.rows} >= found
    assert bool(pick.positions.shifts) is bool(found)


def test_a_job_that_leaves_its_shift_on_shifts_its_caller() -> None:
    files = {
        "MAIN.JBI": named_job("MAIN", "CALL JOB:ON", "MOVL C00000 V=1.0"),
        "ON.JBI": named_job("ON", "SFTON P050 BF"),
    }
    across = BatchDeclarations({name: declarations_of(name, data) for name, data in files.items()})
    main = read("MAIN.JBI", files["MAIN.JBI"]).with_external_uses(across.uses_of_file("MAIN.JBI"))

    assert {one.what for one in main.positions.shifts} == {"SFTON of ON"}


@pytest.mark.parametrize(
    ("line", "is_left"),
    [
        ("CALL JOB:PICK", False),
        ("CALL JOB:PICK UF#(2)", False),
        ("CALL JOB:PICK UF#(3) IF IN#(1)=ON", True),
        ("JUMP JOB:pick UF#(B003)", True),
        ("CALL JOB:OTHER UF#(3)", False),
    ],
)
def test_a_relative_job_that_is_called_in_another_user_frame_is_left(line: str, is_left: bool) -> None:
    files = {"MAIN.JBI": named_job("MAIN", line), "PICK.JBI": named_job("PICK", "MOVL C00000 V=1.0")}
    across = BatchDeclarations({name: declarations_of(name, data) for name, data in files.items()})
    pick = read("PICK.JBI", files["PICK.JBI"]).with_external_uses(across.uses_of_file("PICK.JBI"))

    reasons = {pick.positions.names[row]: why for row, why in pick.positions.barred.items()}
    assert ("MAIN calls its job in another" in reasons.get("C00000", "")) is is_left


@pytest.mark.parametrize(
    ("lines", "names"),
    [
        (("MFRAME UF#(2) PX050 PX051 PX052", "CALL JOB:PICK"), {"C00000", "C00001", "P00000", "P00001"}),
        (("SETTOOL TL#(0) P050", "CALL JOB:PICK"), set(NAMES)),
        (("MFRAME UF#(5) PX050 PX051 PX052", "CALL JOB:PICK"), set()),
        (("MFRAME UF#(2) PX050 PX051 PX052",), set()),  # a job to set up the cell
    ],
)
def test_frames_that_other_jobs_make_leave_their_positions(lines: tuple[str, ...], names: set[str]) -> None:
    files = {"MAIN.JBI": named_job("MAIN", *lines), "PICK.JBI": named_job("PICK", "MOVL C00000 V=1.0")}
    across = BatchDeclarations({name: declarations_of(name, data) for name, data in files.items()})
    alone = read("PICK.JBI", files["PICK.JBI"])
    pick = alone.with_external_uses(across.uses_of_file("PICK.JBI"))

    barred = {pick.positions.names[row] for row in pick.positions.barred}
    assert barred == names | {alone.positions.names[row] for row in alone.positions.barred}
    if "C00000" in names:
        assert "MAIN makes" in pick.positions.barred[0]


def test_axes_that_a_motion_does_not_name_stand_where_another_left_them():
    rows = "C00001=1300.000,0.000,200.000,180.0000,0.0000,0.0000\n"
    base = "BC00000=0.000\nBC00001=100.000\n"
    lines = "MOVJ BC00000 VJ=1.00\nMOVL C00001 V=50.0\n"
    head = "/JOB\n//NAME A\n//POS\n///NPOS 1,2,0,0,0,0\n///TOOL 0\n///POSTYPE ROBOT\n///RECTAN\n///RCONF 0,0,0,0,0,0,0,0\n"
    tail = f"//INST\n///ATTR SC,RW,RJ\n////FRAME ROBOT\n///GROUP1 RB1,BS1\nNOP\n{lines}END\n"
    whole = read_job("a.jbi", (head + rows + base + tail).encode())
    assert "without a row" in whole.positions.barred[0]
    alike = read_job("a.jbi", (head + rows + base.replace("=0.", "=100.") + tail).encode())
    assert not alike.positions.barred
    comma = read_job("a.jbi", (head + rows.replace("1300.000", "1300,5") + base + tail).encode())
    assert "decimal mark" in comma.positions.barred[0]


@pytest.mark.parametrize(
    ("group", "counts", "axis_rows", "says"),
    [
        ("RB1,BS1", "0,0", "", "moves BS1 too"),
        ("RB1,ST1", "0,0", "", "moves ST1 too"),
        ("RB1,BS1", "0,1", "EC00001=100.000\n", "moves BS1 too"),
        ("RB1,BS1", "1,0", "BC00001=100.000\n", ""),
        ("RB1", "0,0", "", ""),
    ],
)
def test_a_group_of_the_header_without_a_row_leaves_the_points(
    group: str, counts: str, axis_rows: str, says: str
) -> None:
    head = f"/JOB\n//NAME A\n//POS\n///NPOS 1,{counts},0,0,0\n///TOOL 0\n///POSTYPE ROBOT\n///RECTAN\n///RCONF 0,0,0,0,0,0,0,0\n"
    rows = "C00001=1300.000,0.000,200.000,180.0000,0.0000,0.0000\n" + axis_rows
    tail = f"//INST\n///ATTR SC,RW\n///GROUP1 {group}\nNOP\nMOVL C00001 V=50.0\nEND\n"
    barred = read_job("a.jbi", (head + rows + tail).encode()).positions.barred
    assert [says in str(reason) for reason in barred.values()] == ([True] if says else [])
