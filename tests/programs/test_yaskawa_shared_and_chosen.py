"""Yaskawa jobs of two robots, with rows of axes of another number, variables of other jobs, and relative jobs."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from cellcal.drivers.programs.cross_file_uses import BatchDeclarations
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import PositionChange
from cellcal.drivers.programs.shifts import ShiftAxes
from cellcal.drivers.yaskawa.program_files.programs import BRAND
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.jobs_to_move import PROJECT

SHIFTED, TURNED = "10,20,0,0,0,0", "0,0,0,0,0,5"
ROWS = "///USER 2\n///TOOL 0\n///POSTYPE USER\n///RECTAN\n///RCONF " + ",".join("0" * 24) + "\n"
VALUES = (
    "50.000,0.000,200.000,180.0000,0.0000,0.0000",
    "0.000,40.000,180.000,180.0000,0.0000,0.0000",
)
STATED = ROWS + "".join(f"C{i:05d}={each}\n" for i, each in enumerate(VALUES))
VARIABLE = ROWS + f"P00000={VALUES[0]}\n"
AXES = "///POSTYPE PULSE\n///PULSE\n"
ONE_ROBOT = "///ATTR SC,RW\n///GROUP1 RB1\n"


def job(
    *lines: str, rows: str = STATED, counts: str = "2,0,0,0,0,0", header: str = ONE_ROBOT, name: str = "A"
) -> str:
    """Return a job."""
    head = (
        f"/JOB\n//NAME {name}\n//POS\n///NPOS {counts}\n{rows}//INST\n///DATE 2020/04/25 14:11\n{header}NOP\n"
    )
    return head + "\n".join([*lines, "END", ""])


def variable_job(*lines: str, name: str = "A") -> str:
    """Return a job that states one variable."""
    return job(*lines, rows=VARIABLE, counts="0,0,0,1,0,0", name=name)


def bare_job(*lines: str, name: str = "B") -> str:
    """Return a job without positions."""
    return job(*lines, rows="", counts="0,0,0,0,0,0", name=name)


def move(tmp_path: Path, *jobs: str, offset: str = SHIFTED, robot: str = "") -> dict:
    """Move jobs by the command; return its report of the first, with the exit code and all findings."""
    (tmp_path / "jobs").mkdir(parents=True)
    for number, text in enumerate(jobs):
        (tmp_path / "jobs" / f"J{number}.JBI").write_text(text, encoding="ascii")
    project = PROJECT.replace('serial = "Y1"\n', f'serial = "Y1"\n{robot}')
    (tmp_path / "project.toml").write_text(project, encoding="utf-8")
    words = ["program", "move", str(tmp_path / "jobs"), "--project", str(tmp_path / "project.toml")]
    words += [f"--offset={offset}", "--out", str(tmp_path / "out"), "--json", str(tmp_path / "r.json")]
    code = run_command_line(words)
    programs = json.loads((tmp_path / "r.json").read_text())["programs"]
    findings = [one for program in programs for one in program["findings"]]
    reasons = {one["point"]: one["reason"] for one in programs[0]["points"]}
    return {"code": code, "findings": findings, "reasons": reasons}


@pytest.mark.parametrize("offset", [SHIFTED, TURNED])
@pytest.mark.parametrize(
    ("line", "axes", "counts", "word"),
    [
        ("MOVL C00000 BC00001 V=1.0", "BC00000=0\nBC00001=700\n", "2,2,0,0,0,0", "external axes"),
        ("MOVL C00000 V=1.0 +MOVJ EC00001", "EC00000=0\nEC00001=700\n", "2,0,2,0,0,0", "external axes"),
        ("MOVL C00000 BP005 V=1.0", "", "2,0,0,0,0,0", "BP00005 in line"),
        ("MOVL C00000 V=1.0 +MOVJ EX[I000]", "", "2,0,0,0,0,0", "EX[I000] in line"),
        ("MOVL C00000 V=1.0 +MOVJ EX005", "EX00005=0\n", "2,0,0,0,0,1", "computes"),
        ("MOVL C00000 BC00000\nMOVL C00000 BC00001", "BC00000=0\nBC00001=0\n", "2,2,0,0,0,0", "several"),
    ],
)
def test_the_axes_that_a_motion_names_count(
    tmp_path: Path, offset: str, line: str, axes: str, counts: str, word: str
) -> None:
    lines = [line, *(["SETE EX005 (1) 90000"] if word == "computes" else [])]
    moved = move(tmp_path, job(*lines, rows=STATED + AXES + axes, counts=counts), offset=offset)
    assert moved["code"] == ExitCode.REFUSED
    assert word in moved["reasons"]["C00000"]


def test_rows_of_axes_at_zero_under_another_number_leave_nothing(tmp_path: Path) -> None:
    rows = STATED + AXES + "EC00000=0\nEC00001=0\n"
    text = job("MOVL C00000 V=1.0 +MOVJ EC00001", rows=rows, counts="2,0,2,0,0,0")
    assert move(tmp_path, text)["code"] == ExitCode.PASS


@pytest.mark.parametrize(
    ("header", "robot", "left_points"),
    [
        ("///GROUP1 RB2\n", "", {"C00000", "C00001"}),
        ("///GROUP1 RB2\n", 'control_group = "RB2"\n', set()),
        ("///GROUP1 RB1\n", 'control_group = "RB2"\n', {"C00000", "C00001"}),
        ("///GROUP1 RB2,BS2\n///GROUP2 RB1\n", "", {"C00000"}),
        ("///GROUP1 RB1\n///GROUP2 RB2\n", "", {"C00001"}),
        ("///GROUP1 RB1\n///GROUP2 RB2\n", 'control_group = "RB2"\n', {"C00000"}),
    ],
)
def test_points_of_the_controllers_other_robot_are_left(
    tmp_path: Path, header: str, robot: str, left_points: set[str]
) -> None:
    two = "GROUP2" in header
    lines = ["MOVL C00000 V=1.0 +MOVL C00001"] if two else ["MOVL C00000 V=1.0", "MOVL C00001 V=1.0"]
    moved = move(tmp_path, job(*lines, header=header), robot=robot)
    assert {point for point, reason in moved["reasons"].items() if reason} == left_points
    assert all("control_group" in moved["reasons"][point] for point in left_points)
    assert moved["code"] == (ExitCode.REFUSED if left_points else ExitCode.PASS)


@pytest.mark.parametrize(("robot", "own"), [("RB1", "C00000"), ("RB2", "C00001"), ("RB3", "P00000")])
def test_each_of_three_robots_has_its_part_of_a_motion(tmp_path: Path, robot: str, own: str) -> None:
    header = "///GROUP1 RB1\n///GROUP2 RB2,ST1\n///GROUP3 RB3\n"
    rows = STATED + f"P00000={VALUES[0]}\n"
    line = "MOVL C00000 V=1.0 +MOVL C00001 +MOVL P000"
    text = job(line, rows=rows, counts="2,0,0,1,0,0", header=header)
    moved = move(tmp_path, text, robot=f'control_group = "{robot}"\n')
    assert [point for point, reason in moved["reasons"].items() if not reason] == [own]


def test_a_wrong_control_group_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "project.toml").write_text(
        PROJECT.replace('serial = "Y1"\n', 'serial = "Y1"\ncontrol_group = "R2"\n'), encoding="utf-8"
    )
    (tmp_path / "A.JBI").write_text(job("MOVL C00000 V=1.0"), encoding="ascii")
    words = ["program", "move", str(tmp_path / "A.JBI"), "--project", str(tmp_path / "project.toml")]
    assert run_command_line([*words, f"--offset={SHIFTED}", "--out", str(tmp_path / "out")]) != ExitCode.PASS
    assert "RB1 to RB8" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("offset", [SHIFTED, TURNED])
@pytest.mark.parametrize(
    "lines",
    [
        ("GETS PX010 $PX000", "ADD P010 P011", "MOVJ P010 VJ=1.0"),
        ("GETS PX010 $PX000", "SET P012 P010", "SUB P012 P011", "MOVJ P012 VJ=1.0"),
        ("GETPOS PX010 STEP#(1)", "ADD P010 P011", "MOVJ P010 VJ=1.0"),
        ("GETS PX010 $PX001", "MULMAT P012 P013 P010", "MOVL P012 V=1.0"),
        ("GETARG LP000 IARG#(1)", "MOVL LP000 V=1.0"),
    ],
)
def test_what_a_shift_of_the_work_does_not_reach_is_a_finding(
    tmp_path: Path, offset: str, lines: tuple[str, ...]
) -> None:
    moved = move(tmp_path, job("MOVL C00000 V=1.0", *lines), offset=offset)
    assert (moved["code"], len(moved["findings"])) == (ExitCode.REFUSED, 1)


@pytest.mark.parametrize(
    "lines",
    [
        ("GETS LPX000 $PX001", "MOVL LP000 V=1.0"),
        ("GETS PX010 $PX000", "MOVJ P010 VJ=1.0"),
        ("GETS PX010 $PX001", "ADD P010 P011", "MOVL P010 V=1.0"),
        ("MOVL C00001 V=1.0  //P050 C00009",),
    ],
)
def test_what_goes_along_with_a_shift_is_no_finding(tmp_path: Path, lines: tuple[str, ...]) -> None:
    moved = move(tmp_path, job("MOVL C00000 V=1.0", *lines))
    assert (moved["code"], moved["findings"]) == (ExitCode.PASS, [])


@pytest.mark.parametrize(
    "lines",
    [
        ("SFTON P001 BF", "IFTHENEXP B000=1", "SFTOF", "ENDIF", "MOVL C00000 V=1.0"),
        ("IFTHENEXP B000=1", "SFTON P001 BF", "ELSE", "SFTOF", "ENDIF", "MOVL C00000 V=1.0"),
        ("WHILEEXP B000<3", "MOVL C00000 V=1.0", "SFTON P001 BF", "ENDWHILE"),
        ("FOR B000=1 TO 3", "MOVL C00000 V=1.0", "SFTON P001 BF", "NEXT B000"),
        ("SWITCH B000 CASE 1", "SFTON P001 BF", "CASE 2", "SFTOF", "ENDSWITCH", "MOVL C00000 V=1.0"),
    ],
)
def test_a_shift_that_is_switched_in_a_branch_or_loop_may_be_on(
    tmp_path: Path, lines: tuple[str, ...]
) -> None:
    moved = move(tmp_path, job(*lines), offset=TURNED)
    assert moved["code"] == ExitCode.REFUSED
    assert [one["point"] for one in moved["findings"]] == ["C00000"]


def test_a_shift_that_is_switched_outside_of_branches_is_off_behind_them(tmp_path: Path) -> None:
    branch = ("IFTHENEXP B000=1", "MOVL C00001 V=1.0", "ENDIF")
    moved = move(tmp_path, job("SFTON P001 BF", *branch, "SFTOF", "MOVL C00000 V=1.0"), offset=TURNED)
    assert {one["point"] for one in moved["findings"]} == {"C00001"}


def test_a_called_job_may_leave_a_shift_on_that_it_switches_in_a_branch(tmp_path: Path) -> None:
    caller = job("CALL JOB:B", "MOVL C00000 V=1.0")
    called = bare_job("SFTON P001 BF", "IFTHENEXP B000=1", "SFTOF", "ENDIF")
    assert move(tmp_path, caller, called, offset=TURNED)["code"] == ExitCode.REFUSED


@pytest.mark.parametrize(
    ("lines", "found"),
    [
        (("SETE P001 (1) D000",), 0),
        (("SETE P001 (4) D000",), 1),
        (("SETE P002 (1) D000",), 1),
        (("SET P001 P002",), 1),
        (("GETARG P001 IARG#(1)", "MSHIFT P001 BF P003 P004"), 1),
    ],
)
def test_an_amount_of_another_job_turns_nothing_where_it_fills_lengths_only(
    tmp_path: Path, lines: tuple[str, ...], found: int
) -> None:
    moved = move(tmp_path, job("SFTON P001 BF", "MOVL C00000 V=1.0"), bare_job(*lines))
    assert [one["what"] for one in moved["findings"]] == ["SFTON P001"] * found


@pytest.mark.parametrize("amount", ["P001", "P[LB000]"])
def test_a_macro_that_leaves_a_shift_on_is_a_finding(tmp_path: Path, amount: str) -> None:
    macro = bare_job(f"SFTON {amount} BF").replace("SC,RW", "SC,RW,MC")
    moved = move(tmp_path, job("MACRO1 MJ#(2)", "MOVL C00000 V=1.0"), macro)
    assert {one["point"] for one in moved["findings"]} == {"C00000", "C00001", "MACRO1 MJ#(2)"}


def test_a_frame_that_a_person_makes_by_a_job_is_a_finding(tmp_path: Path) -> None:
    for frame, found in (("UF#(2)", ["UF#(2)"]), ("UF#(3)", [])):
        text = job("MOVL C00000 V=1.0")
        moved = move(tmp_path / frame, text, bare_job(f"MFRAME {frame} C00000 C00001 C00002"))
        assert [one["point"] for one in moved["findings"]] == found


@pytest.mark.parametrize("line", ["MACRO1 MJ#(2) ARGF0.5", "JUMP JOB:B", "CALL JOB:B"])
def test_a_shift_that_is_on_in_another_job_is_a_finding(tmp_path: Path, line: str) -> None:
    moved = move(tmp_path, job("SFTON P001 BF", line, "SFTOF"), offset=TURNED)
    assert moved["code"] == ExitCode.REFUSED
    assert len([one for one in moved["findings"] if one["what"] != "CALL"]) == 1


@pytest.mark.parametrize("offset", [SHIFTED, TURNED])
@pytest.mark.parametrize(
    "line",
    [
        "SETE P000 (3) 1000", "SET P000 P005", "ADD P000 P001", "SUB PX000 PX001", "GETS PX000 $PX001",
        "IMOV P000 V=1.0 UF#(2)", "SFTON P000 UF#(2)", "GETARG P000 IARG#(1)", "SETE P[I000] (1) D000",
        "sete p000 (3) 1000",
    ],
)  # fmt: skip
def test_a_variable_with_which_another_job_computes_is_left(tmp_path: Path, offset: str, line: str) -> None:
    moved = move(tmp_path, variable_job("MOVL P000 V=1.0"), bare_job(line), offset=offset)
    assert moved["code"] == ExitCode.REFUSED
    assert "job B" in moved["reasons"]["P00000"]


@pytest.mark.parametrize("offset", [SHIFTED, TURNED])
@pytest.mark.parametrize(
    ("lines", "left"),
    [
        (("GETE D010 P000 (1)",), False),
        (("SET P005 P000",), False),
        (("SET LP005 P000", "MOVL LP005 V=1.0"), False),
        (("SET P005 P000", "SETE P005 (3) 1000"), False),
        (("GETE D010 P000 (1)", "SETE P000 (1) D010"), True),
        (("SFTON P005 BF", "SET P005 P000"), True),
        (("SET P006 P005", "SET P005 P000", "ADD P007 P006"), True),
        (("SET LP005 P000", "IMOV LP005 V=1.0 BF"), True),
        (("MUL P000 B001",), True),
        (("ADD P005 P000",), True),
        (("MSHIFT PX005 BF PX000 PX001",), True),
    ],
)
def test_a_variable_that_another_job_only_reads_moves(
    tmp_path: Path, offset: str, lines: tuple[str, ...], left: bool
) -> None:
    moved = move(tmp_path, variable_job("MOVL P000 V=1.0"), bare_job(*lines), offset=offset)
    assert ("job B" in moved["reasons"]["P00000"]) == left
    assert left or moved["reasons"]["P00000"] == ""


def _count_calls_of_batch(count: int) -> int:
    """Return how many functions are called to give each of many jobs what the others say of it."""
    texts = {
        f"J{i}.JBI": job(
            *(f"GETS PX{number:03d} $PX001" for number in range(10 * i, 10 * i + 10)),
            "SFTON P001 BF",
            f"CALL JOB:J{i + 1}",
            "SFTOF",
            name=f"J{i}",
            rows=VARIABLE,
            counts="0,0,0,1,0,0",
        )
        for i in range(count)
    }
    programs = {name: BRAND.read(name, text.encode("ascii")) for name, text in texts.items()}
    across = BatchDeclarations({name: one.declarations for name, one in programs.items()})
    uses_by_program = [(program, across.uses_of_file(name)) for name, program in programs.items()]
    calls = [0]

    def count_call(frame: object, event: str, _: object) -> None:
        calls[0] += event in ("call", "c_call")

    sys.setprofile(count_call)
    try:
        for program, uses in uses_by_program:
            program.with_external_uses(uses)
    finally:
        sys.setprofile(None)
    return calls[0]


def test_what_other_jobs_say_costs_no_more_for_each_job_of_a_large_folder() -> None:
    assert _count_calls_of_batch(60) < 2.5 * _count_calls_of_batch(30)


def test_a_variable_that_another_job_goes_to_moves_with_the_job_that_states_it(tmp_path: Path) -> None:
    moved = move(tmp_path, variable_job("MOVL P000 V=1.0"), bare_job("MOVL P000 V=1.0"))
    assert (moved["code"], moved["findings"]) == (ExitCode.PASS, [])


def test_a_relative_job_in_another_frame_than_its_rows_is_left(tmp_path: Path) -> None:
    header = "///ATTR SC,RW,RJ\n////FRAME USER {}\n///GROUP1 RB1\n"
    moved = move(tmp_path, job("MOVL C00000 V=1.0", header=header.format(3)))
    assert moved["code"] == ExitCode.REFUSED
    assert "USER 2, and the relative job in USER 3" in moved["reasons"]["C00000"]
    (tmp_path / "own").mkdir()
    moved = move(tmp_path / "own", job("MOVL C00000 V=1.0", header=header.format("02")))
    assert moved["code"] == ExitCode.PASS


def test_increments_in_small_letters_are_left(tmp_path: Path) -> None:
    moved = move(tmp_path, job("movl c00000 v=1.0", "imov c00001 v=1.0 bf"))
    assert moved["code"] == ExitCode.REFUSED
    assert "increment" in moved["reasons"]["C00001"]
    assert moved["reasons"]["C00000"] == ""


@pytest.mark.parametrize(
    ("lines", "called"),
    [
        (("'see c00001", "SFTON P001 BF", "CALL JOB:Sub", "SFTOF"), "Sub"),
        (("NOP //move to p001", "SFTON P001 BF", "CALL JOB:Sub IF IN#(1)=ON"), "Sub"),
        (("sfton p001 bf", "call job:Sub if in#(1)=on 'c00001", "sftof"), "Sub"),
        (("sfton p001 bf", "pstart job:Sub", "sftof"), "Sub"),
        (("sfton p001 bf", "call job:sub", "sftof"), "SUB"),
    ],
)
def test_small_letters_lose_no_call(tmp_path: Path, lines: tuple[str, ...], called: str) -> None:
    moved = move(tmp_path, bare_job(*lines), job("MOVL C00000 V=1.0", name=called), offset=TURNED)
    assert moved["code"] == ExitCode.REFUSED
    assert any("SFTON of B shifts C00000" in one["text"] for one in moved["findings"])


def test_the_frame_of_a_shift_is_read_in_small_letters() -> None:
    program = BRAND.read("A.JBI", job("SFTON P001 uf#(2)", "MOVL C00000 V=1.0").encode("ascii"))
    assert [one.axes for one in program.positions.shifts] == [ShiftAxes.USER_FRAME]


def test_a_folder_and_numbers_with_zeros_are_read(tmp_path: Path) -> None:
    text = job("MOVL C00000 V=1.0").replace("//POS\n", "///FOLDERNAME FOLDER001\n//POS\n")
    text = text.replace("///USER 2", "///USER 02").replace("///TOOL 0", "///TOOL 00")
    assert move(tmp_path, text)["code"] == ExitCode.PASS


def test_a_job_whose_lines_end_with_a_carriage_return_alone_is_refused_with_the_cure() -> None:
    with pytest.raises(ProgramFileError, match="carriage return alone"):
        BRAND.read("A.JBI", job("MOVL C00000 V=1.0").replace("\n", "\r").encode("ascii"))


@pytest.mark.parametrize(
    ("alone", "refused"), [("MOVJ EC00002 VJ=10.0", True), ("MOVJ EC00001 VJ=10.0", False), ("NOP", False)]
)
def test_axes_that_go_somewhere_without_the_robot_keep_their_zero(alone: str, refused: bool) -> None:
    rows = STATED + AXES + "EC00000=0\nEC00001=500\nEC00002=900\n"
    lines = ("MOVJ C00000 EC00000 VJ=10.0", alone, "MOVL C00001 EC00001 V=1.0")
    text = job(*lines, rows=rows, counts="2,0,3,0,0,0", header=f"{ONE_ROBOT}///GROUP2 ST1\n")
    program = BRAND.read("A.JBI", text.encode("ascii"))
    change = PositionChange(np.array([0, 1]), external=np.array([[1000.0], [1500.0]]))
    if refused:
        with pytest.raises(ProgramFileError, match="EC00002 without the robot"):
            program.with_changes(change)
    else:
        assert b"EC00000=1000\nEC00001=1500\nEC00002=900" in program.with_changes(change).to_bytes()


@pytest.mark.parametrize("axes", ["EC00000=0\nEC00001=7.0.0\n", "EC00000=0\nEC00001=\n"])
def test_a_row_of_axes_that_is_no_number_leaves_its_point(tmp_path: Path, axes: str) -> None:
    lines = ("MOVL C00000 V=1.0", "MOVL C00001 V=1.0")
    moved = move(tmp_path, job(*lines, rows=STATED + AXES + axes, counts="2,0,2,0,0,0"))
    assert moved["code"] == ExitCode.REFUSED
    assert "is no number" in moved["reasons"]["C00001"]
    assert "external axes elsewhere" in moved["reasons"]["C00000"]
