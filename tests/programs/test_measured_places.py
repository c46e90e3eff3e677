"""Places that a program takes from where the robot stands, in one frame, and goes to in another."""

import json
from pathlib import Path

import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode

PROJECT = """format = 1
name = "cell"
[robot]
serial = "S1"
model = "abb_irb120"
[tools.t.entered]
position_mm = [0, 0, 100]
[frames.w1]
position_mm = [300, 100, 50]
[frames.w2]
position_mm = [300, -200, 20]
fanuc_wpr_deg = [0, 0, {turn}]
"""
TAUGHT = "CONST robtarget p1:=[[50,50,250],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];"
HERE = "CRobT(\\Tool:=t\\WObj:=w1)"
GO = ("PROC go(robtarget p)", "MoveL p,v100,fine,t\\WObj:={frame};", "ENDPROC")
MOVE = "MoveL {},v100,fine,t\\WObj:={{frame}};"


def routine(*lines: str) -> tuple[str, ...]:
    return ("PROC main()", "MoveL p1,v100,fine,t\\WObj:=w1;", *lines, "ENDPROC")


WAYS = {
    "straight": {"m": routine(MOVE.format(HERE))},
    "shifted": {"m": routine(MOVE.format(f"RelTool({HERE},0,0,5)"))},
    "element": {"m": ("VAR robtarget ps{3};", *routine(f"ps{{2}}:={HERE};", MOVE.format("ps{i}")))},
    "copies": {
        "m": (
            "VAR robtarget ps{3};",
            "VAR robtarget qs{3};",
            *routine(f"ps{{1}}:=Offs({HERE},0,0,9);", "qs{2}:=ps{1};", MOVE.format("qs{3}")),
        )
    },
    "argument": {"m": (*routine(f"go {HERE};"), *GO)},
    "argument of another module": {"m": routine(f"go {HERE};"), "n": GO},
    "variable of another module": {
        "m": ("PERS robtarget ph;", *routine(f"ph:={HERE};")),
        "n": ("PROC g()", MOVE.format("ph"), "ENDPROC"),
    },
    "searched": {
        "m": (
            "VAR robtarget ps{3};",
            *routine("SearchL di1,ps{1},p1,v100,t\\WObj:=w1;", MOVE.format("ps{1}")),
        )
    },
}


def move_modules(folder: Path, modules: dict[str, tuple[str, ...]], frame: str, turn: float) -> list[str]:
    """Return what is said of measured places; the exit code agrees with all that is said."""
    (folder / "project.toml").write_text(PROJECT.format(turn=turn))
    for name, lines in modules.items():
        taught = [TAUGHT] if name == "m" else []
        text = "\r\n".join([f"MODULE {name}", *taught, *lines, "ENDMODULE", ""]).replace("{frame}", frame)
        (folder / f"{name}.mod").write_text(text, newline="")
    report, out = folder / "report.json", folder / "out"
    words = ["move", *sorted(folder.glob("*.mod")), "--project", folder / "project.toml", "--out", out]
    code = run_command_line(["program", *map(str, words), "--offset", "20,0,0,0,0,0", "--json", str(report)])
    programs = json.loads(report.read_text())["programs"]
    points = {one["point"]: one["status"] for program in programs for one in program["points"]}
    assert points.pop("p1") == "changed"
    found = [one["text"] for program in programs for one in program["findings"]]
    assert code == (ExitCode.REFUSED if found or points else ExitCode.PASS)
    return [text for text in found if "takes where" in text]


@pytest.mark.parametrize("way", WAYS)
def test_a_place_that_is_taken_in_another_work_object_is_a_finding(way: str, tmp_path: Path) -> None:
    (finding,) = move_modules(tmp_path, WAYS[way], "w2", 35.0)
    assert "in the user frame w1" in finding
    assert "in w2" in finding


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("frame", "turn"), [("w1", 35.0), ("w2", 0.0)])
def test_a_place_that_goes_along_is_none(way: str, frame: str, turn: float, tmp_path: Path) -> None:
    """In the same work object, or in one that is only shifted, which a shift does not turn."""
    assert not move_modules(tmp_path, WAYS[way], frame, turn)


KUKA = """format = 1
name = "cell"
[robot]
serial = "S1"
model = "kuka_kr6_r900"
[tools.1.entered]
position_mm = [0, 0, 100]
[frames.2]
position_mm = [400, 100, 50]
[frames.3]
position_mm = [300, -200, 20]
fanuc_wpr_deg = [0, 0, 35]
"""


@pytest.mark.parametrize(
    ("lines", "is_finding"),
    [
        (("XH=$POS_ACT", "BAS(#BASE,3)", "LIN XH"), True),
        (("XH[2]=$POS_INT", "$BASE=BASE_DATA[3]", "LIN XH[I]"), True),
        (("XH=$POS_ACT:{X 0,Y 0,Z -50,A 0,B 0,C 0}", "XG=XH", "BAS(#BASE,3)", "LIN XG"), True),
        (("XH=$POS_ACT", "LIN XH"), False),
        (("XH=$POS_ACT", "BAS(#BASE,3)", "BAS(#BASE,2)", "LIN XH"), False),
    ],
)
def test_a_point_taken_in_another_base_is_a_finding(
    lines: tuple[str, ...], is_finding: bool, tmp_path: Path
) -> None:
    (tmp_path / "project.toml").write_text(KUKA)
    program = ("DEF A( )", "BAS(#TOOL,1)", "BAS(#BASE,2)", *lines, "END", "")
    (tmp_path / "a.src").write_text("\r\n".join(program), newline="")
    report = tmp_path / "report.json"
    words = ["move", tmp_path / "a.src", "--project", tmp_path / "project.toml", "--out", tmp_path / "out"]
    code = run_command_line(["program", *map(str, words), "--offset", "20,0,0,0,0,0", "--json", str(report)])
    (one,) = json.loads(report.read_text())["programs"]
    assert [finding["text"][:8] for finding in one["findings"]] == ["$POS_ACT"] * is_finding
    assert code == (ExitCode.REFUSED if is_finding else ExitCode.PASS)
