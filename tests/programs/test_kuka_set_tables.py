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
