"""Tools and work objects that RAPID modules set to numbers, as RoboDK and other post-processors write them."""

from pathlib import Path

import pytest

from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.positions import ProgramFile
from tests.programs.test_across_files import rapid_module, read_programs

TOOL = "LOCAL PERS tooldata rdkTool := [TRUE,[[0,0,0],[1,0,0,0]],[2,[0,0,15],[1,0,0,0],0,0,0.005]];"
WORK = '{} wobjdata Frame1 := [FALSE, TRUE, "", [[0,0,0],[1,0,0,0]],[[0,0,7],[1,0,0,0]]];'
TARGET = "[[200.000, 250.000, 348.700],[0.00000000, 0.25881905, -0.96592583, 0.00000000],[0,0,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]"
MOVE = f"MoveL {TARGET},rdkSpeed,z1,rdkTool,\\WObj:=Frame1;"
SET_TOOL = "rdkTool.tframe := [[62.5, -8.25, 100],[1,0,0,0]];"
SET_1 = "Frame1.uframe := [[807.800, -363.700, 41.500],[0.96592583, 0.00000000, 0.00000000, 0.25881905]];"
SET_2 = "Frame1.uframe := [[507.8, 463.7, 141.5],[0.98480775, 0, 0, -0.17364818]];"
BEGIN = [SET_TOOL, SET_1]


def module_of(*lines: str, routines: str = "", kind: str = "LOCAL PERS") -> str:
    return rapid_module(
        "m", TOOL, WORK.format(kind), "PROC main()", "ConfJ \\On;", *lines, "ENDPROC", routines
    )


def read(*lines: str, routines: str = "") -> ProgramFile:
    return read_program("m.mod", module_of(*lines, routines=routines).encode())


def places(program: ProgramFile) -> list[float | None]:
    """Return where the frames of the positions are along x [mm]; None for positions that are left."""
    positions = program.positions
    return [
        None
        if row in positions.barred
        else round(program.frames.base_frame[name or ""].position_m[0] * 1e3, 3)
        for row, name in enumerate(positions.user_frames)
    ]


def test_each_move_has_the_numbers_that_stand_above_it() -> None:
    program = read(*BEGIN, MOVE, "WaitTime 0.5;", "IF di1=1 THEN", MOVE, "ENDIF", SET_2, MOVE)
    assert places(program) == [807.8, 807.8, 507.8]
    frame = program.frames.base_frame[program.positions.user_frames[0] or ""]
    assert frame.position_m == pytest.approx(
        (0.8078, -0.3637, 0.0485)
    )  # with the object frame of the declaration
    tool = program.frames.flange_tip[program.positions.tools[0] or ""]
    assert tool.position_m == pytest.approx((0.0625, -0.00825, 0.1))


def test_parts_are_put_together() -> None:
    parts = (
        "Frame1.uframe.rot := [1,0,0,0];",
        "Frame1.oframe.trans := [1,2,3];",
        "Frame1.uframe.trans:=[10,20,30];",
    )
    program = read(SET_TOOL, *parts, MOVE, SET_1, MOVE)
    first, second = (program.frames.base_frame[name or ""] for name in program.positions.user_frames)
    assert first.position_m == pytest.approx((0.011, 0.022, 0.033))
    assert second.position_m[2] == pytest.approx(0.0445)


@pytest.mark.parametrize(
    ("lines", "routines"),
    [
        ([SET_TOOL, MOVE, SET_1], ""),
        ([*BEGIN, "Frame1.uframe.trans.x := 5;", MOVE], ""),
        ([*BEGIN, "Frame1.uframe := DefFrame(p1,p2,p3);", MOVE], ""),
        ([*BEGIN, "IF di1=1 THEN", SET_2, "ENDIF", MOVE], ""),
        ([*BEGIN, f"IF di1=1 {SET_2}", MOVE], ""),
        ([*BEGIN, "WHILE di1=1 DO", MOVE, SET_2, "ENDWHILE"], ""),
        ([*BEGIN, "again:", MOVE, SET_2, "GOTO again;"], ""),
        ([*BEGIN, "other;", MOVE], f"PROC other()\n{SET_2}\nENDPROC"),
        ([*BEGIN, "unknown;", MOVE], f"PROC other()\n{SET_2}\nENDPROC"),
        ([*BEGIN, '%"other"%;', MOVE], f"PROC other()\n{SET_2}\nENDPROC"),
        ([*BEGIN, "FindFrame Frame1;", MOVE], ""),
        ([*BEGIN, "b := Found(Frame1);", MOVE], ""),
        ([*BEGIN, MOVE, "ERROR", SET_2, "RETRY;"], ""),
        ([*BEGIN, MOVE], f"TRAP hit\n{SET_2}\nENDTRAP"),
        ([*BEGIN, MOVE], f"TRAP hit\nother;\nENDTRAP\nPROC other()\n{SET_2}\nENDPROC"),
        ([*BEGIN, "Frame1.robhold := TRUE;", MOVE], ""),
        ([SET_TOOL, SET_1.replace("96592583", "9"), MOVE], ""),
        ([SET_TOOL, f"TEST n\nCASE 1:\n{SET_1}\nDEFAULT:\n{SET_2}\nENDTEST", MOVE], ""),
    ],
    ids=["below", "coordinate", "computed", "branch", "short_if", "loop", "jump", "call", "unknown_call", "late",
         "passed", "in_function", "error", "trap", "trap_call", "held", "no_turn", "test"],
)  # fmt: skip
def test_where_it_is_not_certain_the_point_is_left_and_named(lines: list[str], routines: str) -> None:
    program = read(*lines, routines=routines)
    assert places(program) == [None]
    assert "tool or work object" in next(iter(program.positions.barred.values()))


def test_comments_and_strings_set_nothing() -> None:
    assert places(read(*BEGIN, f"! {SET_2}", f'TPWrite "{SET_2[:20]}";', MOVE)) == [807.8]


def test_another_module_that_sets_it_bars_it_unless_it_is_local(tmp_path: Path) -> None:
    other = rapid_module("n", "PROC sets()", SET_2, "ENDPROC")
    for kind, left in (("PERS", True), ("LOCAL PERS", False)):
        folder = tmp_path / kind
        folder.mkdir()
        files = {"m.mod": module_of(*BEGIN, MOVE, kind=kind), "n.mod": other}
        assert bool(read_programs(folder, files)["m.mod"].positions.barred) is left
    alone = read_programs(tmp_path / "x", {"m.mod": module_of(*BEGIN, MOVE, kind="PERS")})["m.mod"]
    assert places(alone) == [807.8]


def test_a_work_object_at_the_motion_is_known_where_it_stands() -> None:
    written = MOVE.replace("=Frame1", '=[FALSE,TRUE,"",[[100,0,0],[1,0,0,0]],[[0,5,0],[1,0,0,0]]]')
    program = read(
        SET_TOOL, written, written.replace("FALSE,TRUE", "TRUE,TRUE"), written.replace("100,", "100+a,")
    )
    assert places(program) == [100.0, None, None]
