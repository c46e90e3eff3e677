"""Listings of people and generators with fewer decimals than a controller writes: new values are not rounded to them."""

import re
from pathlib import Path

from cellcal.service.exit_codes import ExitCode
from tests.programs.test_absent_places import LISTING, fanuc
from tests.programs.test_field_cases import move_program

OFFSET = "1.234,-2.345,0.123,0,0,2.4"


def numbers_of(lines: list[str]) -> list[float]:
    found = re.findall(r"\b[XYZWPR]\s*=\s*(-?[\d.]+)\s+(?:mm|deg)", "\n".join(lines))
    return [float(text) for text in found]


def test_a_whole_number_takes_three_decimals(tmp_path: Path) -> None:
    assert numbers_of(LISTING.splitlines())
    plain = fanuc("L P[1] 100mm/sec FINE")
    short = re.sub(r"(= *-?\d+)\.\d+(?=\s+(?:mm|deg))", r"\1", plain)
    long = re.sub(r"(= *-?\d+)(?=\s+(?:mm|deg))", r"\1.000", short)
    assert short != long
    moved = [
        move_program(tmp_path / name, "fanuc", "offset_pr.LS", offset=OFFSET, text=text)
        for name, text in (("short", short), ("long", long))
    ]
    assert [one.code for one in moved] == [ExitCode.PASS] * 2
    new = [numbers_of(one.lines) for one in moved]
    assert new[0] == new[1]
    assert new[0] != numbers_of(short.splitlines())
