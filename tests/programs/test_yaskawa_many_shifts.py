"""Jobs that switch many shifts: what is found grows with the motions, not with motions times shifts."""

import pytest

from cellcal.drivers.program_registry import read_program
from cellcal.drivers.yaskawa.program_files.job_variables import (
    computed_variables,
    filled_variables,
    turned_amounts,
)
from tests.programs.test_yaskawa_unknown_instructions import JOB

_HEAD, _TAIL = JOB.split("C00001=")
_COUNT = 400


def job_of_shifts(amount: str, *, loops: bool) -> bytes:
    points = "\n".join(
        f"C{i:05d}={700 + i}.000,0.000,500.000,180.0000,0.0000,0.0000" for i in range(1, _COUNT)
    )
    lines = "\n".join(
        f"SFTON {amount.format(i)} UF#(1)\nMOVL C{i:05d} V=50.0\nCALL JOB:B" for i in range(_COUNT)
    )
    head = _HEAD.replace("NPOS 2,", f"NPOS {_COUNT},") + points
    rest = _TAIL.partition("\n")[2].format(
        lines=f"*AGAIN\n{lines}\nJUMP *AGAIN" if loops else lines, macro=""
    )
    return f"{head.format(name='A')}\n{rest}".encode()


@pytest.mark.parametrize("loops", [False, True])
@pytest.mark.parametrize(("amount", "most"), [("P001", 1), ("LP001", 1), ("P{:05d}", 17)])
def test_shifts_that_do_the_same_are_one_for_each_point(amount: str, most: int, loops: bool) -> None:
    found = read_program("A.JBI", job_of_shifts(amount, loops=loops)).positions
    of_points = [shift for shift in found.shifts if shift.rows]
    assert {row for shift in of_points for row in shift.rows} == set(range(_COUNT))
    assert len(of_points) <= most * _COUNT
    assert len(found.shifts) - len(of_points) <= most


def test_further_amounts_that_nothing_fills_may_turn_too() -> None:
    found = read_program("A.JBI", job_of_shifts("P{:05d}", loops=True)).positions
    last = [shift for shift in found.shifts if shift.rows == (_COUNT - 1,)]
    assert {shift.quaternion for shift in last} == {None}
    assert {"SFTON", "SFTON P000"} <= {shift.what for shift in last}


@pytest.mark.parametrize("backwards", [False, True])
def test_a_chain_of_copies_is_followed_in_either_order(backwards: bool) -> None:
    lines = [("GETS", "PX000 $PX001", [0])]
    lines += [("SET", f"P{i:05d} P{i - 1:05d}", [i, i - 1]) for i in range(1, 2000)]
    lines += [("MSHIFT", "P02000 UF#(1) P00000 P00001", [2000, 0, 1]), ("SET", "P02001 P02000", [2001, 2000])]
    if backwards:
        lines.reverse()
    instructions = [(number, word, rest) for number, (word, rest, _) in enumerate(lines, 1)]
    assert computed_variables(instructions).from_here == set(range(2002))
    assert turned_amounts(lines) == {2000, 2001}
    assert filled_variables(lines, set()) == set(range(2002))
    assert filled_variables([one for one in lines if one[0] != "GETS"], set()) == set()
