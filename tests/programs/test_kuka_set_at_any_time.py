"""Points and entries of KUKA programs that get a value behind DO, in a record, by a number, or in another folder."""

from pathlib import Path

import pytest

from tests.programs import test_kuka_set_tables as krl
from tests.programs.test_across_files import dat_file, frames_of_position, read_programs, src_file

POINT = "{X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2}"
DATA = dat_file("A", f"DECL E6POS XP1={POINT}", "DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}")
TAUGHT = ("FDAT_ACT=FP1", "BAS(#CP_PARAMS,2)", "LIN XP1")
BOTH = ("$BASE=BASE_DATA[1]", "$TOOL=TOOL_DATA[1]")


@pytest.mark.parametrize(
    ("line", "left"),
    [
        ("TRIGGER WHEN PATH=0 DELAY=0 DO XP1=XP2", True),
        ("TRIGGER WHEN PATH=0 DELAY=0 DO XP1.X=5", True),
        ("TRIGGER WHEN PATH=0 DELAY=0 DO FP1.BASE_NO=3", True),
        ("TRIGGER WHEN PATH=0 DELAY=0 DO BASE_DATA[2].X=5", True),
        ("INTERRUPT DECL 3 WHEN $IN[1]==TRUE DO XP1=$POS_INT", True),
        ("TRIGGER WHEN PATH=0 DELAY=0 DO $OUT[1]=TRUE", False),
        ("TRIGGER WHEN PATH=0 DELAY=0 DO XP9.X=5", False),
    ],
)
def test_what_gets_a_value_behind_do(tmp_path: Path, line: str, left: bool) -> None:
    files = {"a.dat": DATA, "a.src": src_file("A", line, *TAUGHT)}
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1")
    assert (found != ("1", "2")) is left


@pytest.mark.parametrize(("base", "left"), [("2", False), ("3", True)])
def test_a_point_that_is_copied_into_a_record(tmp_path: Path, base: str, left: bool) -> None:
    lines = (*TAUGHT, "PT.PICK=XP1", f"$BASE=BASE_DATA[{base}]", "$TOOL=TOOL_DATA[1]", "LIN PT.PICK")
    files = {"a.dat": DATA, "a.src": src_file("A", *lines)}
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1")
    assert (found != ("1", "2")) is left


@pytest.mark.parametrize(
    ("mode", "left"),
    [("#BASE", False), ("# base", True), ("#TCP", True), ("MODE", True), ("F_MODE(1)", True)],
)
def test_only_a_tool_that_is_surely_held_lets_points_be_changed(
    tmp_path: Path, mode: str, left: bool
) -> None:
    program = src_file("A", *BOTH, f"$IPO_MODE={mode}", f"LIN {POINT}")
    positions = read_programs(tmp_path, {"a.src": program})["a.src"].positions
    assert bool(positions.barred or positions.kinds[0] != "cartesian") is left


def test_a_function_that_a_move_calls_behind_with_may_set_the_base(tmp_path: Path) -> None:
    program = src_file("A", *BOTH, "SLIN XQ WITH $BASE=F()", f"LIN {POINT}")
    function = "DEFFCT FRAME F ( )\r\n$BASE=BASE_DATA[2]\r\nRETURN BASE_DATA[2]\r\nENDFCT\r\n"
    positions = read_programs(tmp_path, {"a.src": program, "f.src": function})["a.src"].positions
    assert positions.barred


HANDLER = "INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO sub()\nINTERRUPT ON 4\n"
OWN = f"DEF k()\n{krl.TOOL}{krl.ENTRY.format(1, 300)}{krl.TAKEN}{krl.LINE}END\n"


@pytest.mark.parametrize(
    ("files", "left"),
    [
        ({"k.src": OWN.replace("DEF k()\n", f"DEF k()\n{HANDLER}"), "lib/sub.src": krl.SUB}, True),
        ({"k.src": OWN, "start.src": f"DEF s()\nGLOBAL {HANDLER}k()\nEND\n", "lib/sub.src": krl.SUB}, True),
        ({"p/k.src": OWN, "q/s.src": f"DEF s()\nGLOBAL {HANDLER}k()\nEND\n", "r/sub.src": krl.SUB}, True),
        ({"k.src": OWN, "q/s.src": "DEF s()\n$ROBROOT.X=5\nEND\n"}, True),
        ({"p/k.src": OWN, "q/s.src": "DEF s()\n$ROBROOT.X=5\nEND\n"}, True),
        (
            {
                "1/R1/k.src": OWN,
                "2/R1/s.src": f"DEF s()\nGLOBAL {HANDLER}k()\nEND\n",
                "2/R1/sub.src": krl.SUB,
            },
            False,
        ),
    ],
)
def test_folders_without_r1_are_of_one_controller(tmp_path: Path, files: dict[str, str], left: bool) -> None:
    found = read_programs(tmp_path, files)
    (own,) = [program for name, program in found.items() if name.endswith("k.src")]
    assert bool(own.positions.barred) is left


@pytest.mark.parametrize(
    ("line", "left"),
    [
        ('SETVAR("BASE_DATA[2]",F)', True),
        ('setvar ( "base_data[ 02 ].X",5)', True),
        ('OK=SETVAR("BASE_DATA[2]",F)', True),
        ('IF SETVAR("TOOL_DATA[1]",F) THEN', True),
        ('SET_VAR("BASE_DATA[N]",F)', True),
        ("SETVAR(NAME[],F)", True),
        ('SETVAR("$ROBROOT",F)', True),
        ('SETVAR("XP1",F)', True),
        ('SETVAR("XP1.X",5)', True),
        ('SETVAR("FP1.BASE_NO",5)', True),
        ('CWRITE($CMD,STAT,MODE,"SET BASE_DATA[2]={X 5}")', True),
        ('OTHER("BASE_DATA[2]")', True),
        ('SETVAR("BASE_DATA[4]",F)', False),
        ('SETVAR("XP9",F)', False),
        ('SETVAR("COUNT",5)', False),
        ('MSGNOTIFY("BASE_DATA[2] is new")', False),
        (';SETVAR("BASE_DATA[2]",F)', False),
        ('CWRITE($CMD,STAT,MODE,"RUN /R1/S()")', False),
        ('NAME[]="BASE_DATA[2]"', False),
    ],
)
def test_what_is_set_by_its_name_in_a_text(tmp_path: Path, line: str, left: bool) -> None:
    """The routine that sets it is in no given file; it may run at any time."""
    files = {"a.dat": DATA, "a.src": src_file("A", *TAUGHT)}
    if "P1" in line:
        files["a.src"] = src_file("A", line, *TAUGHT)
    else:
        files["b.src"] = src_file("B", line)
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1")
    assert (found != ("1", "2")) is left
