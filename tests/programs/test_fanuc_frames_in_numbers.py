"""User frames and tools that a listing sets to numbers through a register, as RoboDK writes them."""

from pathlib import Path

import pytest

from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.positions import ProgramFile
from tests.programs.test_across_files import read_programs

RECORD = """P[{n}]{{
   GP1:
    UF : 9, UT : 9,        CONFIG : 'N U T, 0, 0, 0',
	X =   200.000  mm,	Y =   250.000  mm,	Z =   348.700  mm,
	W =   180.000 deg,	P =    -0.000 deg,	R =  -150.000 deg
}};
"""


def set_lines(which: str, x: float) -> list[str]:
    numbers = (x, -363.7, 41.5, 0.0, -0.0, 30.0)
    elements = [f"  PR[9,{axis}]={value:.3f}" for axis, value in enumerate(numbers, start=1)]
    return [*elements, f"  {which}[9]=PR[9]", f"  {which}_NUM=9"]


TOOL = set_lines("UTOOL", 62.5)
FIRST, SECOND = set_lines("UFRAME", 807.8), set_lines("UFRAME", 507.8)


def listing(*lines: str, count: int, name: str = "RDK") -> str:
    code = "".join(f"{at:4d}:{line} ;\n" for at, line in enumerate(lines, start=1))
    records = "".join(RECORD.format(n=n) for n in range(1, count + 1))
    return f"/PROG  {name}\n/ATTR\nDEFAULT_GROUP\t= 1,*,*,*,*;\n/MN\n{code}/POS\n{records}/END\n"


def move(number: int, options: str = "") -> str:
    return f"L P[{number}] 100mm/sec FINE {options}".rstrip()


def places(program: ProgramFile) -> list[float | None]:
    """Return where the frames of the positions are along x [mm]; None for positions that are left."""
    positions = program.positions
    return [
        None
        if row in positions.barred
        else round(program.frames.base_frame[name or ""].position_m[0] * 1e3, 3)
        for row, name in enumerate(positions.user_frames)
    ]


def read(*lines: str, count: int = 1) -> ProgramFile:
    return read_program("rdk.ls", listing(*lines, count=count).encode())


def test_each_position_stands_in_the_numbers_of_its_motion() -> None:
    program = read(*FIRST, *TOOL, move(1), "  DO[5]=ON", *SECOND, move(2), "  CALL GRIP", move(3), count=3)
    assert places(program) == [807.8, 507.8, 507.8]
    tool = program.frames.flange_tip[program.positions.tools[0] or ""]
    assert tool.position_m == pytest.approx((0.0625, -0.3637, 0.0415))


def test_brackets_that_the_controller_writes_around_a_negative_number_count() -> None:
    lines = [line.replace("=-363.700", "=(-363.700)") for line in FIRST]
    assert places(read(*lines, *TOOL, move(1))) == [807.8]


@pytest.mark.parametrize(
    "lines",
    [
        [*FIRST[:5], *FIRST[6:], *TOOL, move(1)],
        [*FIRST[:6], "  PR[9,1]=R[1]", *FIRST[6:], *TOOL, move(1)],
        [*FIRST[:6], "  PR[9]=LPOS", *FIRST[6:], *TOOL, move(1)],
        [*FIRST[:6], "  CALL OTHER", *FIRST[6:], *TOOL, move(1)],
        [*FIRST, *TOOL, move(1), *SECOND, move(1)],
        [*TOOL, move(1), *FIRST],
        [*FIRST, *TOOL, "  LBL[1]", move(1), *SECOND, "  JMP LBL[1]"],
        [*FIRST, *TOOL, "  IF DI[1]=ON,JMP LBL[1]", *SECOND, "  LBL[1]", move(1)],
        [*FIRST, *TOOL, "  IF DI[1]=ON,UFRAME[9]=PR[8]", move(1)],
        [*FIRST, *TOOL, "  UFRAME[R[1]]=PR[8]", move(1)],
        [*FIRST, *TOOL, "  $MNUFRAME[1,9]=$MNUFRAME[1,8]", move(1)],
        [*FIRST, *TOOL, "  RUN OTHER", move(1)],
        [*FIRST, *TOOL, "  RESUME_PROG[1]=OTHER", move(1)],
        [*FIRST, *TOOL, move(1), *SECOND, "L P[R[1]] 100mm/sec FINE"],
        [*FIRST, *TOOL, move(1), "  PR[1]=P[1]", *SECOND, "L PR[1] 100mm/sec FINE"],
        [*FIRST, *TOOL],
    ],
    ids=["five", "computed", "whole", "called", "two", "below", "loop", "jump", "short_if", "chosen", "variable",
         "beside", "resumed", "indirect", "copied", "unused"],
)  # fmt: skip
def test_where_it_is_not_certain_the_position_is_left_and_named(lines: list[str]) -> None:
    program = read(*lines)
    assert places(program) == [None]
    assert "sets its frame or tool" in program.positions.barred[0]


def test_a_program_beside_that_sets_one_counts_where_it_may_be_called(tmp_path: Path) -> None:
    one = listing(*FIRST, *TOOL, move(1), "  CALL OTHER", move(2), count=2)
    other = listing(*SECOND, *TOOL, move(1), count=1, name="OTHER")
    found = read_programs(tmp_path, {"RDK.LS": one, "OTHER.LS": other})
    assert places(found["RDK.LS"]) == [807.8, None]
    assert places(found["OTHER.LS"]) == [507.8]
