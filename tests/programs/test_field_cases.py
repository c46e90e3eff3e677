"""Programs as people of the field write them, which once were changed wrongly without a word."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode

CASES = Path(__file__).parents[1] / "data" / "field_cases"


@dataclass(frozen=True)
class MovedProgram:
    """One program after a move."""

    code: int
    report: dict[str, Any]
    lines: list[str]
    before: list[str]

    def report_point(self, name: str) -> dict[str, Any]:
        found: dict[str, Any] = next(one for one in self.report["points"] if one["point"] == name)
        return found

    def list_findings(self) -> list[tuple[int, str, float | None]]:
        return [(one["line"], one["point"], one["distance_mm"]) for one in self.report["findings"]]


def move_program(
    folder: Path, brand: str, file: str, *, offset: str, text: str = "", joints: str = "keep"
) -> MovedProgram:
    """Move a field case, or a text in its place; without ``joints`` the option is not given."""
    place = Path(shutil.copytree(CASES / brand, folder / brand))
    if text:
        (place / file).write_text(text)
    out, report = folder / "out", folder / "report.json"
    words = [
        "move",
        place / file,
        "--project",
        place / "project.toml",
        "--offset",
        offset,
        *(["--joints", joints] if joints else []),
    ]
    code = run_command_line(["program", *map(str, words), "--out", str(out), "--json", str(report)])
    found = json.loads(report.read_text())
    assert found["exit_code"] == code
    old, new = ((one / file).read_text().splitlines() for one in (place, out))
    return MovedProgram(code, found["programs"][0], new, old)


TURNED = "30,-20,5,0,0,30"


def test_an_array_whose_size_is_a_constant_is_read_and_moved(tmp_path: Path) -> None:
    moved = move_program(tmp_path, "abb", "array_named_dimension.mod", offset=TURNED)
    assert moved.code == ExitCode.PASS
    assert [one["status"] for one in moved.report["points"]] == ["changed"] * 3
    assert not [one for one in moved.report["remarks"] if "filled" in one["text"]]


@pytest.mark.parametrize("name", ["WObj0", "WOBJ0", "wobj0"])
def test_the_name_of_the_base_counts_in_any_case(tmp_path: Path, name: str) -> None:
    text = (CASES / "abb" / "wobj0_case.mod").read_text().replace("WObj0", name)
    moved = move_program(tmp_path, "abb", "wobj0_case.mod", offset=TURNED, text=text)
    assert moved.code == ExitCode.PASS
    assert moved.report_point("MoveL@3")["status"] == "changed"


def test_a_project_finds_a_tool_and_a_frame_in_any_case(tmp_path: Path) -> None:
    text = (CASES / "abb" / "wobj0_case.mod").read_text().replace("tool0", "TGRIP").replace("WObj0", "wTABLE")
    place = CASES / "abb" / "project.toml"
    extra = "[tools.tGrip.entered]\nposition_mm = [0, 0, 10]\n[frames.WTable]\nposition_mm = [0, 0, 0]\n"
    folder = Path(shutil.copytree(CASES / "abb", tmp_path / "line"))
    (folder / "project.toml").write_text(place.read_text() + extra)
    (folder / "wobj0_case.mod").write_text(text)
    words = ["move", folder / "wobj0_case.mod", "--project", folder / "project.toml", "--offset", TURNED]
    assert run_command_line(["program", *map(str, words), "--out", str(tmp_path / "out")]) == ExitCode.PASS


def test_a_displacement_that_does_not_turn_with_the_work_is_a_finding(tmp_path: Path) -> None:
    moved = move_program(tmp_path, "abb", "pdisp_rotated.mod", offset=TURNED)
    assert moved.code == ExitCode.REFUSED
    ((line, point, distance),) = moved.list_findings()
    assert (line, point) == (4, "p1")
    assert distance == pytest.approx(200 * np.sin(np.radians(15)), abs=0.01)
    assert moved.report["findings"][0]["angle_deg"] == pytest.approx(30.0)


def test_a_displacement_costs_nothing_where_the_work_does_not_turn(tmp_path: Path) -> None:
    moved = move_program(tmp_path, "abb", "pdisp_rotated.mod", offset="30,-20,5,0,0,0")
    assert moved.code == ExitCode.PASS
    assert not moved.list_findings()


def test_a_relative_move_is_a_finding_and_joints_are_kept(tmp_path: Path) -> None:
    moved = move_program(tmp_path, "kuka", "lin_rel_rotated.src", offset=TURNED)
    assert moved.code == ExitCode.REFUSED
    ((line, _, distance),) = moved.list_findings()
    assert line == 8
    assert distance == pytest.approx(51.76, abs=0.01)
    assert moved.lines[5] == moved.before[5]
    assert moved.report_point("LIN@7")["status"] == "changed"


def test_joints_move_where_requested_and_are_left_without_an_option(tmp_path: Path) -> None:
    moved = move_program(tmp_path, "kuka", "lin_rel_rotated.src", offset="3,-2,5,0,0,3", joints="move")
    assert moved.report_point("PTP@6")["status"] == "changed"


def test_points_without_a_posture_are_left_with_the_cure(tmp_path: Path) -> None:
    moved = move_program(tmp_path, "kuka", "no_posture.src", offset=TURNED)
    assert moved.code == ExitCode.REFUSED
    assert moved.lines == moved.before
    assert all("S and T" in one["reason"] for one in moved.report["points"])


def test_elements_that_are_set_and_poses_that_are_added_are_findings(tmp_path: Path) -> None:
    moved = move_program(tmp_path, "ur", "component_assignment.script", offset="0,0,0,0,0,90")
    assert moved.code == ExitCode.REFUSED
    lines = {line: distance for line, _, distance in moved.list_findings()}
    assert lines[5] == pytest.approx(70.71, abs=0.01)
    assert lines[7] == pytest.approx(141.42, abs=0.01)


E9 = "[9E9,9E9,9E9,9E9,9E9,9E9]"
TARGET = f"[[300,20,350],[0,0,1,0],[0,0,0,0],{E9}]"


@pytest.mark.parametrize(
    "lines",
    [
        f'PERS station s{{1}}:=[["one",{TARGET}]];',
        f"PERS pair s:=[{TARGET},{TARGET}];",
        f"CONST deep s{{1,1}}:=[[[1,{TARGET}]]];",
        f"rPick {TARGET};",
        f"CONST robtarget s:=[[nX,20,350],[0,0,1,0],[0,0,0,0],{E9}];",
        "PROC a()\nMoveL *,v100,z1,tool0;\nENDPROC",
    ],
)
def test_a_position_that_was_not_read_is_left_and_named(tmp_path: Path, lines: str) -> None:
    text = f"MODULE A\n{lines}\nPROC main()\nMoveL {TARGET},v100,z1,tool0;\nENDPROC\nENDMODULE\n"
    moved = move_program(tmp_path, "abb", "wobj0_case.mod", offset=TURNED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert moved.report["counts"]["changed"] == 1
    left_points = [one for one in moved.report["points"] if one["status"] == "left"]
    assert left_points
    assert all("not" in one["reason"] and one["reason"] != "not taught" for one in left_points)


def test_a_reason_is_true_for_a_tool_that_stands_in_the_cell(tmp_path: Path) -> None:
    frame = "[[0,0,0],[1,0,0,0]]"
    text = (
        f'MODULE A\nPERS wobjdata wHeld:=[TRUE,TRUE,"",{frame},{frame}];\n'
        f"PROC main()\nMoveL {TARGET},v100,z1,tool0\\WObj:=wHeld;\nENDPROC\nENDMODULE\n"
    )
    moved = move_program(tmp_path, "abb", "wobj0_case.mod", offset=TURNED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert "held work object" in moved.report["points"][0]["reason"]


def test_an_axis_that_goes_anywhere_leaves_every_point_that_it_carries(tmp_path: Path) -> None:
    targets = [f"[[300,20,350],[0,0,1,0],[0,0,0,0],[{rail},9E9,9E9,9E9,9E9,9E9]]" for rail in (0, 800)]
    moves = "\n".join(f"MoveL {target},v100,z1,tool0;" for target in (*targets, TARGET))
    text = f"MODULE A\nPROC main()\n{moves}\nENDPROC\nENDMODULE\n"
    moved = move_program(tmp_path, "abb", "wobj0_case.mod", offset=TURNED, text=text)
    # the rail stands somewhere for the third, too, which does not name it
    assert [one["status"] for one in moved.report["points"]] == ["left", "left", "left"]


@pytest.mark.parametrize(
    "line",
    [
        "DECL STATION S1={{PLACE {{X 1,Y 2,Z 3,A 0,B 0,C 0}},SPEED 1}}",
        "DECL FRAME F1={X 1,Y 2,Z 3,A 0,B 0,C 0}",
        "DECL FRAME F[2]\nF[1]={X 1,Y 2,Z 3,A 0,B 0,C 0}",
    ],
)
def test_a_frame_or_a_structure_of_a_data_list_is_left_and_named(tmp_path: Path, line: str) -> None:
    text = f"DEFDAT A\n{line.replace('{{', '{').replace('}}', '}')}\nENDDAT\n"
    moved = move_program(tmp_path, "kuka", "list.dat", offset=TURNED, text=text)
    assert moved.code == ExitCode.REFUSED
    assert moved.report["counts"]["left"] == 1


@pytest.mark.parametrize(
    ("line", "findings"),
    [
        ("LIN_REL {Z 100}", 0),
        ("LIN_REL {X 100} #TOOL", 0),
        ("lin_rel {x 100} #BASE", 1),
        ("LIN_REL OFFS", 1),
        ("XH.X = XH.X + 20", 1),
        ("XH.Z = XH.Z + 20", 0),
        ("XH.Z = 300", 1),
        ("LIN {X 100,Y 0,Z 0,A 0,B 0,C 0}:XP1", 1),
        ("XH={X 100,Y 0,Z 0,A 0,B 0,C 0}:XP1", 1),
        ("LIN XP1:{X 100,Y 0,Z 0,A 0,B 0,C 0}", 0),
        ("LIN NEXT_PLACE(1)", 1),
        ("DECL E6POS XN\nXN = NEXT_PLACE(1)\nLIN XN", 1),
    ],
)
def test_what_krl_shifts_is_a_finding_where_its_axes_turn(tmp_path: Path, line: str, findings: int) -> None:
    text = (CASES / "kuka" / "lin_rel_rotated.src").read_text().replace("LIN_REL {X 100}", line)
    moved = move_program(tmp_path, "kuka", "lin_rel_rotated.src", offset=TURNED, text=text)
    others = ("move", "CALL")  # XP1 itself and NEXT_PLACE are in no file
    shifts = [one for one in moved.report["findings"] if one["what"] not in others]
    assert len(shifts) == findings


@pytest.mark.parametrize(
    ("line", "findings"),
    [
        ("movel(pose_add(pick, p[0,0,0.1,0,0,0]))", 0),
        ("movel(pose_add(p[0.1,0,0,0,0,0], pick))", 1),
        ("movel(pose_sub(pick, p[0,0.1,0,0,0,0]))", 1),
        ("pick[1] += 0.02", 1),
        ("pick[2] = pick[2] - 0.02", 0),
        ("movel(pick)\n  movel(pose_add(get_actual_tcp_pose(), p[0.1,0,0,0,0,0]))", 1),
        ("movel(pick)\n  movel(pose_trans(get_actual_tcp_pose(), p[0.1,0,0,0,0,0]))", 0),
        ("movel(p[pick[0], pick[1], 0.3, pick[3], pick[4], pick[5]])", 1),
        ("speedl([0.1,0,0,0,0,0], 0.5, 1)", 1),
        ("movel(elsewhere())", 1),
        ("track_conveyor_linear(p[1,0,0,0,0,0], 500)", 1),
    ],
)
def test_what_urscript_shifts_is_a_finding_where_its_axes_turn(
    tmp_path: Path, line: str, findings: int
) -> None:
    text = (CASES / "ur" / "component_assignment.script").read_text()
    text = text.replace("pick[0] = pick[0] + 0.05", line).replace(
        "over = pose_add(pick, p[0.1,0,0,0,0,0])", ""
    )
    moved = move_program(
        tmp_path,
        "ur",
        "component_assignment.script",
        offset="0,0,0,0,0,90",
        text=text.replace("over", "pick"),
    )
    assert len(moved.list_findings()) == findings


def test_csv_and_page_tell_the_findings(tmp_path: Path) -> None:
    place = Path(shutil.copytree(CASES / "abb", tmp_path / "abb"))
    words = ["move", place / "pdisp_rotated.mod", "--project", place / "project.toml", "--offset", TURNED]
    more = ["--out", tmp_path / "out", "--csv", tmp_path / "points.csv", "--html", tmp_path / "page.html"]
    assert run_command_line(["program", *map(str, [*words, *more])]) == ExitCode.REFUSED
    for report in ("points.csv", "page.html"):
        assert "51.76 mm" in (tmp_path / report).read_text()
