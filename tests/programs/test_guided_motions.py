"""Motions that a sensor or another computer guides, and axes that move by themselves: no exit code of success."""

from pathlib import Path

import pytest

from cellcal.service.exit_codes import ExitCode
from tests.programs import test_absent_places as absent
from tests.programs.test_absent_places import SHIFTED, UNMOVED, fanuc
from tests.programs.test_field_cases import CASES, move_program

TURNED = "0,0,0,0,0,8"
KUKA = (CASES / "kuka" / "lin_rel_rotated.src").read_text()
FILES = {"fanuc": "offset_pr.LS", "abb": "pdisp_rotated.mod", "kuka": "lin_rel_rotated.src"}
FILE_OF_AXES = "VAR jointtarget jOwn:=[[9E9,9E9,9E9,9E9,9E9,9E9],[100,9E9,9E9,9E9,9E9,9E9]];\nPROC main"


def rapid(*lines: str) -> str:
    return absent.rapid(*lines).replace("\nVAR robtarget pOwn;", "")


def krl(*lines: str) -> str:
    return KUKA.replace("LIN_REL {X 100}", "\n".join(lines))


@pytest.mark.parametrize(
    ("brand", "text", "name"),
    [
        ("fanuc", fanuc("IBGN start[1]", "IBGN end[1]"), "IBGN start"),
        ("fanuc", fanuc("Track DPM[1]", "L P[1] 9mm/sec FINE", "Track End"), "Track DPM"),
        ("abb", rapid("EGMRunPose egmID1,EGM_STOP_HOLD\\x\\y;"), "EGMRunPose"),
        ("abb", rapid("EGMRunJoint egmID1,EGM_STOP_HOLD\\J1;"), "EGMRunJoint"),
        ("kuka", krl("RSI_MOVECORR()"), "RSI_MOVECORR"),
        ("kuka", krl("ret = RSI_ON(#RELATIVE)"), "RSI_ON"),
    ],
)
def test_a_motion_that_another_device_guides_is_a_finding(brand, text, name, tmp_path: Path) -> None:
    moved = move_program(tmp_path, brand, FILES[brand], offset=SHIFTED, text=text)
    (found,) = [one for one in moved.report["findings"] if one["point"] == name]
    assert "A sensor or another computer guides this motion" in found["text"]
    assert moved.code == ExitCode.REFUSED
    still = move_program(tmp_path / "again", brand, FILES[brand], offset=UNMOVED, text=text)
    assert still.report["findings"] == []


@pytest.mark.parametrize(
    ("brand", "text", "name"),
    [
        ("fanuc", fanuc("FORCE CTRL[1:insert]", "L P[1] 9mm/sec FINE"), "FORCE CTRL"),
        ("abb", rapid("FCRefForce\\Fz:=-20;", "FCRefStart;"), "FCRefForce"),
    ],
)
def test_a_force_along_the_axes_of_a_frame_is_a_finding_where_these_turn(brand, text, name, tmp_path) -> None:
    turned = move_program(tmp_path, brand, FILES[brand], offset=TURNED, text=text)
    assert [one["what"] for one in turned.report["findings"]] == [name]
    assert turned.code == ExitCode.REFUSED
    shifted = move_program(tmp_path / "again", brand, FILES[brand], offset=SHIFTED, text=text)
    assert shifted.report["findings"] == []


@pytest.mark.parametrize(
    ("brand", "text", "left"),
    [
        ("abb", rapid("IndAMove STN1,1\\ToAbsNum:=100,50;"), ["IndAMove@5"]),
        ("abb", rapid("MoveExtJ jOther,vrot10,fine;"), ["MoveExtJ@5"]),
        ("abb", rapid("MoveExtJ jOwn,vrot10,fine;").replace("PROC main", FILE_OF_AXES), ["p10", "jOwn"]),
        ("kuka", krl("ASYPTP {E1 10}"), ["ASYPTP@8"]),
    ],
)
def test_an_axis_that_moves_by_itself_is_left_and_named(brand, text, left, tmp_path: Path) -> None:
    moved = move_program(tmp_path, brand, FILES[brand], offset=SHIFTED, text=text)
    assert [one["point"] for one in moved.report["points"] if one["reason"]] == left
    assert moved.code == ExitCode.REFUSED
