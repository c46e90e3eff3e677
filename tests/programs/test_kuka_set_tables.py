"""Entries of BASE_DATA and TOOL_DATA that a KRL program sets to numbers before it takes them."""

from pathlib import Path

import pytest

from cellcal.drivers.program_registry import read_program
from tests.programs.test_across_files import read_programs

ENTRY = "BASE_DATA[{}] = {{FRAME: X {},Y -20,Z 130,A 30,B 0,C 0}}\n"
TAKEN = "$BASE=BASE_DATA[1]\n"
LINE = "LIN {X 10,Y 20,Z 130,A 0,B 180,C 0}\n"
TOOL = "TOOL_DATA[2]={X 1,Y 2,Z 103,A 0,B 0,C 0}\nBAS(#TOOL,2)\n"
SUB = "DEF sub()\n" + ENTRY.format(1, 900) + "END\n"


def places(body: str) -> list[float | None]:
    """Return where the bases of the points are along x [m]; None for points that are left."""
    program = read_program("k.src", f"DEF k()\n{TOOL}{body}END\n".encode())
    names = program.positions.user_frames
    return [
        None if row in program.positions.barred else program.frames.base_frame[name or ""].position_m[0]
        for row, name in enumerate(names)
    ]


@pytest.mark.parametrize(
    ("body", "found"),
    [
        (ENTRY.format(1, 300) + TAKEN + LINE + ENTRY.format(1, 400) + TAKEN + LINE, [0.3, 0.4]),
        (ENTRY.format(1, 300) + "bas (#Base, 1)\n" + LINE + ENTRY.format(1, 400) + LINE, [0.3, 0.3]),
        (ENTRY.format(1, 300) + ENTRY.format(2, 400) + TAKEN + LINE, [0.3]),
        (ENTRY.format(2, 300) + "BAS(#BASE,2)\n" + LINE, [0.3]),
        (ENTRY.format(1, 300) + "BASE_DATA[1].X=5\n" + TAKEN + LINE, [None]),
        (ENTRY.format(1, 300) + "BASE_DATA[n]=found\n" + TAKEN + LINE, [None]),
        (ENTRY.format(1, 300) + "BASE_DATA[1]={X 5.0}\n" + TAKEN + LINE, [None]),
        (ENTRY.format(1, 300) + "IF x THEN\n" + ENTRY.format(1, 400) + "ENDIF\n" + TAKEN + LINE, [None]),
        (ENTRY.format(1, 300) + "LOOP\n" + TAKEN + LINE + ENTRY.format(1, 400) + "ENDLOOP\n", [None]),
        (ENTRY.format(1, 300) + "LOOP\n" + TAKEN + LINE + "sub()\nENDLOOP\n", [None]),
        (ENTRY.format(1, 300) + "sub()\n" + TAKEN + LINE, [None]),
        (TAKEN + LINE + ENTRY.format(1, 300), [None]),
    ],
)
def test_an_entry_is_its_numbers_where_each_way_sets_them(body: str, found: list[float | None]) -> None:
    assert places(body) == found


def test_an_interrupt_that_sets_another_leaves_the_entry_open() -> None:
    body = f"{TOOL}{ENTRY.format(1, 300)}{TAKEN}{LINE}END\n{SUB}"
    for first, left in (("", False), ("INTERRUPT DECL 3 WHEN $IN[1] DO sub()\n", True)):
        program = read_program("k.src", f"DEF k()\n{first}{body}".encode())
        assert bool(program.positions.barred) is left


def test_a_point_in_an_entry_that_another_file_sets_is_left(tmp_path: Path) -> None:
    files = {"k.src": f"DEF k()\n{TOOL}{TAKEN}{LINE}END\n", "sub.src": SUB}
    assert list(read_programs(tmp_path, files)["k.src"].positions.barred) == [0]


TAUGHT = "FDAT_ACT=FP{n}\nBAS(#CP_PARAMS,2)\nLIN XP{n}\n"
POINT = (
    "DECL E6POS XP{n}={{X 10,Y 20,Z 130,A 0,B 180,C 0,S 2,T 3,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}}\n"
    'DECL FDAT FP{n}={{TOOL_NO 2,BASE_NO {base},IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}}\n'
)
MOVES = TAUGHT.format(n=1) + TAUGHT.format(n=2)
BEFORE = ENTRY.format(1, 300) + ENTRY.format(2, 400)
FILE_2 = "DEF other()\n" + ENTRY.format(2, 900) + "END\n"


@pytest.mark.parametrize(
    ("body", "other", "found"),
    [
        (BEFORE + MOVES, "", [0.3, 0.4]),
        (BEFORE + MOVES.lower(), "", [0.3, 0.4]),
        (ENTRY.format(1, 300) + TAUGHT.format(n=1) + ENTRY.format(2, 400) + TAUGHT.format(n=2), "", [0.3, 0.4]),
        (ENTRY.format(1, 300) + MOVES, "", [0.3, 2.0]),
        (BEFORE + TAUGHT.format(n=1) + ENTRY.format(1, 500) + MOVES, "", [None, 0.4]),
        (TAUGHT.format(n=1) + BEFORE + MOVES, "", [None, 0.4]),
        (BEFORE + "LOOP\n" + MOVES + ENTRY.format(1, 500) + "ENDLOOP\n", "", [None, 0.4]),
        (BEFORE + "LOOP\n" + MOVES + "TCP_On()\nENDLOOP\n", "", [0.3, 0.4]),
        (BEFORE + "BASE_DATA[n]=found\n" + MOVES, "", [None, None]),
        (BEFORE + "IF x THEN\nBASE_DATA[2].Z=5\nENDIF\n" + MOVES, "", [0.3, None]),
        (BEFORE + MOVES, FILE_2, [0.3, None]),
        (BEFORE + MOVES, FILE_2.replace("[2]", "[n]"), [None, None]),
        (BEFORE + MOVES + "$BASE=BASE_DATA[1]\n$TOOL=TOOL_DATA[2]\nLIN XP2\n", "", [0.3, None]),
        (BEFORE + MOVES, "DEF other()\n$BASE=BASE_DATA[3]\nLIN XP1\nEND\n", [0.3, 0.4]),
    ],
)  # fmt: skip
def test_taught_points_stand_in_entries_that_their_own_program_sets(
    tmp_path: Path, body: str, other: str, found: list[float | None]
) -> None:
    config = "DEFDAT $CONFIG PUBLIC\nBASE_DATA[2]={X 2000,Y 0,Z 0,A 0,B 0,C 0}\nENDDAT\n"
    files = {
        "k.src": f"DEF k()\n{TOOL}{body}END\n",
        "k.dat": "DEFDAT k\n" + POINT.format(n=1, base=1) + POINT.format(n=2, base=2) + "ENDDAT\n",
        "other.src": other or "DEF other()\nEND\n",
        "$config.dat": config,
    }
    program = read_programs(tmp_path, files)["k.dat"]
    frames = {**program.frames.cell_base_frame, **program.frames.base_frame}
    names = program.positions.user_frames
    assert [
        None if row in program.positions.barred else frames[name or ""].position_m[0]
        for row, name in enumerate(names)
    ] == found
    assert program.positions.tools[0] == "$TOOL={X 1.0, Y 2.0, Z 103.0, A 0.0, B 0.0, C 0.0}"


def test_global_points_may_be_moved_to_by_others_with_their_frame_data(tmp_path: Path) -> None:
    shown = POINT.replace("DECL ", "DECL GLOBAL ").format(n=1, base=1)
    files = {
        "k.src": f"DEF k()\n{TOOL}{ENTRY.format(1, 300)}{TAUGHT.format(n=1)}END\n",
        "k.dat": f"DEFDAT k PUBLIC\n{shown}ENDDAT\n",
        "other.src": f"DEF other()\n{TAUGHT.format(n=1)}END\n",
    }
    assert list(read_programs(tmp_path, files)["k.dat"].positions.barred) == [0]
