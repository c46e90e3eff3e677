"""A frame or tool that a called listing leaves selected, unlike the one that a position was taught with."""

from pathlib import Path

import pytest

from tests.programs.test_across_files import read_programs
from tests.programs.test_fanuc_frames_in_numbers import listing, move

FRAME, TOOL = "  UFRAME_NUM={}", "  UTOOL_NUM={}"
SAVED, RESTORED = "  R[5]=UFRAME_NUM", "  UFRAME_NUM=R[5]"
TAUGHT = (FRAME.format(1), TOOL.format(1))


def taught_in_1(*lines: str, count: int, name: str) -> str:
    return listing(*lines, count=count, name=name).replace("UF : 9, UT : 9", "UF : 1, UT : 1")


@pytest.mark.parametrize(
    ("lines", "called", "why"),
    [
        (["  CALL SUB"], [FRAME.format(2)], "user frame 2"),
        (["  CALL SUB(1,2)"], [TOOL.format(3)], "tool 3"),
        ([FRAME.format(2), "  CALL SUB"], ["  DO[1]=ON"], "user frame 2"),
        ([FRAME.format(2), "  CALL SUB"], [SAVED, FRAME.format(3), RESTORED], "user frame 2"),
        ([FRAME.format(2), "  CALL SUB"], [FRAME.format(1)], ""),
        (["  CALL SUB"], [SAVED, FRAME.format(2), RESTORED], ""),
        (["  CALL SUB"], ["  IF DI[1]=ON,UFRAME_NUM=2"], ""),
        (["  IF DI[1]=ON,CALL SUB"], [FRAME.format(2)], ""),
        ([FRAME.format(2), "  CALL SUB"], ["  CALL SET_1"], ""),
        ([FRAME.format(2), "  CALL SUB"], ["  CALL UNKNOWN"], ""),
        ([FRAME.format(2), "  CALL UNKNOWN"], ["  DO[1]=ON"], ""),
        (["  CALL SUB", FRAME.format(1)], [FRAME.format(2)], ""),
        (["  CALL SUB"], ["  CALL SET_2"], "user frame 2"),
        (["  CALL SUB"], [FRAME.format(1), "  CALL SET_2", "  DO[1]=ON"], "user frame 2"),
        (["  CALL SUB"], [FRAME.format(2), "  CALL GRIP"], "user frame 2"),
        (["  CALL SUB"], ["  CALL SET_2", "  CALL GRIP", "  CALL GRIP"], "user frame 2"),
        ([FRAME.format(2), "  CALL SUB"], ["  CALL GRIP"], "user frame 2"),
        ([FRAME.format(2), "  CALL SUB"], ["  CALL SET_2", "  CALL SET_1"], ""),
        (["  CALL SUB"], ["  IF DI[1]=ON,CALL SET_2", "  CALL GRIP"], ""),
        (["  CALL SUB"], ["  IF DI[1]=ON,JMP LBL[1]", "  CALL SET_2", "  LBL[1]"], ""),
        (["  CALL SUB"], ["  IF DI[1]=ON,END", "  CALL SET_2"], ""),
        (["  CALL SUB"], ["  CALL SET_2", "  CALL UNKNOWN"], ""),
        (["  CALL SUB"], ["  CALL SUB"], ""),
        (["  CALL SUB"], ["  CALL SET_2", "  Hand Open"], ""),
        (["  CALL SUB"], ["  CALL STARTER"], ""),
    ],
)
def test_what_is_selected_behind_a_call_is_known_where_it_is_certain(
    tmp_path: Path, lines: list[str], called: list[str], why: str
) -> None:
    files = {
        "MAIN.LS": taught_in_1(*TAUGHT, move(1), *lines, move(2), count=2, name="MAIN"),
        "SUB.LS": listing(*called, count=0, name="SUB"),
        "SET_1.LS": listing(FRAME.format(1), count=0, name="SET_1"),
        "SET_2.LS": listing(FRAME.format(2), count=0, name="SET_2"),
        "STARTER.LS": listing("  RUN SET_1", FRAME.format(2), count=0, name="STARTER"),
        "GRIP.LS": listing("  DO[2]=ON", count=0, name="GRIP"),
    }
    barred = read_programs(tmp_path, files)["MAIN.LS"].positions.barred
    assert sorted(barred) == ([1] if why else [])
    assert why in barred.get(1, "")
