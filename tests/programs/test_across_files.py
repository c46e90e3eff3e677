"""What programs given together say of each other's positions.

KUKA's data lists and ABB's modules declare what others move to; FANUC's programs choose frames for those they call.
"""

from pathlib import Path

import pytest

from cellcal.drivers.programs.barred import COMPUTED
from cellcal.service.engineering.programs.batches import read_batches
from cellcal.service.engineering.programs.files import find_programs

POINT = "{X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2}"
FRAME_DATA = 'DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " "}'
TARGET = "[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
USED = ("BAS(#TOOL,1)", "BAS(#BASE,4)", "LIN P1")
WORK_OBJECT = 'PERS wobjdata w1:=[{},TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];'


def dat_file(name, *lines, public=""):
    return "\r\n".join([f"DEFDAT {name} {public}", *lines, "ENDDAT", ""])


def src_file(name, *lines):
    return "\r\n".join([f"DEF {name} ( )", *lines, "END", ""])


def rapid_module(name, *lines):
    return "\r\n".join([f"MODULE {name}", *lines, "ENDMODULE", ""])


def move_lines(*lines):
    return "\r\n".join(["PROC r()", *lines, "ENDPROC"])


def read_programs(folder: Path, files, damaged=""):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, newline="")
    refused = []
    found = {
        one.source.place.as_posix(): one.program
        for some in read_batches(find_programs([str(folder)]).sources, lambda _: None, refused)
        for one in some
    }
    assert {Path(one.file).name for one in refused} <= {damaged}
    return found


def frames_of_position(program, name):
    """Return tool and frame of a position, or why it is left."""
    positions = program.positions
    row = positions.names.index(name)
    return positions.barred.get(row) or (positions.tools[row], positions.user_frames[row])


SHOWN = dat_file("A", f"DECL GLOBAL E6POS P1={POINT}", public="PUBLIC")
OWN = dat_file("A", f"DECL E6POS P1={POINT}")
TAKEN = "IMPORT E6POS Q IS /R1/A..P1"


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"a.dat": OWN, "a.src": src_file("A", *USED)}, ("1", "4")),
        ({"a.dat": OWN, "b.src": src_file("B", *USED)}, (None, None)),  # not GLOBAL
        ({"a.dat": SHOWN, "b.src": src_file("B", *USED)}, ("1", "4")),
        (
            {"a.dat": SHOWN, "b.dat": dat_file("B", f"DECL E6POS P1={POINT}"), "b.src": src_file("B", *USED)},
            (None, None),
        ),
        ({"a.dat": SHOWN, "b.src": src_file("B", "DECL E6POS P1", *USED)}, (None, None)),  # hidden by its own
        ({"a.dat": SHOWN, "b.src": src_file("B", *USED), "c.src": src_file("C", *USED)}, ("1", "4")),
        (
            {
                "a.dat": SHOWN,
                "b.src": src_file("B", *USED),
                "c.src": src_file("C", "BAS(#TOOL,1)", "BAS(#BASE,5)", "LIN P1"),
            },
            "different tools or frames, in b.src, c.src",
        ),
        (
            {
                "a.dat": OWN,
                "a.src": src_file("A", *USED[:2], "GRIP()", "LIN P1"),
                "g.src": src_file("GRIP", "BAS(#BASE,7)"),
            },
            "GRIP in g.src",
        ),
        (
            {
                "a.dat": OWN,
                "a.src": src_file("A", *USED[:2], "GRIP()", "LIN P1"),
                "g.src": src_file("GRIP", "BAS(#BASE,4)"),
            },
            ("1", "4"),
        ),
        (
            {"a.dat": OWN, "a.src": src_file("A", "LIN P1"), "m.src": src_file("M", "BAS(#BASE,7)", "A()")},
            "M in m.src",
        ),
        (
            {
                "a.dat": OWN,
                "a.src": src_file("A", *USED[:2], "INTERRUPT DECL 3 WHEN $IN[1] DO STOPP()", "LIN P1"),
                "s.src": src_file("STOPP", "$BASE=BASE_DATA[9]"),
            },
            "STOPP in s.src",
        ),
        (
            {
                "a.dat": OWN,
                "a.src": src_file("A", *USED),
                "m.src": src_file("M", "INTERRUPT DECL 3 WHEN $IN[1] DO STOPP()", "A()"),
                "s.src": src_file("STOPP", "$BASE=BASE_DATA[9]"),
            },
            "STOPP in s.src",
        ),
        ({"a.dat": OWN, "a.src": src_file("A", *USED[:2], "P2=P1", "LIN P2")}, "only the copy"),
        (
            {
                "a.dat": OWN,
                "a.src": src_file("A", "BAS(#TOOL,1)", "IF $IN[1] THEN", "BAS(#BASE,4)", "ENDIF", "LIN P1"),
            },
            "in a branch",
        ),
        (
            {"a.dat": OWN, "a.src": src_file("A", "BAS(#TOOL,1)", "IF $IN[1] THEN", *USED[1:], "ENDIF")},
            ("1", "4"),
        ),
        (
            {
                "a.dat": OWN,
                "a.src": src_file(
                    "A", "SPLINE WITH $BASE=BASE_DATA[2],$TOOL=TOOL_DATA[1]", "SPL P1", "ENDSPLINE"
                ),
            },
            "while the program runs",
        ),
        (
            {
                "one/a.dat": OWN,
                "one/a.src": src_file("A", *USED),
                "two/a.dat": OWN,
                "two/a.src": src_file("A", "BAS(#BASE,5)"),
            },
            ("1", "4"),
        ),
        (
            {"$config.dat": dat_file("$CONFIG", f"DECL E6POS P1={POINT}"), "b.src": src_file("B", *USED)},
            ("1", "4"),
        ),
        (
            {"a.dat": OWN, "b.dat": dat_file("B", TAKEN), "b.src": src_file("B", *USED[:2], "LIN Q")},
            ("1", "4"),
        ),
        ({"a.dat": OWN, "b.src": src_file("B", TAKEN, *USED[:2], "LIN Q")}, ("1", "4")),
        (
            {"a.dat": OWN, "b.dat": dat_file("B", TAKEN), "b.src": src_file("B", *USED)},
            (None, None),
        ),  # its own P1
        (
            {
                "a.dat": dat_file("A", f"DECL E6POS XP1={POINT}", FRAME_DATA),
                "b.dat": dat_file("B", TAKEN.replace("..P1", "..XP1")),
                "b.src": src_file("B", *USED[:2], "LIN Q"),
            },
            "it was taught with another tool or frame than b.src",
        ),
    ],
)
def test_a_kuka_point_has_the_tool_and_base_that_all_files_agree_on(tmp_path, files, expected):
    first = next(iter(files))
    found = frames_of_position(
        read_programs(tmp_path, files)[first], "XP1" if "XP1" in files[first] else "P1"
    )
    if isinstance(expected, str):
        assert isinstance(found, str)
        assert expected in found
    else:
        assert found == expected


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (("BAS(#BASE,5)", "FDAT_ACT=FP1", "BAS(#PTP_PARAMS,100)", "PTP XP1"), ""),
        (("SLIN XP1 WITH $TOOL=STOOL2(FP1),$BASE=SBASE(FP1.BASE_NO)",), ""),
        (("BAS(#BASE,5)", "BAS(#TOOL,1)", "LIN XP1"), "a.src moves there"),
        (("SLIN XP1 WITH $BASE=BASE_DATA[5]",), "while the program runs"),
        (("XH=XP1", "XH.Z=XH.Z+50", "$BASE=BASE_DATA[5]", "LIN XH"), "a.src sets where it moves to a copy"),
        (("XH=XP1", "QUEUE[1]=XH", "BAS(#CP_PARAMS,2)", "BAS(#BASE,5)", "LIN QUEUE[i]"), "copy"),
        (("XH=XP1", "XH.Z=XH.Z+50", "BAS(#CP_PARAMS,2)", "BAS(#BASE,2)", "LIN XH"), ""),
        (("XH=XP1", "BAS(#BASE,5)", "LIN XP2"), ""),
    ],
)
def test_a_kuka_point_with_frame_data_is_left_where_it_is_moved_to_otherwise(tmp_path, lines, words):
    files = {"a.dat": dat_file("A", f"DECL E6POS XP1={POINT}", FRAME_DATA), "a.src": src_file("A", *lines)}
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1")
    assert (words in found) if words else (found == ("1", "2"))


LISTED = "DECL {}FDAT {}={{TOOL_NO {},BASE_NO {},IPO_FRAME #BASE}}"
WITH_DATA = ("FDAT_ACT={}", "BAS(#CP_PARAMS,2)", "LIN XGLOB")
OF_A = (f"DECL GLOBAL E6POS XGLOB={POINT}", LISTED.format("", "FP1", 1, 1))
MOVES_WITH_FP1 = src_file("B", *WITH_DATA).format("FP1")
MOVES_WITH_ITS_OWN = src_file("B", *WITH_DATA).format("FGLOB")


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"b.dat": dat_file("B", LISTED.format("", "FP1", 2, 2)), "b.src": MOVES_WITH_FP1}, COMPUTED),
        ({"b.dat": dat_file("B"), "b.src": MOVES_WITH_FP1}, COMPUTED),  # the data of a.dat are not GLOBAL
        ({"b.dat": dat_file("B", LISTED.format("", "FGLOB", 2, 2)), "b.src": MOVES_WITH_ITS_OWN}, COMPUTED),
        ({"a.src": src_file("A", *WITH_DATA).format("FP1")}, ("1", "1")),
        (
            {
                "a.dat": dat_file("A", OF_A[0], LISTED.format("GLOBAL ", "FP1", 1, 1), public="PUBLIC"),
                "b.src": MOVES_WITH_FP1,
            },
            ("1", "1"),
        ),
        (
            {
                "a.dat": dat_file("A", OF_A[0], LISTED.format("GLOBAL ", "FGLOB", 1, 1), public="PUBLIC"),
                "b.src": MOVES_WITH_ITS_OWN,
            },
            ("1", "1"),
        ),
    ],
)
def test_frame_data_are_those_of_the_moving_files_own_list(tmp_path, files, expected):
    files = {"a.dat": dat_file("A", *OF_A, public="PUBLIC"), **files}
    programs = read_programs(tmp_path, files)
    assert frames_of_position(programs["a.dat"], "XGLOB") == expected
    assert not [one for each in programs.values() for one in each.positions.shifts]


BAS_SRC = """DEF BAS (COMMAND :IN,REAL_PAR :IN )
SWITCH COMMAND
CASE #BASE
  BASE (REAL_PAR )
CASE #INITMOV
  BASE (0 )
  $TOOL=TOOL_DATA[1]
ENDSWITCH
END
DEF BASE (BASE_NO :IN )
$BASE=BASE_DATA[BASE_NO]
END
"""


@pytest.mark.parametrize(
    ("lines", "others", "words"),
    [
        (USED, {"bas.src": BAS_SRC}, ""),  # what the controller's own commands do is known
        (("P1=FOUND", *USED), {}, "another value"),
        (("P1.Z=P1.Z+5", *USED), {}, "another value"),
        (("P1={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0}:SHIFT", *USED), {}, "another value"),
        (("P1={Z 3.0}", *USED), {}, "another value"),
        (("P2=P1", *USED), {}, ""),
        (("N=N+1", "FLAG=TRUE", "KIND=#GOOD", *USED), {}, ""),
        (USED, {"c.src": src_file("C", "P1=FOUND")}, ""),  # its own P1: this one is not GLOBAL
        (USED, {"c.src": src_file("C", "BASE_DATA[4]=FOUND")}, "while the program runs"),
        (USED, {"c.src": src_file("C", "BASE_DATA[3]=FOUND", "BASE_DATA[N]=FOUND")}, ""),
        (USED, {"two/c.src": src_file("C", "BASE_DATA[4]=FOUND")}, "while the program runs"),
        ((*USED, "BASE_DATA[4]=FOUND"), {}, "while the program runs"),
        ((*USED[:2], "SUB()", USED[2]), {"s.src": src_file("SUB", "BAS (#INITMOV,0 )")}, "SUB in s.src"),
        ((*USED[:2], "SUB()", USED[2]), {"s.src": src_file("SUB", "BAS (#INITMOV,0 )", "BAS(#BASE,4)", "BAS(#TOOL,1)")},
         "SUB in s.src"),
        (("BAS (#INITMOV,0 )", *USED), {"m.src": src_file("M", "BAS (#INITMOV,0 )", "A()")}, ""),
    ],
)  # fmt: skip
def test_a_kuka_point_is_left_where_it_or_its_base_gets_another_value(tmp_path, lines, others, words):
    files = {"a.dat": OWN, "a.src": src_file("A", *lines), **others}
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "P1")
    assert (words in found) if words else (found == ("1", "4"))


@pytest.mark.parametrize(
    ("folder", "setter", "is_left"),
    [
        ("sub/", "main.src", True),
        ("cell/KRC/R1/Program/", "cell/KRC/R1/System/main.src", True),
        ("one/KRC/R1/Program/", "two/KRC/R1/System/main.src", False),
        ("sub/", "other/main.src", False),
    ],
)
def test_a_kuka_base_that_a_program_sets_counts_below_its_controllers_folder(
    tmp_path, folder, setter, is_left
):
    moved = src_file("M", "BASE_DATA[4].z=BASE_DATA[4].z + 155")
    files = {f"{folder}a.dat": OWN, f"{folder}a.src": src_file("A", *USED), setter: moved}
    found = frames_of_position(read_programs(tmp_path, files)[f"{folder}a.dat"], "P1")
    assert ("while the program runs" in found) if is_left else (found == ("1", "4"))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("XP1=XP2", "another value"),
        ("XP1.X=XP1.X+N", "another value"),
        ("BASE_DATA[2]=FOUND", "while the program runs"),
        ("TOOL_DATA[N]=FOUND", "while the program runs"),
        ("BASE_DATA[3]=FOUND", ""),
        ("$H_POS=XP1", ""),
    ],
)
def test_a_kuka_point_with_frame_data_is_left_where_its_program_sets_it_or_its_base(tmp_path, line, words):
    taught = ("FDAT_ACT=FP1", "BAS(#PTP_PARAMS,100)", "PTP XP1")
    files = {
        "a.dat": dat_file("A", f"DECL E6POS XP1={POINT}", FRAME_DATA),
        "a.src": src_file("A", line, *taught),
    }
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1")
    assert (words in found) if words else (found == ("1", "2"))


def test_the_last_of_very_many_moves_counts(tmp_path):
    often = ["LIN P1"] * 1200
    many = [f"DEF R{k} ( )\r\nBAS(#TOOL,1)\r\nBAS(#BASE,4)\r\nLIN P1\r\nEND" for k in range(1200)]
    last = "DEF Z ( )\r\nBAS(#TOOL,1)\r\nBAS(#BASE,5)\r\nLIN P1\r\nEND"
    for name, texts in (
        ("often", [src_file("A", *USED[:2], *often)]),
        ("many", [src_file("A", *USED), *many]),
    ):
        files = {"a.dat": OWN, "a.src": "\r\n".join([*texts, last])}
        (tmp_path / name).mkdir()
        assert isinstance(frames_of_position(read_programs(tmp_path / name, files)["a.dat"], "P1"), str)


ABB = rapid_module("A", f"CONST robtarget p1:={TARGET};")
AT_W2 = "MoveL p1,v100,fine,tool1\\WObj:=w2;"


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"a.mod": ABB, "b.mod": rapid_module("B", move_lines(AT_W2))}, ("tool1", "w2")),
        (
            {"a.mod": ABB, "b.mod": rapid_module("B", move_lines(AT_W2.replace("p1", "Offs(p1,0,0,9)")))},
            ("tool1", "w2"),
        ),
        (
            {"a.mod": ABB.replace("CONST", "LOCAL CONST"), "b.mod": rapid_module("B", move_lines(AT_W2))},
            (None, None),
        ),
        ({"a.mod": ABB, "b.mod": rapid_module("B", "PROC go(robtarget p1)", AT_W2, "ENDPROC")}, (None, None)),
        ({"a.mod": ABB, "b.mod": rapid_module("B", move_lines("VAR robtarget p1;", AT_W2))}, (None, None)),
        (
            {
                "a.mod": rapid_module("A", f"CONST robtarget p1:={TARGET};", move_lines(AT_W2)),
                "b.mod": rapid_module("B", move_lines(AT_W2.replace("w2", "w1"))),
            },
            "different tools or frames, in a.mod, b.mod",
        ),
        (
            {
                "a.mod": ABB,
                "b.mod": rapid_module("B", move_lines(AT_W2.replace("w2", "w1"))),
                "c.sys": rapid_module("C", WORK_OBJECT.format("TRUE")),
            },
            "held work object",
        ),
        (
            {
                "a.mod": ABB,
                "b.mod": rapid_module("B", move_lines(AT_W2.replace("w2", "w1"))),
                "c.sys": rapid_module("C", WORK_OBJECT.format("FALSE"), move_lines("w1.uframe.trans.x:=5;")),
            },
            "set while the program runs",
        ),
        ({"a.mod": ABB, "b.mod": rapid_module("B", move_lines("pApp:=Offs(p1,0,0,100);"))}, "only the copy"),
    ],
)
def test_an_abb_target_has_the_tool_and_work_object_that_all_modules_agree_on(tmp_path, files, expected):
    found = frames_of_position(read_programs(tmp_path, files)["a.mod"], "p1")
    if isinstance(expected, str):
        assert isinstance(found, str)
        assert expected in found
    else:
        assert found == expected


TOOL = "PERS tooldata tool1:=[TRUE,[[0,0,{}],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];"
BASE = 'PERS wobjdata W2:=[FALSE,TRUE,"",[[{},0,0],[1,0,0,0]],[[0,7,0],[1,0,0,0]]];'


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"c.sys": rapid_module("C", TOOL.format(5), BASE.format(40))}, ([0, 0, 5], [40, 7, 0])),
        ({"c.sys": rapid_module("C", "LOCAL " + TOOL.format(5), BASE.format(40))}, (None, [40, 7, 0])),
        (
            {"c.sys": rapid_module("C", move_lines(TOOL.format(5)), BASE.format(40))},
            (None, [40, 7, 0]),
        ),  # a routine's own
        (
            {"c.sys": rapid_module("C", TOOL.format(5)), "d.sys": rapid_module("D", TOOL.format(5))},
            ([0, 0, 5], None),
        ),
        (
            {"c.sys": rapid_module("C", TOOL.format(5)), "d.sys": rapid_module("D", TOOL.format(6))},
            (None, None),
        ),
        (
            {"c.sys": rapid_module("C", TOOL.format(5)), "other/d.sys": rapid_module("D", TOOL.format(6))},
            ([0, 0, 5], None),
        ),
        ({"c.sys": rapid_module("C", BASE.format("GetX()"), TOOL.format(5))}, ([0, 0, 5], None)),
    ],
)
def test_an_abb_module_has_the_tools_and_work_objects_that_others_declare(tmp_path, files, expected):
    used = {"cell/a.mod": rapid_module("A", f"CONST robtarget p1:={TARGET};", move_lines(AT_W2))}
    frames = read_programs(tmp_path, used | {f"cell/{name}": text for name, text in files.items()})[
        "cell/a.mod"
    ].frames
    poses = frames.cell_flange_tip.get("tool1"), frames.cell_base_frame.get("w2")
    assert [None if pose is None else [round(1e3 * x, 6) for x in pose.position_m] for pose in poses] == list(
        expected
    )


def config_file(base_x, *lines):
    tables = (
        "TOOL_DATA[1]={X 0,Y 0,Z 150,A 0,B 0,C 0}",
        f"BASE_DATA[4]={{X {base_x},Y 0,Z 0,A 0,B 0,C 0}}",
        *lines,
    )
    return dat_file("$CONFIG", *tables)


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"r1/System/$config.dat": config_file(700)}, 700),
        ({"r1/System/$config.dat": config_file(700), "r2/System/$config.dat": config_file(800)}, 700),
        ({"System/$config.dat": config_file(700), "Mada/$config.dat": config_file(800)}, None),
        (
            {"$config.dat": config_file(900, "DECL E6AXIS XP1={X 1,Y 2,Z 3,A 0,B 0,C 0}")},
            None,
        ),  # refused, and not believed
        ({}, None),
    ],
)
def test_a_kuka_program_stands_in_the_bases_of_its_own_controllers_configuration(tmp_path, files, expected):
    used = {"r1/Program/a.dat": OWN, "r1/Program/a.src": src_file("A", *USED)}
    frames = read_programs(tmp_path, used | files, damaged="$config.dat")["r1/Program/a.dat"].frames
    base = frames.cell_base_frame.get("4")
    assert (base and round(1e3 * base.position_m[0], 6)) == expected
    assert ("1" in frames.cell_flange_tip) == ("$config.dat" not in files and bool(files))


def test_an_array_of_another_module_is_used_as_a_whole_where_its_index_is_computed(tmp_path):
    array = rapid_module("A", f"CONST robtarget p{{2}}:=[{TARGET},{TARGET}];")
    move = move_lines("MoveL p{i},v100,fine,tool1\\WObj:=w2;")
    found = read_programs(tmp_path, {"a.mod": array, "b.mod": rapid_module("B", move)})["a.mod"]
    assert frames_of_position(found, "p{1}") == frames_of_position(found, "p{2}") == ("tool1", "w2")


@pytest.mark.parametrize(("name", "text"), [("a.mod", ABB), ("a.dat", SHOWN)])
def test_a_position_that_missing_programs_may_use_is_reported(tmp_path, name, text):
    program = read_programs(tmp_path, {name: text})[name]
    assert any("not given" in remark.text for remark in program.remarks)


OPEN = """P[1]{
   GP1:
\tUF : F, UT : 2,\t\tCONFIG : 'N U T, 0, 0, 0',
\tX = 1.0 mm,\tY = 2.0 mm,\tZ = 3.0 mm,
\tW = 0.0 deg,\tP = 0.0 deg,\tR = 0.0 deg
};
"""
MOVE = "J P[1] 50% FINE"


def fanuc_listing(name, *statements, positions=""):
    lines = [f"{k:4}:  {statement} ;" for k, statement in enumerate(statements, 1)]
    return "\n".join([f"/PROG  {name}", "/MN", *lines, "/POS", f"{positions}/END", ""])


def pick_lines(*statements):
    return fanuc_listing("PICK", *statements, positions=OPEN)


IN_3 = pick_lines("UFRAME_NUM=3", "CALL GRIP", MOVE)
ALONE = pick_lines("UFRAME_NUM=3", MOVE)


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"pick.ls": pick_lines(MOVE), "main.ls": fanuc_listing("MAIN", "CALL PICK")}, ("2", None)),  # as the project says
        ({"pick.ls": pick_lines(MOVE), "main.ls": fanuc_listing("MAIN", "UFRAME_NUM=3", "CALL PICK")}, "MAIN in main.ls sets"),
        ({"pick.ls": pick_lines(MOVE), "main.ls": fanuc_listing("MAIN", "UTOOL_NUM=3", "CALL PICK")}, ("2", None)),
        (
            {
                "pick.ls": pick_lines(MOVE),
                "main.ls": fanuc_listing("MAIN", "CALL FRAMES", "IF DI[1]=ON,CALL PICK"),
                "frames.ls": fanuc_listing("FRAMES", "UFRAME_NUM=R[1]"),
            },
            "FRAMES in frames.ls sets",
        ),
        ({"pick.ls": pick_lines("CALL FRAMES", MOVE), "f.ls": fanuc_listing("FRAMES", "UFRAME_NUM=3")}, "FRAMES in f.ls, which"),
        ({"pick.ls": pick_lines("UFRAME_NUM=3", MOVE), "m.ls": fanuc_listing("M", "UFRAME_NUM=4", "CALL PICK")}, ("2", "3")),
        ({"pick.ls": IN_3}, "PICK in pick.ls calls a program that was not given"),
        ({"pick.ls": IN_3, "grip.ls": fanuc_listing("GRIP", "DO[1]=ON")}, ("2", "3")),
        ({"pick.ls": IN_3, "grip.ls": fanuc_listing("grip", "UFRAME_NUM=3")}, ("2", "3")),
        ({"pick.ls": IN_3, "grip.ls": fanuc_listing("GRIP", "UFRAME_NUM=4")}, "GRIP in grip.ls, which its program calls"),
        ({"pick.ls": IN_3, "grip.ls": fanuc_listing("GRIP", "UTOOL_NUM=4")}, "goes there with tool 4"),
        ({"pick.ls": IN_3, "grip.ls": fanuc_listing("GRIP", "CALL DEEP")}, "GRIP in grip.ls calls a program that was not"),
        ({"pick.ls": ALONE, "init.ls": fanuc_listing("INIT", "UFRAME[3]=PR[1]", "CALL PICK")}, "INIT sets its frame"),
        (
            {
                "pick.ls": ALONE,
                "main.ls": fanuc_listing("MAIN", "CALL SEE", "CALL PICK"),
                "see.ls": fanuc_listing("SEE", "UTOOL[R[1]]=PR[1]"),
            },
            "SEE sets its frame or tool",
        ),
        ({"pick.ls": ALONE, "init.ls": fanuc_listing("INIT", "UFRAME[3]=PR[1]")}, ("2", "3")),
        ({"pick.ls": ALONE, "init.ls": fanuc_listing("INIT", "UFRAME[4]=PR[1]", "CALL PICK")}, ("2", "3")),
        ({"pick.ls": ALONE, "robot2/init.ls": fanuc_listing("INIT", "UFRAME[3]=PR[1]", "CALL PICK")}, ("2", "3")),
        ({"pick.ls": IN_3, "robot2/grip.ls": fanuc_listing("GRIP", "DO[1]=ON")}, "not given"),
        ({"pick.ls": IN_3, "grip.ls": fanuc_listing("GRIP", "UFRAME_NUM=4").replace("/POS", "")}, "GRIP in grip.ls, which"),
        # a macro of another name, or what a register names, may be any program that no other names
        ({"pick.ls": pick_lines(MOVE), "main.ls": fanuc_listing("MAIN", "UFRAME_NUM=3", "TAKE PART")}, "MAIN in main.ls sets"),
        ({"pick.ls": pick_lines(MOVE), "main.ls": fanuc_listing("MAIN", "UFRAME_NUM=3", "CALL SR[1]")}, "MAIN in main.ls sets"),
        ({"pick.ls": pick_lines(MOVE), "main.ls": fanuc_listing("MAIN", "UFRAME_NUM=3", "CALL OTHER")}, ("2", None)),
        ({"pick.ls": pick_lines(MOVE), "r2/main.ls": fanuc_listing("MAIN", "UFRAME_NUM=3", "TAKE PART")}, ("2", None)),
        (
            {
                "pick.ls": pick_lines(MOVE),
                "main.ls": fanuc_listing("MAIN", "UFRAME_NUM=3", "TAKE PART"),
                "take.ls": fanuc_listing("TAKE_PART", "DO[1]=ON"),
            },
            ("2", None),
        ),
        (
            {
                "pick.ls": ALONE,
                "main.ls": fanuc_listing("MAIN", "TAKE PART"),
                "init.ls": fanuc_listing("INIT\t  Macro", "UFRAME[3]=PR[1]"),
            },
            "INIT sets its frame",
        ),
        ({"pick.ls": ALONE, "init.ls": fanuc_listing("INIT\t  Macro", "UFRAME[3]=PR[1]")}, ("2", "3")),
    ],
)  # fmt: skip
def test_a_fanuc_position_without_frame_is_taken_in_one_only_where_no_other_program_chooses_another(
    tmp_path, files, expected
):
    found = frames_of_position(read_programs(tmp_path, files, damaged="grip.ls")["pick.ls"], "P[1]")
    if isinstance(expected, str):
        assert isinstance(found, str)
        assert expected in found
    else:
        assert found == expected


@pytest.mark.parametrize(
    ("files", "makers"),
    [
        ({"init.ls": fanuc_listing("INIT", "UFRAME[3]=PR[1]")}, ["INIT"]),
        ({"init.ls": fanuc_listing("INIT", "UFRAME[R[1]]=PR[1]")}, ["INIT"]),
        ({"init.ls": fanuc_listing("INIT", "UFRAME[4]=PR[1]")}, []),
        ({"init.ls": fanuc_listing("INIT", "UTOOL[2]=PR[1]")}, []),
        ({"robot2/init.ls": fanuc_listing("INIT", "UFRAME[3]=PR[1]")}, []),
        ({"init.ls": fanuc_listing("INIT", "UFRAME[3]=PR[1]", "CALL PICK")}, []),  # its points are left
    ],
)
def test_a_fanuc_frame_that_a_person_makes_by_a_program_is_noted(tmp_path, files, makers):
    positions = read_programs(tmp_path, {"pick.ls": ALONE} | files)["pick.ls"].positions
    made = [shift for shift in positions.shifts if shift.made_by]
    assert [shift.made_by for shift in made] == makers
    assert all(shift.user_frame == "3" for shift in made)


@pytest.mark.parametrize("call", ["CALL TOOL_4", "TOOL_4", "Tool 4"])
@pytest.mark.parametrize("sets", [True, False])
def test_a_macro_is_taken_for_the_program_of_its_name(tmp_path: Path, call: str, sets: bool) -> None:
    """Its listing was there, and what the project says of programs that choose no tool counted instead."""
    head = "/PROG  {}\n/ATTR\nDEFAULT_GROUP\t= 1,*,*,*,*;\n/MN\n"
    place = "X = 600.000  mm,\tY = 0.000  mm,\tZ = 500.000  mm,\n\tW = 180.000 deg,\tP = 0.000 deg,\tR = 0.000 deg"
    position = f"P[1]{{\n   GP1:\n\tUF : 1, UT : F,\t\tCONFIG : 'N U T, 0, 0, 0',\n\t{place}\n}};\n"
    moves = f"   1:  {call} ;\n   2:L P[1] 100mm/sec FINE ;\n"
    chooses = "   1:  UTOOL_NUM=4 ;\n" if sets else "   1:  DO[1]=ON ;\n"
    files = {
        "A.LS": f"{head.format('A')}{moves}/POS\n{position}/END\n",
        "TOOL_4.LS": f"{head.format('TOOL_4')}{chooses}/POS\n/END\n",
    }
    barred = read_programs(tmp_path, files)["A.LS"].positions.barred
    assert any("TOOL_4 in TOOL_4.LS" in why for why in barred.values()) == sets
    assert bool(barred) == sets
