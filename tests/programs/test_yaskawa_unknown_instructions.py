"""Instructions of Yaskawa jobs that are no known motion and name a taught position, a user frame or a tool."""

from pathlib import Path

import pytest

from cellcal.drivers.program_registry import read_program
from tests.programs.test_across_files import read_programs

JOB = """/JOB
//NAME {name}
//POS
///NPOS 2,0,0,0,0,0
///USER 1
///TOOL 3
///POSTYPE USER
///RECTAN
///RCONF 1,0,0,0,0,0,0,0
C00000=700.000,0.000,500.000,180.0000,0.0000,0.0000
C00001=710.000,0.000,500.000,180.0000,0.0000,0.0000
//INST
///DATE 2025/05/21 10:37
///ATTR SC,RW,RJ{macro}
////FRAME USER 1
///GROUP1 RB1
NOP
MOVJ C00000 VJ=10.00
{lines}
END
"""


def job(*lines: str, name: str = "A", macro: str = "") -> str:
    return JOB.format(name=name, macro=macro, lines="\n".join(lines))


def read_barred(*lines: str) -> dict[int, str]:
    return dict(read_program("A.JBI", job(*lines).encode()).positions.barred)


@pytest.mark.parametrize(
    "line", ["CIRCUT C00001 V=50.0", "circut c00001", "NEWWORD 1 C00001", 'NEWWORD "a" C00001']
)
def test_a_position_that_an_unknown_instruction_names_is_left(line: str) -> None:
    found = read_barred(line)
    assert list(found) == [1]
    assert "is not known" in found[1]


@pytest.mark.parametrize(
    "line",
    [
        "MOVL C00001 V=50.0",
        "REFP 1 C00001",
        "GETE D000 C00001 (3)",
        "SET P001 C00001",
        "JUMP *C00001 IF IN#(1)=ON\n*C00001",
        "CALL JOB:C00001",
        'MSG "C00001"',
        "'CIRCUT C00001",
        "//CIRCUT C00001",
    ],
)
def test_names_that_are_no_position_there_do_no_harm(line: str) -> None:
    assert read_barred(line) == {}


@pytest.mark.parametrize(
    ("line", "is_left"),
    [
        ("SETUFRAME UF#(1) P001", True),
        ("NEWWORD UF#(1)", True),
        ("NEWWORD UF#(B000)", True),
        ("NEWWORD TL#(3)", True),
        ("newword tl#(3)", True),
        ('NEWWORD "a" TL#(3)', True),
        ('NEWWORD "TL#(3)"', False),
        ('NEWWORD "a" \'TL#(3)', False),
        ("NEWWORD UF#(2)", False),
        ("NEWWORD TL#(1)", False),
        ("GETUFRM P001 UF#(1)", False),
        ("CNVRT PX001 PX002 UF#(1)", False),
        ("CALL JOB:B UF#(1)", False),
    ],
)
def test_what_an_unknown_instruction_may_make_is_left(line: str, is_left: bool) -> None:
    assert bool(read_barred(line)) is is_left


@pytest.mark.parametrize(
    ("line", "macro", "is_left"),
    [
        ("CALL JOB:B", "", True),
        ("call job:B", "", True),
        ("MACRO1 MJ#(1)", ",MC", True),
        ("MACRO1 MJ#(1)", "", False),
        ("DOUT OT#(1) ON", ",MC", False),
    ],
)
def test_a_frame_that_another_job_may_make(tmp_path: Path, line: str, macro: str, is_left: bool) -> None:
    files = {"A.JBI": job(line), "B.JBI": job("newword uf#(1)", name="B", macro=macro)}
    found = read_programs(tmp_path, files)["A.JBI"].positions
    assert bool(found.barred) is is_left
