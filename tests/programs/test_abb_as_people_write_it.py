"""RAPID as people and their tools write it: commas before options, parameters, letters beyond ASCII, copies."""

import json

import numpy as np
import pytest

from cellcal.drivers.abb.program_files.programs import BRAND
from cellcal.drivers.abb.program_files.unchecked_configurations import ignores_configurations
from cellcal.drivers.programs.cross_file_uses import BatchDeclarations
from cellcal.drivers.programs.positions import CARTESIAN, UNREAD
from cellcal.service.cli.app import run_command_line

E = "[9E9,9E+09,9E+9,9E9,9E9,9E9]"
ONE = f"[[1,2,3],[1,0,0,0],[0,0,0,0],{E}]"
COMPUTED = "computed"


def read_module(*lines: str, encoding: str = "latin-1"):
    file = BRAND.read("a.mod", "\r\n".join(["MODULE Teil", *lines, "ENDMODULE"]).encode(encoding))
    assert file.to_bytes() == "\r\n".join(["MODULE Teil", *lines, "ENDMODULE"]).encode(encoding)
    return file


def declaration_lines(*names: str) -> tuple[str, ...]:
    return tuple(f"CONST robtarget {name}:={ONE};" for name in names)


@pytest.mark.parametrize(
    ("instruction", "tool", "frame"),
    [
        ("MoveL p1,v100,fine,tGrip,\\WObj:=wTable;", "tGrip", "wTable"),
        ("MoveL p1,v100,fine,tGrip, \\WObj := wTable ;", "tGrip", "wTable"),
        ("MoveJ p1,\\ID:=1,v100,z10,tGrip,\\WObj:=wTable;", "tGrip", "wTable"),
        ("MoveL p1,v100,fine,! \\WObj:=wOld\n tGrip\\WObj:=wTable;", "tGrip", "wTable"),
        ("MoveLDO p1,v100,fine,tGrip\\WObj:=wTable,doGrip,1;", "tGrip", "wTable"),
        ("MoveLDO p1,v100,fine,tGrip,\\WObj:=wTable,doGrip,1;", "tGrip", "wTable"),
        ("MoveL p1\\ID:=Sum(\\WObj:=wOther),v100,fine,tGrip;", "tGrip", "wobj0"),
        ("MoveL p1,v100,fine,tGrip\\WObj?WObj;", "tGrip", None),
        ("MoveL p1,v100,fine,tGrip\\WObj:=cell.wTable;", "tGrip", None),
        ("MoveL p1,v100,fine,tGrip\\WObj:=wAll{2};", "tGrip", None),
        ("MoveL p1,v100,fine,cell.tGrip\\WObj:=wTable;", None, "wTable"),
        ("MoveL p1,v100,fine,tAll{2};", None, "wobj0"),
        ("MoveL Offs(RelTool(p1,0,0,5),1,2,3),v100,fine,tGrip\\WObj:=wTable;", "tGrip", "wTable"),
    ],
)
def test_a_move_gives_its_target_the_tool_and_work_object_that_it_names(instruction, tool, frame):
    file = read_module(*declaration_lines("p1"), "PROC main()", instruction, "ENDPROC")
    assert (file.positions.tools, file.positions.user_frames) == ((tool,), (frame,))
    assert (0 in file.positions.barred) == (tool is None or frame is None)


@pytest.mark.parametrize(
    "parameters",
    [
        "PERS tooldata tGrip\\PERS wobjdata WObj",
        "VAR robtarget pGiven,\r\n  PERS tooldata tGrip ! the gripper\r\n"
        "  \\PERS wobjdata WObj\r\n  \\switch Slow | switch Fast",
    ],
)
def test_a_tool_that_a_routine_is_given_is_not_the_modules(parameters):
    file = read_module(
        "PERS tooldata tGrip:=[TRUE,[[0,0,180],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];",
        *declaration_lines("p1", "p2"),
        f"PROC rGo({parameters})",
        "MoveL p1,v100,fine,tGrip\\WObj:=wTable;",
        "ENDPROC",
        "PROC main()",
        "MoveL p2,v100,fine,tGrip\\WObj:=wTable;",
        "ENDPROC",
    )
    assert file.positions.names == ("p1", "p2")
    assert file.positions.tools == (None, "tGrip")
    assert COMPUTED in file.positions.barred[0]
    assert 1 not in file.positions.barred


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8"])
def test_names_may_hold_any_letter(encoding):
    file = read_module(
        *declaration_lines("pGreifzüge", "pGreifzug"),
        "PROC Größe()",
        "MoveL PGREIFZüGE,v100,fine,tSäge\\WObj:=wTür;",
        "ENDPROC",
        encoding=encoding,
    )
    assert file.positions.names == ("pGreifzüge", "pGreifzug")
    assert (file.positions.tools, file.positions.user_frames) == (("tSäge", None), ("wTür", None))


def test_a_byte_order_mark_is_no_letter():
    data = "\r\n".join(["\ufeffMODULE Teil", *declaration_lines("p1"), "ENDMODULE"]).encode()
    file = BRAND.read("a.mod", data)
    assert (file.name, file.positions.names, file.to_bytes()) == ("Teil", ("p1",), data)


def test_elements_that_are_names_or_sums_are_remarked_and_the_numbers_beside_them_read():
    file = read_module(
        *declaration_lines("p1"),
        f"VAR robtarget pts{{3}}:=[p1,{ONE},[[1,2,h*(3+4)],[1,0,0,0],[0,0,0,0],{E}]];",
        "VAR robtarget pAll{3}:=pts;",
        "PROC main()",
        "MoveL pts{2},v100,fine,tGrip\\WObj:=wTable;",
        "ENDPROC",
    )
    assert file.positions.names == ("p1", "pts{2}", "pts{3}")
    assert file.positions.kinds == (CARTESIAN, CARTESIAN, UNREAD)
    assert file.positions.user_frames == (None, "wTable", None)
    assert [remark.code for remark in file.remarks] == ["computed"] * 3
    assert "copies" in file.positions.barred[0]  # no instruction moves to p1 itself


@pytest.mark.parametrize(
    ("copied_in", "barred"), [("wOne", False), ("wTwo", True)], ids=["same frame", "another"]
)
def test_a_move_to_a_copy_counts_for_the_target_itself(copied_in, barred):
    file = read_module(
        *declaration_lines("p1", "p2"),
        "PROC a()",
        "VAR robtarget pTmp;",
        "pTmp:=p1;",
        f"MoveL Offs(pTmp,0,0,50),v100,fine,tG\\WObj:={copied_in};",
        "MoveL p1,v100,fine,tG\\WObj:=wOne;",
        "ENDPROC",
        "PROC b()",
        "VAR robtarget pTmp;",
        "pTmp:=p2;",
        "MoveL pTmp,v100,fine,tG\\WObj:=wThree;",
        "MoveL p2,v100,fine,tG\\WObj:=wThree;",
        "ENDPROC",
    )
    rows = [k for k, kind in enumerate(file.positions.kinds) if kind == CARTESIAN]
    assert [file.positions.names[k] for k in rows] == ["p1", "p2"]
    assert [k in file.positions.barred for k in rows] == [barred, False]


def test_a_copy_in_another_module_counts_too():
    data = "\r\n".join(["MODULE Data", *declaration_lines("p1"), "ENDMODULE"]).encode()
    main = [
        "MODULE Main", "PROC main()", "pTmp:=p1;", "MoveL pTmp,v100,fine,tG\\WObj:=wTwo;",
        "MoveL p1,v100,fine,tG\\WObj:=wOne;", "ENDPROC", "ENDMODULE",
    ]  # fmt: skip
    data_module = BRAND.read("data.mod", data)
    across = BatchDeclarations(
        {
            "data.mod": data_module.declarations,
            "main.mod": BRAND.read("main.mod", "\n".join(main).encode()).declarations,
        }
    )
    assert "different" in data_module.with_external_uses(across.uses_of_file("data.mod")).positions.barred[0]


def test_tools_of_one_name_that_differ_are_used_by_no_module():
    def tool_line(height: int) -> str:
        return f"LOCAL PERS tooldata tGrip:=[TRUE,[[0,0,{height}],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];"

    def module_lines(name: str, height: int) -> list[str]:
        moved = f"MoveL p{name},v100,fine,tGrip\\WObj:=wobj0;"
        return [
            f"MODULE {name}",
            tool_line(height),
            *declaration_lines(f"p{name}"),
            "PROC r()",
            moved,
            "ENDPROC",
            "ENDMODULE",
        ]

    for second, barred in ((180, set()), (181, {0, 1})):
        data = "\r\n".join([*module_lines("A", 180), *module_lines("B", second)]).encode()
        file = BRAND.read("a.mod", data)
        assert set(file.positions.barred) == barred
        assert ("tGrip" in file.frames.flange_tip) == (not barred)
    assert "several tools" in file.positions.barred[0]


def test_numbers_are_where_they_were():
    file = read_module(
        "VAR robtarget pts{2}:=[p9,[[10,20,30],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]];"
    )
    assert np.allclose(file.positions.frame_tip[0, :3, 3], (0.01, 0.02, 0.03))


TURNED_OFF = "ConfL \\Off;\nConfJ \\Off;\n"
SAME_POSTURE = (
    "MoveL [[400,{},500],[0,0,1,0],[{},0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0\\WObj:=wobj0;"
)


@pytest.mark.parametrize(
    ("before", "posture", "statuses"),
    [
        (TURNED_OFF, True, ["changed"] * 2),  # -3 is no quarter of axis 1 here, and is not looked at
        (TURNED_OFF, False, ["left"] * 2),
        ("ConfL \\Off;\n", True, ["left", "changed"]),  # ConfJ still counts for MoveJ
        ("", True, ["left", "changed"]),
        (f"{TURNED_OFF}ConfL \\On;\n", True, ["left", "changed"]),
        ("! ConfL \\Off;\n! ConfJ \\Off;\n", True, ["left", "changed"]),
    ],
)
def test_configurations_that_are_switched_off_do_not_count(before, posture, statuses, tmp_path):
    start = "starting_posture_deg = [0, 0, 0, 0, 30, 0]\n" if posture else ""
    project = tmp_path / "project.toml"
    project.write_text(
        'format = 1\nname = "cell"\n[robot]\nserial = "A1"\nmodel = "abb_irb120"\nsmallest_sigma = 0.001\n'
        + start
    )
    moves = "\n".join((SAME_POSTURE.format(20, -3).replace("MoveL", "MoveJ"), SAME_POSTURE.format(40, 0)))
    module = tmp_path / "M.mod"
    module.write_text(f"MODULE M\nPROC main()\n{before}{moves}\nENDPROC\nENDMODULE\n")
    report = tmp_path / "report.json"
    words = ["move", module, "--project", project, "--offset", "10,0,0,0,0,0", "--out", tmp_path / "out"]
    run_command_line(["program", *map(str, words), "--json", str(report)])
    (program,) = json.loads(report.read_text())["programs"]
    assert [one["status"] for one in program["points"]] == statuses
    if statuses[0] == "changed":
        assert "[410.000,20,500],[0,0,1,0],[-3,0,0,0]" in (tmp_path / "out" / "M.mod").read_text()


def routine(name, *lines):
    return "\n".join((f"PROC {name}()", *lines, "ENDPROC", ""))


OFF = ("ConfL\\Off;", "ConfJ\\Off;")
MOVE = "MoveL p1,v100,fine,tool0;"
PICK = routine("rPick", "MoveJ p9,v100,fine,tool0;")


@pytest.mark.parametrize(
    ("routines", "ignored"),
    [
        (routine("main", *OFF, MOVE), True),
        (routine("main", "nCount:=0;", *OFF, "rPick;", MOVE) + PICK, True),
        (routine("main", "rInit;", *OFF, MOVE) + routine("rInit", "nCount:=0;"), True),
        (routine("main", "IF diTest=1 THEN", "nCount:=1;", "ENDIF", *OFF, MOVE), True),
        (routine("main", "IF diTest=1 nCount:=1;", "ConfL\\Off; ConfJ \\Off;", MOVE), True),
        (routine("main", "! rPick;", 'TPWrite "MoveL rPick; ENDPROC";', *OFF, MOVE) + PICK, True),
        (routine("main", "rPick;") + routine("rPick", *OFF, MOVE), True),
        (routine("main", "IF diTest=1 THEN", *OFF, "ENDIF", MOVE), False),
        (routine("main", "IF diTest=1 THEN", "ELSE", *OFF, "ENDIF", MOVE), False),
        (routine("main", "IF diTest=1 ConfL\\Off;", "ConfJ\\Off;", MOVE), False),
        (routine("main", "IF diTest=1", "ConfL\\Off;", "ConfJ\\Off;", MOVE), False),
        (routine("main", "TEST n", "CASE 1:", *OFF, "ENDTEST", MOVE), False),
        (routine("main", "FOR i FROM 1 TO n DO", *OFF, "ENDFOR", MOVE), False),
        (routine("main", "WHILE n>0 DO", *OFF, "ENDWHILE", MOVE), False),
        (routine("main", "GOTO over;", *OFF, "over:", MOVE), False),
        (routine("main", MOVE, "ERROR", *OFF, "RETRY;"), False),
        (routine("main", "rPick;", *OFF, MOVE) + PICK, False),
        (routine("main", "IF diTest=1 rPick;", *OFF, MOVE) + PICK, False),
        (routine("main", "rAll;", *OFF, MOVE) + routine("rAll", "RPICK;") + PICK, False),
        (routine("main", "%stName%;", *OFF, MOVE) + PICK, False),
        (routine("main", "CallByVar stName,1;", *OFF, MOVE) + PICK, False),
        (routine("main", MOVE, *OFF, MOVE), False),
        (routine("main", "lbl: " + MOVE, *OFF, MOVE), False),
        (routine("main", "IF diTest=1 " + MOVE, *OFF, MOVE), False),
        (routine("main", *OFF, MOVE, "IF diTest=1 ConfL\\On;", MOVE), False),
        (routine("main", *OFF, MOVE, "ConfL;", MOVE), False),
        (routine("rOne", *OFF, MOVE) + PICK.replace("PROC", "TRAP"), False),
        (routine("main", *OFF), False),
    ],
)
def test_configurations_count_unless_the_checks_are_surely_off_before_every_move(routines, ignored):
    assert ignores_configurations(f"MODULE M\n{routines}ENDMODULE\n") is ignored


@pytest.mark.parametrize("value", ["9E9", "9.0E9", "9E+09", "9000000000", "8.99999E+09", "1E+10", "1e10"])
def test_an_axis_that_is_not_there_is_read_however_it_is_written(value):
    target = ONE.replace(E, f"[{','.join([value] * 6)}]")
    positions = read_module(f"CONST robtarget p1:={target};").positions
    assert positions.kinds == (CARTESIAN,)
    assert not positions.external.size


@pytest.mark.parametrize(
    "line", ["p1.robconf.cf1:=1;", "p1.robconf:=p2.robconf;", "p1.extax.eax_a:=100;", "p1.extax := p2.extax;"]
)
def test_a_target_whose_posture_or_axes_the_program_sets_is_left(line):
    moves = ("MoveL p1,v100,fine,tGrip\\WObj:=wTable;", "MoveL p2,v100,fine,tGrip\\WObj:=wTable;")
    barred = read_module(
        *declaration_lines("p1", "p2"), "PROC main()", line, *moves, "ENDPROC"
    ).positions.barred
    assert list(barred.items()) == [(0, "the program sets a component of it while it runs")]


@pytest.mark.parametrize(("work_object", "left"), [("wTable", 0), ("wTwo", 1)])
def test_what_a_function_makes_of_a_target_counts_where_moves_go_to_it(work_object, left):
    file = read_module(
        *declaration_lines("p1"),
        "VAR robtarget pTmp;",
        "VAR robtarget pNext;",
        "PROC main()",
        "MoveL p1,v100,fine,tGrip\\WObj:=wTable;",
        "pTmp := Above(p1, 50);",
        "pNext := pTmp;",
        f"MoveL pNext,v100,fine,tGrip\\WObj:={work_object};",
        "ENDPROC",
    )
    assert len([row for row in file.positions.barred if row == 0]) == left


def test_a_copy_that_a_routine_copies_again_counts_for_the_target():
    file = read_module(
        *declaration_lines("p1"),
        "VAR robtarget pTmp;",
        "PROC main()",
        "MoveL p1,v100,fine,tGrip\\WObj:=wTable;",
        "pTmp := p1;",
        "Back pTmp;",
        "ENDPROC",
        "PROC Back(robtarget p)",
        "VAR robtarget pBack;",
        "pBack := p;",
        "pBack.trans.x := pBack.trans.x-15;",
        "MoveL pBack,v100,fine,tGrip\\WObj:=wTwo;",
        "ENDPROC",
    )
    assert 0 in file.positions.barred


def test_a_displacement_shifts_the_copy_that_a_move_goes_to():
    file = read_module(
        *declaration_lines("p1"),
        "VAR robtarget pTmp;",
        "PROC main()",
        "MoveL p1,v100,fine,tGrip\\WObj:=wTable;",
        "pTmp := p1;",
        "PDispSet [[0,0,39],[1,0,0,0]];",
        "MoveL pTmp,v100,fine,tGrip\\WObj:=wTable;",
        "PDispOff;",
        "ENDPROC",
    )
    assert [(one.what, one.point, one.user_frame) for one in file.positions.shifts] == [
        ("PDispSet", "pTmp", "wTable")
    ]
