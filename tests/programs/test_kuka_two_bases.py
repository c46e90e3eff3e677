"""A straight KRL routine that works in one base after the other: each point is in the base set last above it."""

from pathlib import Path

import pytest

from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.positions import Positions
from cellcal.service.engineering.programs.batches import read_batches
from cellcal.service.engineering.programs.files import find_programs

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
    ("body", "left"),
    [
        (SET.format(1) + LINE.format(10) + "IF x THEN\n" + SET.format(2) + "ENDIF\n" + LINE.format(11), [1]),
        (SET.format(1) + "LOOP\n" + LINE.format(10) + SET.format(2) + LINE.format(11) + "ENDLOOP\n", [0]),
        (SET.format(1) + "REPEAT\n" + LINE.format(10) + SET.format(2) + LINE.format(11) + "UNTIL x\n", [0]),
        (SET.format(1) + "FOR i=1 TO 2\n" + LINE.format(10) + SET.format(2) + "ENDFOR\n" + LINE.format(11), [0, 1]),
        ("LOOP\n" + SET.format(1) + LINE.format(10) + "ENDLOOP\n" + LINE.format(11) + SET.format(2), [1]),
        (
            SET.format(1) + "WHILE y\nLOOP\n" + LINE.format(10) + "ENDLOOP\n" + SET.format(2) + "ENDWHILE\n"
            + LINE.format(11),
            [0, 1],
        ),
        (SET.format(1) + LINE.format(10) + "GOTO away\n" + SET.format(2) + "away:\n" + LINE.format(11), [1]),
        (SET.format(1) + LINE.format(10) + SET.format(2) + "sub()\n" + LINE.format(11), [1]),
        (
            SET.format(1) + "TRIGGER WHEN DISTANCE=0 DELAY=0 DO sub() PRIO=-1\n" + LINE.format(10)
            + SET.format(2) + LINE.format(11),
            [0, 1],
        ),
        (
            SET.format(1) + LINE.format(10) + SET.format(2) + "INTERRUPT DECL 3 WHEN $IN[1] DO sub()\n"
            + LINE.format(11),
            [0, 1],
        ),
    ],
    ids=["branch", "loop", "repeat", "for", "behind", "nested", "jump", "call", "trigger", "interrupt"],
)  # fmt: skip
def test_where_a_way_may_bring_another_base_the_points_are_left_and_named(body: str, left: list[int]) -> None:
    found = positions_of(body)
    assert sorted(found.barred) == left
    assert all("tool or base" in why for why in found.barred.values())
    assert [found.user_frames[row] for row in range(2) if row not in left] == [
        str(row + 1) for row in range(2) if row not in left
    ]


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


VALUE = "$BASE = {{FRAME: X {},Y 0,Z 200,A 90,B -0.000,C 0}}\n"


def test_bases_written_as_numbers_hold_from_where_they_stand() -> None:
    begin = "BAS(#INITMOV,0)\nBAS(#FRAMES)\nBAS(#TOOL,0)\nBAS(#BASE,0)\n"
    body = begin + VALUE.format(300) + LINE.format(10) + "LOOP\n" + LINE.format(11) + "ENDLOOP\n"
    program = read_program("k.src", f"DEF k()\n{body}{VALUE.format(350)}{LINE.format(12)}END\n".encode())
    found = program.positions
    assert found.barred == {}
    poses = [program.frames.base_frame[name].position_m[0] for name in found.user_frames if name]
    assert poses == pytest.approx([0.3, 0.3, 0.35])


SUB = "DEF sub()\n$BASE=BASE_DATA[1]\nEND\n"


@pytest.mark.parametrize(
    ("main", "left"),
    [
        (SET.format(1) + LINE.format(10) + "sub()\n$TOOL=TOOL_DATA[1]\n" + SET.format(2) + LINE.format(11), []),
        (SET.format(1) + LINE.format(10) + SET.format(2) + "sub()\n" + LINE.format(11), [1]),
        (SET.format(1) + "grip()\n" + LINE.format(10) + SET.format(2) + "grip()\n" + LINE.format(11), []),
        (SET.format(1) + LINE.format(10) + SET.format(2) + "P={X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 3}\nsub()\nLIN P\n", [1]),
        (SET.format(1) + LINE.format(10) + SET.format(2) + "INTERRUPT DECL 4 WHEN $IN[1] DO sub()\n" + LINE.format(11), [1]),
    ],
    ids=["before", "since", "sets_none", "named", "interrupt"],
)  # fmt: skip
def test_a_called_program_that_sets_one_of_the_bases_counts(
    tmp_path: Path, main: str, left: list[int]
) -> None:
    text = f"DEF k()\nDECL E6POS P\n$TOOL=TOOL_DATA[1]\n{main}END\n"
    grip = "DEF grip()\n$OUT[1]=TRUE\nEND\n"
    for name, code in (("k", text), ("sub", SUB), ("grip", grip)):
        (tmp_path / f"{name}.src").write_text(code)
    batches = read_batches(find_programs([str(tmp_path)]).sources, lambda _: None, [])
    found = {one.source.place.name: one.program.positions for some in batches for one in some}["k.src"]
    assert sorted(found.barred) == left
