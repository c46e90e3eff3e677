"""Pseudo instructions among a job's positions that no document names, as newer controllers write them."""

import pytest

from cellcal.drivers.program_registry import read_program
from cellcal.drivers.programs.errors import ProgramFileError

JOB = """/JOB
//NAME A
//POS
///NPOS 3,0,0,0,0,0
///TOOL 1
///POSTYPE BASE
///RECTAN
///RCONF 1,0,0,0,0,0,0,0
C00000=700.000,0.000,500.000,180.0000,0.0000,0.0000
{on}
C00001=710.000,0.000,500.000,180.0000,0.0000,0.0000
{off}
C00002=720.000,0.000,500.000,180.0000,0.0000,0.0000
//INST
///DATE 2025/05/21 10:37
///ATTR SC,RW
///GROUP1 RB1
NOP
MOVJ C00000 VJ=10.00
MOVL C00001 V=100.0
MOVL C00002 V=100.0
END
"""


def test_positions_below_an_unknown_switch_are_left_and_the_others_are_read() -> None:
    text = JOB.format(on="///LIMIT ON", off="///LIMIT OFF")
    positions = read_program("A.JBI", text.encode()).positions
    assert list(positions.barred) == [1]
    assert "///LIMIT ON" in positions.barred[1]


@pytest.mark.parametrize("first_off", ["OTHER", "LIMIT"])
def test_a_switch_stays_on_when_another_is_switched_off(first_off: str) -> None:
    text = JOB.format(on="///LIMIT ON\n///OTHER ON", off=f"///{first_off} OFF")
    positions = read_program("A.JBI", text.encode()).positions
    assert list(positions.barred) == [1, 2]
    assert {"OTHER": "///LIMIT", "LIMIT": "///OTHER"}[first_off] in positions.barred[2]


@pytest.mark.parametrize(("on", "off", "at"), [("///LIMIT", "", 10), ("///LIMIT ON", "///OTHER OFF", 12)])
def test_what_is_no_switch_of_its_own_is_refused(on: str, off: str, at: int) -> None:
    with pytest.raises(ProgramFileError, match="not understood among positions") as refused:
        read_program("A.JBI", JOB.format(on=on, off=off).encode())
    assert refused.value.line == at


def test_an_instruction_that_is_switched_off_does_nothing() -> None:
    text = JOB.format(on="", off="").replace("MOVL C00001 V=100.0", "//MOVL C00001 V=100.0\n//SFTON P010")
    positions = read_program("A.JBI", text.encode()).positions
    assert not positions.barred
    assert not positions.shifts
    lost = JOB.format(on="", off="").replace("END\n", "//NAME B\nEND\n")
    with pytest.raises(ProgramFileError, match="is not understood"):
        read_program("A.JBI", lost.encode())
