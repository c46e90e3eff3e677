"""Motions to places that only a controller holds: a changed program that goes there is no PASS."""

import json
from pathlib import Path

import pytest

from cellcal.drivers.programs import absent_places
from cellcal.drivers.programs.file_declarations import MoveFrames
from cellcal.drivers.programs.spans import ProgramText
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from tests.programs.test_field_cases import CASES, move_program

SHIFTED, UNMOVED = "30,-20,5,0,0,0", "0,0,0,0,0,0"
LISTING = (CASES / "fanuc" / "offset_pr.LS").read_text()
STAYS = "the motion goes to {}, whose place no file here holds"


def fanuc(*statements: str) -> str:
    lines = ";\n".join(f"   {at}:{text} " for at, text in enumerate(statements, 3))
    return LISTING.replace("   3:L P[1] 100mm/sec CNT50 Offset,PR[3]    ", lines.removesuffix(" "))


def rapid(*lines: str) -> str:
    target = "[[400,0,400],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
    own = f"CONST robtarget p10:={target};\nVAR robtarget pOwn;"
    body = "\n".join(("MoveL p10,v100,fine,tool0\\WObj:=wobj0;", *lines))
    return f"MODULE M\n{own}\nPROC main()\n{body}\nENDPROC\nENDMODULE\n"


def yaskawa(*lines: str) -> str:
    text = (CASES / "yaskawa" / "one_point_refuses_all.JBI").read_text()
    return text.replace("NOP\n", "NOP\n" + "".join(f"{line}\n" for line in lines), 1)


@pytest.mark.parametrize(
    ("brand", "file", "text", "point"),
    [
        ("fanuc", "offset_pr.LS", fanuc("J PR[1] 100% FINE"), "PR[1]"),
        ("fanuc", "offset_pr.LS", fanuc("L PR[GP1:4:home] 100mm/sec FINE"), "PR[4]"),
        ("fanuc", "offset_pr.LS", fanuc("L PR[R[2]] 100mm/sec FINE"), "PR[R[...]]"),
        ("fanuc", "offset_pr.LS", fanuc("J PR[1:Home] 100% FINE", "L PR[1:Home] 100mm/sec FINE"), "PR[1]"),
        ("fanuc", "offset_pr.LS", fanuc("PR[1]=PR[2]", "L PR[1] 100mm/sec FINE"), "PR[1]"),
        ("fanuc", "offset_pr.LS", fanuc("PR[1,1]=R[7]", "L PR[1] 100mm/sec CNT100 COORD PTH"), "PR[1]"),
        ("fanuc", "offset_pr.LS", fanuc("L PR[R[2]] 100mm/sec FINE RTCP"), "PR[R[...]]"),
        ("fanuc", "offset_pr.LS", fanuc("L PR[1] 100mm/sec FINE VOFFSET,VR[1]"), "PR[1]"),
        ("abb", "pdisp_rotated.mod", rapid("MoveL pOther,v100,fine,tool0\\WObj:=wobj0;"), "pOther"),
        (
            "abb",
            "pdisp_rotated.mod",
            rapid("MoveL Offs(pOther,0,0,9),v100,fine,tool0\\WObj:=wobj0;"),
            "pOther",
        ),
        (
            "kuka",
            "lin_rel_rotated.src",
            (CASES / "kuka" / "lin_rel_rotated.src").read_text().replace("LIN_REL {X 100}", "LIN XELSE"),
            "XELSE",
        ),
        ("yaskawa", "one_point_refuses_all.JBI", yaskawa("MOVL P010 V=50.0"), "P010"),
        ("yaskawa", "one_point_refuses_all.JBI", yaskawa("REFP 1 P010"), "P010"),
        ("yaskawa", "one_point_refuses_all.JBI", yaskawa("MOVJ PX010 VJ=5.00"), "PX010"),
    ],
)
def test_a_motion_to_a_place_of_the_controller_is_a_finding(brand, file, text, point, tmp_path: Path):
    moved = move_program(tmp_path, brand, file, offset=SHIFTED, text=text)
    (found,) = [one for one in moved.report["findings"] if one["text"].startswith(STAYS.format(point))]
    assert moved.code == ExitCode.REFUSED
    assert "moves by 36.40 mm and turns by 0.00 deg" in found["text"]


WORK = "\\WObj:=wobj0;"


@pytest.mark.parametrize(
    ("lines", "line"),
    [
        (("MoveC p10,", f"  pOther,v100,fine,tool0{WORK}"), 7),
        (("MoveL", f"  pOther,v100,fine,tool0{WORK}"), 7),
        ((f"MoveL p10,v100,fine,tool0{WORK} MoveL pOther,v100,fine,tool0{WORK}",), 6),
        ((f"lbl: MoveL pOther,v100,fine,tool0{WORK}",), 6),
        ((f"IF diTest=1 MoveL pOther,v100,fine,tool0{WORK}",), 6),
        (("MoveL ! to pOther", f"pOther,v100,fine,tool0{WORK}"), 7),
        (("! pOther (above the door)", f"MoveL pOther,v100,fine,tool0{WORK}"), 7),
        (("! MoveL pOther", 'TPWrite "pOther (!)";', f"MoveL pOther,v100,fine,tool0{WORK}"), 8),
        (("pCopy:=pOther;", f"MoveL Offs(Offs(pOther,0,0,1),0,0,1),v100,fine,tool0{WORK}"), 7),
    ],
)
def test_a_rapid_motion_is_found_wherever_its_target_stands(lines, line, tmp_path: Path):
    moved = move_program(tmp_path, "abb", "pdisp_rotated.mod", offset=SHIFTED, text=rapid(*lines))
    found = [one for one in moved.report["findings"] if one["text"].startswith(STAYS.format("pOther"))]
    assert [one["line"] for one in found] == [line]
    assert moved.code == ExitCode.REFUSED


@pytest.mark.parametrize(
    ("component", "is_finding"),
    [("pos", False), ("pos.trans.x", True), ("via", True)],
)
def test_a_component_that_gets_a_whole_value_is_no_place_of_the_controller(
    component, is_finding, tmp_path: Path
):
    filled = f"st.{component}:=CRobT(\\Tool:=tool0\\WObj:=wobj0);"
    text = rapid(filled, f"MoveL st.pos,v100,fine,tool0{WORK}")
    moved = move_program(tmp_path, "abb", "pdisp_rotated.mod", offset=SHIFTED, text=text)
    found = [one for one in moved.report["findings"] if one["text"].startswith(STAYS.format("st"))]
    assert bool(found) is is_finding


@pytest.mark.parametrize(
    ("value", "is_finding"),
    [
        (":=[[[1200,0,800],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],1]", False),
        (":=[p10,1]", True),
        ("", True),
    ],
)
def test_a_record_whose_places_are_left_is_no_place_of_the_controller(value, is_finding, tmp_path: Path):
    text = rapid(f"MoveL st.pos,v100,fine,tool0{WORK}").replace("PROC", f"PERS station st{value};\nPROC", 1)
    moved = move_program(tmp_path, "abb", "pdisp_rotated.mod", offset=SHIFTED, text=text)
    found = [one for one in moved.report["findings"] if one["text"].startswith(STAYS.format("st"))]
    assert (bool(found), moved.code) == (is_finding, ExitCode.REFUSED)


@pytest.mark.parametrize("name", ["p\u00c4u\u00dfen", "P\u00c4"])
def test_a_rapid_motion_to_a_name_with_umlauts_is_found(name, tmp_path: Path):
    text = rapid(f"MoveL {name},v100,fine,tool0{WORK}")
    moved = move_program(tmp_path, "abb", "pdisp_rotated.mod", offset=SHIFTED, text=text)
    assert [
        one for one in moved.report["findings"] if one["text"].lower().startswith(STAYS.format(name).lower())
    ]


@pytest.mark.parametrize(
    "line", ["CIRC !, XELSE", "CIRC XELSE, XP1", "LIN XELSE ; XELSE(1)", " lin  xelse C_DIS"]
)
def test_a_krl_motion_is_found_wherever_its_target_stands(line, tmp_path: Path):
    text = (CASES / "kuka" / "lin_rel_rotated.src").read_text().replace("LIN_REL {X 100}", line)
    moved = move_program(tmp_path, "kuka", "lin_rel_rotated.src", offset=SHIFTED, text=text)
    found = [one["text"].lower().split(",")[0] for one in moved.report["findings"]]
    assert "the motion goes to xelse" in found


def test_a_krl_name_that_gets_a_value_only_is_no_motion(tmp_path: Path):
    text = (CASES / "kuka" / "lin_rel_rotated.src").read_text().replace("LIN_REL {X 100}", "IDX=MORE\nY=IDX")
    moved = move_program(tmp_path, "kuka", "lin_rel_rotated.src", offset=SHIFTED, text=text)
    assert not [one for one in moved.report["findings"] if "whose place no file here holds" in one["text"]]


@pytest.mark.parametrize(
    ("brand", "file", "text"),
    [
        ("fanuc", "offset_pr.LS", fanuc("J PR[1:Home] 100% FINE")),  # the robot's own, as KUKA's HOME
        ("fanuc", "offset_pr.LS", fanuc("PR[1]=P[1]", "L PR[1] 100mm/sec FINE")),  # goes along with P[1]
        ("fanuc", "offset_pr.LS", fanuc("PR[2]=P[1]", "PR[1]=PR[2]", "L PR[1] 100mm/sec FINE")),
        ("abb", "pdisp_rotated.mod", rapid("pOwn:=p10;", "MoveL pOwn,v100,fine,tool0\\WObj:=wobj0;")),
        ("yaskawa", "one_point_refuses_all.JBI", yaskawa("GETS PX010 $PX000", "MOVL P010 V=50.0")),
    ],
)
def test_a_place_that_the_program_fills_or_that_is_home_is_none(brand, file, text, tmp_path: Path):
    moved = move_program(tmp_path, brand, file, offset=SHIFTED, text=text)
    assert not [one for one in moved.report["findings"] if "whose place no file here holds" in one["text"]]


@pytest.mark.parametrize(
    "comment",
    ["SPARK PLUG", "Parkett", "Parkas", "homer", "Homebin", "Superchuck", "Untergrund", "Grundplatte", "ruhend",
     "Truhe", "Fr\u00e4sgrund", "Grundm\u00e4\u00dfig"],
)  # fmt: skip
def test_a_place_whose_comment_only_contains_a_word_for_home_is_a_finding(comment, tmp_path: Path):
    text = fanuc(f"J PR[1:{comment}] 100% FINE")
    moved = move_program(tmp_path, "fanuc", "offset_pr.LS", offset=SHIFTED, text=text)
    assert [one["point"] for one in moved.report["findings"]] == ["PR[1]"]
    assert moved.code == ExitCode.REFUSED


@pytest.mark.parametrize(
    "comment",
    ["HOME", "home1", "R1_HOME", "HomePos", "Home Position", "GoHome", "perch", "PERCH2", "Park", "Parkposition",
     "Grundstellung", "Grundst", "GRUNDPOS 2", "Ruhestellung", "Ruhelage"],
)  # fmt: skip
def test_a_place_whose_comment_says_home_is_none(comment, tmp_path: Path):
    text = fanuc(f"J PR[1:{comment}] 100% FINE")
    moved = move_program(tmp_path, "fanuc", "offset_pr.LS", offset=SHIFTED, text=text)
    assert moved.report["findings"] == []


@pytest.mark.parametrize(("offset", "findings"), [(SHIFTED, 0), ("0,0,0,0,0,20", 1)])
def test_a_shift_from_where_the_robot_is_is_a_finding_where_its_axes_turn(offset, findings, tmp_path: Path):
    text = fanuc("PR[51]=LPOS", "PR[52,1]=R[100]", "J PR[51] 100% CNT100 Offset,PR[52]")
    moved = move_program(tmp_path, "fanuc", "offset_pr.LS", offset=offset, text=text)
    shifts = [one for one in moved.report["findings"] if one["point"] == "PR[51]"]
    assert len(shifts) == findings


def test_a_frame_that_does_not_move_leaves_its_registers_where_they_belong(tmp_path: Path):
    moved = move_program(tmp_path, "fanuc", "offset_pr.LS", offset=UNMOVED, text=fanuc("J PR[1] 100% FINE"))
    assert (moved.code, moved.report["findings"]) == (ExitCode.PASS, [])


def test_a_clone_says_that_the_other_controller_has_its_own_registers(tmp_path: Path, capsys):
    cells = Path(__file__).parents[2] / "deploy" / "example_projects" / "door_line"
    listing = tmp_path / "TO_PR.LS"
    text = (cells / "cell_1" / "programs" / "RACK_PICK.LS").read_text()
    first = next(line for line in text.splitlines() if ":J P[" in line or ":L P[" in line)
    listing.write_text(text.replace(first, f"{first}\n   1:J PR[9] 100% FINE ;"))
    report = tmp_path / "clone.json"
    code = run_command_line(
        [
            "program", "clone", str(cells / "cell_1" / "project.toml"), str(cells / "cell_7" / "project.toml"),
            str(listing), "--out", str(tmp_path / "out"), "--json", str(report),
        ]
    )  # fmt: skip
    capsys.readouterr()
    assert code == ExitCode.REFUSED
    (program,) = json.loads(report.read_text())["programs"]
    assert any(
        "what the other robot's controller has there counts" in one["text"] for one in program["findings"]
    )


def test_many_places_of_others_are_looked_for_in_one_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[str] = []
    monkeypatch.setattr(absent_places, "_first_place", lambda *some: looked.append(some[2]))
    names = [f"XH{k}" for k in range(500)]
    text = "DEF A()\n" + "".join(f"LIN {name}\n" for name in names) + "XH7=XP1\nEND\n"
    absent = {name: frozenset([MoveFrames("1", "1")]) for name in names}
    source = ProgramText("a.src", text.encode("ascii"))
    found = list(absent_places.absent_places(source, absent, ["LIN"], comment=";", statement_end="\n"))
    assert [one.point for one in found] == sorted(set(names) - {"XH7"})
    assert found[0].line == 2
    assert not looked
