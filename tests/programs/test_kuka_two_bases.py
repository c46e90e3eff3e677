"""A straight KRL routine that works in one base after the other: each point is in the base set last above it."""

import pytest

from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.positions import Positions

SET = "$BASE=BASE_DATA[{}]\n"
LINE = "LIN {{X {},Y 20,Z 130,A 0,B 180,C 0}}\n"


def positions_of(body: str) -> Positions:
    text = f"DEF k()\n$TOOL=TOOL_DATA[1]\n{body}END\nDEF sub()\n$BASE=BASE_DATA[1]\nEND\n"
    return read_program("k.src", text.encode()).positions


def test_each_point_is_in_the_base_above_it() -> None:
    body = SET.format(1) + LINE.format(10) + SET.format(2) + LINE.format(11) + LINE.format(12) + SET.format(1)
    found = positions_of(body + LINE.format(13))
    assert found.user_frames == ("1", "2", "2", "1")
    assert found.tools == ("1",) * 4
    assert found.barred == {}
    inside = positions_of(SET.format(1) + "WHILE x\n" + LINE.format(10) + "ENDWHILE\n" + SET.format(2))
    assert (inside.user_frames, inside.barred) == (("1",), {})


@pytest.mark.parametrize(
    "body",
    [
        SET.format(1) + LINE.format(10) + "IF x THEN\n" + SET.format(2) + "ENDIF\n" + LINE.format(11),
        SET.format(1) + "LOOP\n" + LINE.format(10) + SET.format(2) + LINE.format(11) + "ENDLOOP\n",
        SET.format(1) + "REPEAT\n" + LINE.format(10) + SET.format(2) + LINE.format(11) + "UNTIL x\n",
        SET.format(1) + LINE.format(10) + "GOTO away\n" + SET.format(2) + "away:\n" + LINE.format(11),
        SET.format(1) + LINE.format(10) + SET.format(2) + "sub()\n" + LINE.format(11),
        SET.format(1)
        + LINE.format(10)
        + SET.format(2)
        + "INTERRUPT DECL 3 WHEN $IN[1] DO sub()\n"
        + LINE.format(11),
    ],
    ids=["branch", "loop", "repeat", "jump", "call", "interrupt"],
)
def test_where_the_way_is_not_straight_all_points_are_left_and_named(body: str) -> None:
    found = positions_of(body)
    assert sorted(found.barred) == [0, 1]
    assert all("tool or base" in why for why in found.barred.values())


WORK = "DEF work()\n$TOOL=TOOL_DATA[1]\n$BASE=BASE_DATA[2]\n" + LINE.format(10) + "END\n"
RETREAT = "DEF retreat()\n$BASE=BASE_DATA[1]\nEND\n"


@pytest.mark.parametrize(
    ("main", "left"),
    [
        ("INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO retreat()\nwork()\n", True),
        ("begin()\nwork()\n", True),
        ("GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )\nwork()\n", False),
        ("work()\n", False),
    ],
    ids=["caller", "beside", "system", "none"],
)
def test_an_interrupt_sets_the_base_wherever_it_may_run(main: str, left: bool) -> None:
    begin = "DEF begin()\nGLOBAL INTERRUPT DECL 4 WHEN $IN[1] DO retreat()\nEND\n"
    text = f"DEF k()\n{main}END\n{begin}{WORK}{RETREAT}"
    found = read_program("k.src", text.encode()).positions
    assert bool(found.barred) is left
    assert left or (found.tools, found.user_frames) == (("1",), ("2",))


def test_a_base_that_is_computed_bars_what_stands_below_it() -> None:
    for computed in ("$BASE.X=5\n", "$BASE=SHIFT:BASE_DATA[2]\n", "BAS(#EX_BASE,2)\n"):
        found = positions_of(SET.format(1) + LINE.format(10) + computed + LINE.format(11))
        assert sorted(found.barred) == [1], computed
        assert found.user_frames[0] == "1"


def test_a_named_point_in_two_bases_is_left() -> None:
    point = "P1={X 10,Y 20,Z 130,A 0,B 180,C 0,S 2,T 3}\n"
    body = SET.format(1) + "LIN P1\n" + SET.format(2) + "LIN P1\n"
    found = positions_of("DECL E6POS P1\n" + point + body)
    assert len(found.barred) == 1
    assert "another tool or base" in next(iter(found.barred.values()))


def test_bases_written_as_numbers_more_than_once_are_named_as_such() -> None:
    value = "$BASE={{X {},Y 0,Z 200,A 0,B 0,C 0}}\n"
    found = positions_of(value.format(300) + LINE.format(10) + value.format(350) + LINE.format(11))
    assert sorted(found.barred) == [0, 1]
    assert all("another tool or base" in why for why in found.barred.values())
