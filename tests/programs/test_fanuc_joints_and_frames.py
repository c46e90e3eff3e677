"""FANUC registers that hold joints, frames that only the running program knows, and frames that a call restores."""

import json
import re
from pathlib import Path

import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_compensated_computations import compensate
from tests.programs.test_fanuc_copied_frames import ABOUT_Z, ALONG, PROJECT, START, listing, move
from tests.programs.test_field_cases import CASES

GOES = "L P[1] 100mm/sec FINE"
JOINTS = (
    "P[3]{\n   GP1:\n\tUF : 1, UT : 1,\n\tJ1=    10.000 deg,\tJ2=    20.000 deg,\tJ3=   -10.000 deg,\n"
    "\tJ4=     0.000 deg,\tJ5=   -40.000 deg,\tJ6=     0.000 deg\n};\n"
)


def joint_listing(*lines: str) -> str:
    """Return a listing with a position in joint angles."""
    return listing(*START, *lines).replace("/END", f"{JOINTS}/END")


@pytest.mark.parametrize("offset", [ALONG, ABOUT_Z])
@pytest.mark.parametrize(
    "lines",
    [
        (GOES, "PR[10]=JPOS", "PR[10,3]=PR[10,3]+10", "J PR[10] 100% FINE"),
        (GOES, "PR[10]=JPOS", "PR[11]=PR[10]", "PR[11,3]=PR[11,3]-10", "J PR[11] 100% FINE"),
        ("PR[10]=P[3]", "PR[10,2]=PR[10,2]+5", "J PR[10] 100% FINE"),
        ("PR[1]=JPOS", "PR[1]=PR[1]-PR[1]", "PR[1,1]=10", "J P[1] 100% FINE Offset,PR[1]"),
        ("PR[1]=JPOS-JPOS", "PR[1,1]=10", "J P[1] 100% FINE Offset,PR[1]"),
        ("PR[1]=JPOS", "PR[1,5]=PR[1,5]+10", "J PR[1] 100% FINE"),
    ],
)
def test_what_joints_are_added_to_is_a_finding(tmp_path: Path, lines: tuple[str, ...], offset: str) -> None:
    moved = move(tmp_path, joint_listing(*lines), offset)
    assert moved["code"] == ExitCode.REFUSED
    assert moved["findings"]


@pytest.mark.parametrize(
    "lines",
    [
        (GOES, "PR[10]=JPOS", "J PR[10] 100% FINE"),
        ("PR[10]=P[3]", "J PR[10] 100% FINE"),
        (GOES, "PR[10]=LPOS", "PR[10,3]=PR[10,3]+10", "L PR[10] 100mm/sec FINE"),
    ],
)
def test_joints_that_are_only_gone_to_are_no_finding(tmp_path: Path, lines: tuple[str, ...]) -> None:
    moved = move(tmp_path, joint_listing(*lines), ALONG)
    assert (moved["code"], moved["findings"]) == (ExitCode.PASS, [])


def test_joints_that_another_program_adds_to_are_a_finding(tmp_path: Path) -> None:
    texts = {
        "Z": listing(*START, GOES, "PR[10]=JPOS", "J PR[10] 100% FINE"),
        "SUB": _program("SUB", "PR[10,3]=PR[10,3]+10"),
    }
    assert _move_all(tmp_path, texts, ALONG)["code"] == ExitCode.REFUSED


@pytest.mark.parametrize("offset", [ALONG, ABOUT_Z])
@pytest.mark.parametrize(
    "selection", ["UFRAME_NUM=R[5]", "UFRAME_NUM=AR[1]", "$MNUFRAMENUM[1]=R[5]", "UFRAME_NUM=0"]
)
def test_a_copy_in_a_frame_that_a_register_chooses_is_a_finding(
    tmp_path: Path, selection: str, offset: str
) -> None:
    text = listing(*START, "PR[10]=P[1]", selection, "L PR[10] 100mm/sec FINE")
    moved = move(tmp_path, text, offset)
    assert moved["code"] == ExitCode.REFUSED
    words = "user frame 0" if selection.endswith("=0") else "only the running program knows"
    assert any(words in one["text"] for one in moved["findings"])


@pytest.mark.parametrize("selection", ["UFRAME_NUM=0", "UTOOL_NUM=0"])
def test_frame_and_tool_zero_are_not_those_of_the_position(tmp_path: Path, selection: str) -> None:
    moved = move(tmp_path, listing(*START, selection, GOES), ALONG)
    assert moved["code"] == ExitCode.REFUSED
    assert "and it was taught with 1" in moved["points"][0]["reason"]


def test_a_frame_that_is_chosen_again_is_known(tmp_path: Path) -> None:
    lines = (*START, "PR[10]=P[1]", "UFRAME_NUM=R[5]", "UFRAME_NUM=01", "L PR[10] 100mm/sec FINE")
    assert move(tmp_path, listing(*lines), ALONG)["code"] == ExitCode.PASS


KEPT = "R[9]=($MNUFRAMENUM[1])"


@pytest.mark.parametrize("offset", [ALONG, ABOUT_Z])
@pytest.mark.parametrize(
    ("lines", "restored"),
    [
        (("UFRAME_NUM=2", "UFRAME_NUM=1"), True),
        ((KEPT, "UFRAME_NUM=2", "UFRAME_NUM=R[9]"), True),
        (("IF R[1]=1,JMP LBL[1]", "UFRAME_NUM=2", "LBL[1]", "UFRAME_NUM=1"), True),
        (("UFRAME_NUM=2",), False),
        (("UFRAME_NUM=R[9]",), False),
        (("UFRAME_NUM=2", KEPT, "UFRAME_NUM=R[9]"), False),
        ((KEPT, "UFRAME_NUM=2", "R[9]=R[9]+1", "UFRAME_NUM=R[9]"), False),
        ((KEPT, "UFRAME_NUM=2", "R[R[2]]=3", "UFRAME_NUM=R[9]"), False),
        (("IF R[1]=1,JMP LBL[1]", KEPT, "LBL[1]", "UFRAME_NUM=2", "UFRAME_NUM=R[9]"), False),
        (("UFRAME_NUM=2", "END", "UFRAME_NUM=1"), False),
        (("UFRAME_NUM=2", "IF R[1]=1,JMP LBL[1]", "UFRAME_NUM=1", "LBL[1]"), False),
        (("UFRAME_NUM=2", "IF (R[1]=1),UFRAME_NUM=1"), False),
    ],
)
def test_the_frame_that_a_called_program_leaves_counts(
    tmp_path: Path, lines: tuple[str, ...], restored: bool, offset: str
) -> None:
    texts = {
        "Z": listing(*START, "PR[10]=P[1]", "CALL SUB", "L PR[10] 100mm/sec FINE"),
        "SUB": _program("SUB", *lines),
    }
    code = _move_all(tmp_path, texts, offset)["code"]
    assert code == (ExitCode.PASS if restored else ExitCode.REFUSED)


@pytest.mark.parametrize(
    "line", ["P[1]=P[2]", "P[1]=LPOS", "P[1,3]=100", "P[1]=PR[2]", "IF (R[1]=1),P[1]=PR[2]"]
)
def test_a_position_that_gets_a_value_is_left(tmp_path: Path, line: str) -> None:
    moved = move(tmp_path, listing(*START, line, GOES, "L P[2] 100mm/sec FINE"), ALONG)
    assert moved["code"] == ExitCode.REFUSED
    assert moved["points"][0]["reason"].startswith("line 6 gives it a value")


def test_programs_that_are_not_read_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("Z.TP", "Y.TP", "-BCKEDT-.TP", "K.KL"):
        (tmp_path / "programs").mkdir(exist_ok=True)
        (tmp_path / "programs" / name).write_bytes(b"\0")
    assert _move_all(tmp_path, {"Z": listing(*START, GOES)}, ALONG)["code"] == ExitCode.REFUSED
    printed = " ".join(capsys.readouterr().err.split())
    assert "2 files passed over, places in them are not read and stay: K.KL, Y.TP" in printed


@pytest.mark.parametrize(
    ("selection", "word"),
    [
        ("UFRAME_NUM=0", "of another place"),
        ("UFRAME_NUM=R[5]", "of another place"),
        ("UTOOL_NUM=2", "of another posture"),
        ("UTOOL_NUM[GP1]=R[5]", "of another posture"),
        ("$MNUTOOLNUM[1]=2", "of another posture"),
        ("UFRAME_NUM=2", ""),
        ("UTOOL_NUM=1", ""),
        ("CALL TL(2)", "of another posture"),
        ("CALL TL(1)", ""),
    ],
)
def test_a_copy_in_another_frame_or_with_another_tool_is_corrected_for_another_place(
    tmp_path: Path, selection: str, word: str
) -> None:
    text = (CASES / "fanuc" / "inc_lift.LS").read_text()
    lines = ("UFRAME_NUM=2", "UTOOL_NUM=1", "PR[10]=P[1]", selection)
    numbered = "".join(f"{k:4d}:  {line} ;\n" for k, line in enumerate(lines, 1))
    back = "   6:  UFRAME_NUM=2 ;\n   7:  UTOOL_NUM=1 ;\n   8:L P[2] 9mm/sec FINE ;\n"
    text = re.sub(
        r"/MN\n.*?/POS",
        f"/MN\n{numbered}   5:L PR[10] 9mm/sec FINE ;\n{back}/POS",
        text,
        flags=re.DOTALL,
    )
    called = f"/PROG  TL\n/ATTR\n/MN\n   1:  UTOOL_NUM={selection[-2]} ;\n/POS\n/END\n"
    beside = ("TL.LS", called) if selection.startswith("CALL") else None
    code, report = compensate(tmp_path, "fanuc", "A.LS", text, beside=beside)
    assert code == (ExitCode.REFUSED if word else ExitCode.PASS)
    assert bool(word) == any(word in one["text"] for one in report["findings"] if word)


def _program(name: str, *lines: str) -> str:
    """Return a listing without positions."""
    head, _, _ = listing(*lines).partition("/POS")
    return head.replace("/PROG  Z", f"/PROG  {name}") + "/POS\n/END\n"


def _move_all(tmp_path: Path, texts: dict[str, str], offset: str) -> dict:
    folder = tmp_path / "programs"
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        (folder / f"{name}.LS").write_text(text, encoding="ascii")
    (tmp_path / "project.toml").write_text(PROJECT, encoding="utf-8")
    words = ["program", "move", str(folder), "--project", str(tmp_path / "project.toml")]
    words += [f"--offset={offset}", "--out", str(tmp_path / "out"), "--json", str(tmp_path / "r.json")]
    code = run_command_line(words)
    return {"code": code, "programs": json.loads((tmp_path / "r.json").read_text())["programs"]}
