"""A KUKA program is its text and its data list: an axis that one of them carries elsewhere counts for both."""

import pytest

from cellcal.drivers.program_registry import read_program
from cellcal.service.engineering.programs.external.point_reasons import BESIDE_EXTERNAL, EXTERNAL
from cellcal.service.engineering.programs.program_points import points_of
from cellcal.service.engineering.programs.project import read_project
from tests.programs.test_field_cases import CASES

POINT = "{X -59.856,Y -325.164,Z 612.070,A 132.8375,B 43.2907,C -157.3346,S 2,T 34}"
CARRIED = POINT.replace("}", ",E1 100.0}")
PARTIAL = "it leaves coordinates to what the robot has at that moment"


@pytest.mark.parametrize(
    ("moves", "points", "reasons"),
    [
        ("LIN XP1\nPTP {E1 100}\nLIN XP2", (POINT, POINT), [PARTIAL, BESIDE_EXTERNAL, BESIDE_EXTERNAL]),
        ("LIN XP1\nPTP {E1 0}\nLIN XP2", (POINT, POINT), [PARTIAL, "", ""]),
        (f"PTP XP1\nLIN XP2\nLIN {POINT}", (CARRIED, POINT), [BESIDE_EXTERNAL, EXTERNAL, BESIDE_EXTERNAL]),
        (f"LIN XP1\nLIN XP2\nLIN {CARRIED}", (POINT, POINT), [EXTERNAL, BESIDE_EXTERNAL, BESIDE_EXTERNAL]),
    ],
)
def test_points_of_either_file_are_left_where_an_axis_stands_elsewhere(moves, points, reasons) -> None:
    text = f"DEF A()\n$TOOL=TOOL_DATA[1]\n$BASE=BASE_DATA[1]\n{moves}\nEND\n"
    data = "".join(f"DECL E6POS XP{number}={point}\n" for number, point in enumerate(points, 1))
    programs = [
        read_program("A.src", text.encode()),
        read_program("A.dat", f"DEFDAT A\n{data}ENDDAT\n".encode()),
        read_program("B.dat", f"DEFDAT B\nDECL E6POS XP1={POINT}\nENDDAT\n".encode()),
    ]
    found = points_of(programs, read_project(CASES / "kuka" / "project.toml"))
    assert [one if "external" in one or one == PARTIAL else "" for one in found.reasons[:-1]] == reasons
    assert "external" not in found.reasons[-1]
