"""FANUC programs that run beside others, or when an alarm has stopped them: what they select and compute."""

import json
from pathlib import Path

import pytest

from cellcal.drivers.fanuc.program_files.ls_computed import registers_of
from cellcal.drivers.fanuc.program_files.ls_statements import Statement
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_across_files import read_programs
from tests.programs.test_fanuc_frames_in_numbers import listing, move
from tests.programs.test_field_cases import CASES, TURNED, move_program

BEGIN = ("  UFRAME_NUM=1", "  UTOOL_NUM=1")
OTHER = "  UFRAME_NUM=2"
STARTS = (
    "RUN SUB",
    "MONITOR SUB",
    "RESUME_PROG=SUB",
    "RESUME_PROG[2] = SUB",
    "ERROR_PROG=SUB",
    "MAINT_PROG=SUB",
)


def with_frame(text: str, frame: str) -> str:
    return text.replace("UF : 9, UT : 9", f"UF : {frame}, UT : {frame}")


def is_left(folder: Path, start: str, called: list[str], *, elsewhere: bool) -> bool:
    """Return whether a position in the selected frame is left, beside a start in its own or in another listing."""
    own = [] if elsewhere else [f"  {start}"]
    files = {"MAIN.LS": with_frame(listing(*BEGIN, *own, move(1), count=1, name="MAIN"), "F")}
    if elsewhere:
        files["TOP.LS"] = listing(f"  {start}", "  CALL MAIN", count=0, name="TOP")
    if called:
        files["SUB.LS"] = listing("  CALL DEEP", count=0, name="SUB")
        files["DEEP.LS"] = listing(*called, count=0, name="DEEP")
    return bool(read_programs(folder, files)["MAIN.LS"].positions.barred)


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize("start", STARTS)
def test_a_frame_that_another_program_may_choose_at_any_time_leaves_the_position(
    tmp_path: Path, start: str, elsewhere: bool
) -> None:
    assert is_left(tmp_path, start, [OTHER], elsewhere=elsewhere)


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize("start", STARTS)
def test_a_program_beside_that_is_not_given_may_choose_one(
    tmp_path: Path, start: str, elsewhere: bool
) -> None:
    assert is_left(tmp_path, start, [], elsewhere=elsewhere)


@pytest.mark.parametrize("called", ["  DO[1]=ON", "  UFRAME_NUM=1"])
@pytest.mark.parametrize("start", STARTS)
def test_a_program_beside_that_chooses_nothing_else_does_no_harm(
    tmp_path: Path, start: str, called: str
) -> None:
    assert not is_left(tmp_path, start, [called], elsewhere=True)


def test_ending_a_recovery_starts_nothing(tmp_path: Path) -> None:
    text = with_frame(listing(*BEGIN, "  CLEAR_RESUME_PROG", move(1), count=1, name="MAIN"), "F")
    assert not read_programs(tmp_path, {"MAIN.LS": text})["MAIN.LS"].positions.barred


def turned_findings(folder: Path, *lines: str, others: dict[str, str]) -> list[str]:
    """Return the findings of a listing that is moved and turned, beside others."""
    place = folder / "cell"
    place.mkdir()
    text = with_frame(listing(*lines, count=1, name="MAIN"), "1")
    files = {"MAIN.LS": text, "project.toml": (CASES / "fanuc" / "project.toml").read_text(), **others}
    for name, content in files.items():
        (place / name).write_text(content)
    words = ["move", place, "--project", place / "project.toml", "--offset", TURNED, "--out", folder / "out"]
    report = folder / "report.json"
    run_command_line(["program", *map(str, words), "--json", str(report)])
    found = json.loads(report.read_text())
    return [one["text"] for program in found["programs"] for one in program["findings"]]


ZERO = [f"  PR[3,{element}]=0" for element in range(1, 7)]


@pytest.mark.parametrize(
    ("called", "start", "count"),
    [
        ("  PR[3,1]=50", "RUN SUB", 1),
        ("  PR[3,1]=50", "RESUME_PROG=SUB", 1),
        ("  PR[R[1],1]=50", "RUN SUB", 1),
        ("  PR[4,1]=50", "RUN SUB", 0),
        ("  PR[3,1]=50", "CALL SUB", 0),
    ],
)
def test_an_amount_that_another_program_may_set_at_any_time_is_not_known(
    tmp_path: Path, called: str, start: str, count: int
) -> None:
    others = {
        "TOP.LS": listing(f"  {start}", "  CALL MAIN", count=0, name="TOP"),
        "SUB.LS": listing(called, count=0, name="SUB"),
    }
    lines = (*BEGIN, *ZERO, move(1, "Offset,PR[3]"))
    assert len(turned_findings(tmp_path, *lines, others=others)) == count


@pytest.mark.parametrize(
    ("taken", "used", "count"),
    [("2", "1", 1), ("1", "2", 1), ("2", "2", 0), ("1", "1", 0)],
)
def test_the_place_of_the_robot_taken_in_one_frame_and_used_in_another(
    tmp_path: Path, taken: str, used: str, count: int
) -> None:
    frame = "  UFRAME_NUM={}"
    lines = (*BEGIN, move(1), frame.format(taken), "  PR[4]=LPOS", frame.format(used), "L PR[4] 9mm/sec FINE")
    findings = turned_findings(tmp_path, *lines, others={})
    assert len(findings) == count
    assert all("in user frame" in one for one in findings)


@pytest.mark.parametrize(
    ("statement", "left"),
    [
        ("  $MNUFRAME[R[1],9]=PR[5]", True),
        ("  $MNUFRAME[R[1],R[2]]=PR[5]", True),
        ("  $MNUFRAME[1,9].$X=R[5]", True),
        ("  $MNUFRAME[R[1],8]=PR[5]", False),
        ("  $MNUFRAME[2,9]=PR[5]", False),
        ("  P[R[1]]=PR[5]", True),
        ("  P[R[1]]=LPOS", True),
        ("  P[R[1],3]=R[5]", True),
    ],
)
def test_a_frame_or_a_position_that_a_register_chooses_leaves_what_it_may_be(
    tmp_path: Path, statement: str, left: bool
) -> None:
    text = listing("  UFRAME_NUM=9", "  UTOOL_NUM=9", statement, move(1), count=1, name="MAIN")
    assert bool(read_programs(tmp_path, {"MAIN.LS": text})["MAIN.LS"].positions.barred) is left


def test_a_position_that_gets_a_value_by_a_register_is_named_as_such(tmp_path: Path) -> None:
    text = (
        (CASES / "fanuc" / "offset_pr.LS")
        .read_text()
        .replace("PR[3]    ;", "PR[3]    ;\n   5:  P[R[1]]=PR[4] ;")
    )
    moved = move_program(tmp_path, "fanuc", "offset_pr.LS", offset=TURNED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert moved.report_point("P[1]")["reason"].startswith("a register chooses a position that line")


def test_a_long_chain_of_registers_written_from_its_end_is_followed() -> None:
    count = 2000  # each pass over all of them would follow one more
    statements = [f"PR[{number + 1}]=PR[{number}]" for number in range(count, 0, -1)] + ["PR[1]=P[7]"]
    assigned = [(Statement(text.encode(), line), None) for line, text in enumerate(statements, 1)]
    found = registers_of(assigned)
    assert found.origins[count + 1] == {7}
    assert found.copied[7] == set(range(1, count + 2))
