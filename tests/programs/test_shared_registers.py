"""FANUC: a position that is copied into a register and computed there, in this program or in one that it calls."""

import json
from pathlib import Path
from typing import Any

import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_field_cases import CASES, TURNED

LISTING = (CASES / "fanuc" / "offset_pr.LS").read_text()
MOTIONS = LISTING[LISTING.index("   3:L P[1]") : LISTING.index("/POS")]
CALLED = LISTING[: LISTING.index("/MN")].replace("OFFPR", "ADDS") + "/MN\n   1:  {} ;\n/POS\n/END\n"
COPY, GO = "PR[1]=P[1]", "L PR[1] 100mm/sec FINE"


def move_listings(folder: Path, lines: list[str], *, offset: str = TURNED, called: str = "") -> Any:
    """Move a program of these statements, and a program ADDS of one statement beside it; return the report."""
    statements = "".join(
        f"   {number}:{'' if line[:2] == 'L ' else '  '}{line} ;\n" for number, line in enumerate(lines, 3)
    )
    files = {
        "MAIN.LS": LISTING.replace(MOTIONS, statements),
        "ADDS.LS": CALLED.format(called) if called else "",
    }
    words = ["program", "move"]
    for name, text in files.items():
        if text:
            (folder / name).write_text(text)
            words.append(str(folder / name))
    report = folder / "report.json"
    words += ["--project", str(CASES / "fanuc" / "project.toml"), "--offset", offset]
    code = run_command_line([*words, "--out", str(folder / "out"), "--json", str(report)])
    found = json.loads(report.read_text())
    assert found["exit_code"] == code
    (main,) = (one for one in found["programs"] if one["source"].endswith("MAIN.LS"))
    return main | {"exit_code": code}


@pytest.mark.parametrize(
    "added",
    [
        "PR[1,1]=PR[1,1]+50",
        "PR[1,R[2]]=PR[1,R[2]]+50",
        "PR[GP1:1,AR[1]]=50",
        "PR[R[3],2]=PR[R[3],2]+50",
        "PR[R[3],R[2]]=50",
    ],
)
@pytest.mark.parametrize("where", ["here", "called", "called in a condition"])
def test_an_element_that_is_computed_is_seen_wherever_it_is(tmp_path: Path, added: str, where: str) -> None:
    if where == "here":
        report = move_listings(tmp_path, [COPY, added, GO])
    else:
        call = "CALL ADDS(1)" if where == "called" else "IF R[1]=1,CALL ADDS"
        report = move_listings(tmp_path, [COPY, call, GO], called=added)
    assert report["exit_code"] == ExitCode.REFUSED
    texts = [found["text"] for found in report["findings"]]
    assert texts
    assert all("P[1]" in text and "30.00 deg" in text for text in texts)


def test_a_program_that_was_not_given_may_compute_the_register(tmp_path: Path) -> None:
    report = move_listings(tmp_path, [COPY, "CALL ADDS(1)", GO])
    assert report["exit_code"] == ExitCode.REFUSED
    assert "CALL ADDS" in report["findings"][0]["text"]


@pytest.mark.parametrize(
    ("lines", "called", "named"),
    [
        ([COPY, "Open gripper", GO], "", "Open gripper"),  # a macro
        ([COPY, "HAND1(2)", GO], "", "HAND1"),  # with an argument
        (["MONITOR WATCH", COPY, GO], "", "MONITOR WATCH"),  # it may come at any time
        (["MONITOR WATCH", "MONITOR END OTHER", COPY, GO], "", "MONITOR WATCH"),
        (["RUN BESIDE", COPY, GO], "", "RUN BESIDE"),
        (
            [COPY, "LBL[1]", GO, "CALL ABSENT", "JMP LBL[1]"],
            "",
            "CALL ABSENT",
        ),  # called before the next round
        (
            ["CALL ABSENT", "IF R[1]=1,JMP LBL[1]", COPY, "LBL[1]", GO],
            "",
            "CALL ABSENT",
        ),  # the copy is left out
        ([COPY, "L P[1] 100mm/sec FINE TB .5sec,CALL ABSENT", GO], "", "CALL ABSENT"),  # of a motion
        ([COPY, "CALL ADDS", GO], "CALL ABSENT", "ABSENT"),  # by one that is given
        ([COPY, "CALL ADDS", GO], "Open gripper", "Open gripper"),
        ([COPY, GO], "MONITOR WATCH", "ADDS.LS: WATCH"),  # started by another one
    ],
)
def test_whatever_may_run_a_program_that_was_not_given_is_a_finding(
    tmp_path: Path, lines: list[str], called: str, named: str
) -> None:
    report = move_listings(tmp_path, lines, called=called)
    assert report["exit_code"] == ExitCode.REFUSED
    assert named in report["findings"][0]["text"]


@pytest.mark.parametrize(
    ("lines", "called", "offset"),
    [
        (["Open gripper", COPY, GO], "", TURNED),  # a macro before the register is filled
        ([COPY, GO, "Open gripper"], "", TURNED),
        ([COPY, "WAIT R[1]=1", "PAUSE", "LOCK PREG", GO], "", TURNED),  # words that are no macro
        (["MONITOR WATCH", "MONITOR END WATCH", COPY, GO], "", TURNED),
        (["MONITOR ADDS", COPY, GO], "R[1]=5", TURNED),  # it is given, and computes no register of positions
        (["LBL[1]", COPY, GO, "CALL ABSENT", "JMP LBL[1]"], "", TURNED),  # filled in every round
        ([COPY, "CALL ADDS(1)", GO], "R[1]=5", TURNED),  # it computes no register of positions
        ([COPY, "CALL ADDS(1)", GO], "PR[2,1]=PR[2,1]+50", TURNED),  # it computes another one
        (["CALL ADDS(1)", COPY, GO], "", TURNED),  # called before the register is filled
        ([COPY, GO, "CALL ADDS(1)"], "", TURNED),  # called when the arm has been there
        (
            [COPY, "CALL ADDS(1)", GO],
            "PR[1,1]=PR[1,1]+50",
            "30,-20,5,0,0,0",
        ),  # no rotation: the shift stays right
    ],
)
def test_a_copy_that_nothing_changes_moves_with_its_position(
    tmp_path: Path, lines: list[str], called: str, offset: str
) -> None:
    report = move_listings(tmp_path, lines, called=called, offset=offset)
    calls = [one for one in report["findings"] if one["what"] == "CALL"]  # of programs that are not given
    assert report["exit_code"] == (ExitCode.REFUSED if calls else ExitCode.PASS)
    assert report["findings"] == calls
