"""Modules that set many displacements: those that do the same are one, and none is lost."""

import pytest

from cellcal.drivers.program_registry import read_program

_TARGET = "[[500,0,300],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
_COUNT = 60


def module(setting: str, *, ends: bool) -> bytes:
    data = "".join(
        f"CONST robtarget p{i}:={_TARGET};\nCONST pose d{i}:=[[{i},0,0],[1,0,0,0]];\n" for i in range(_COUNT)
    )
    end = "PDispOff;\n" if ends else ""
    lines = "".join(
        f"{setting.format(i)};\nMoveL p{i},v100,fine,tool0;\n{end}IF a THEN\nENDIF\n" for i in range(_COUNT)
    )
    return f"MODULE A\n{data}PROC main()\nWHILE TRUE DO\n{lines}ENDWHILE\nENDPROC\nENDMODULE\n".encode()


@pytest.mark.parametrize("setting", ["PDispSet d", "PDispSet d1", "PDispSet d{}", "PDispOn p{},tool0"])
def test_what_nothing_ends_displaces_every_point_a_few_times(setting: str) -> None:
    shifts = read_program("A.MOD", module(setting, ends=False)).positions.shifts
    displaced = [shift for shift in shifts if shift.rows]
    assert all(shift.rows == tuple(range(_COUNT)) for shift in displaced)
    assert 1 <= len(displaced) <= 17


@pytest.mark.parametrize("setting", ["PDispSet d", "PDispSet d1", "PDispSet d{}"])
def test_what_ends_displaces_the_points_before_its_end(setting: str) -> None:
    shifts = read_program("A.MOD", module(setting, ends=True)).positions.shifts
    assert [shift.rows for shift in shifts if shift.rows] == [(row,) for row in range(_COUNT)]


def test_further_sizes_without_an_end_are_of_any_size() -> None:
    shifts = read_program("A.MOD", module("PDispSet d{}", ends=False)).positions.shifts
    displaced = [shift for shift in shifts if shift.rows]
    assert [shift.quaternion for shift in displaced].count(None) == 1
    assert all(shift.rows == tuple(range(_COUNT)) for shift in displaced)
