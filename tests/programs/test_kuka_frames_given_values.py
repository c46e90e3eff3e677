"""What a KRL program or one beside it does to frames at any time, in any folder, and frame data that are not in force."""

from pathlib import Path

import pytest

from tests.programs import test_kuka_two_bases as krl
from tests.programs.test_across_files import POINT, dat_file, read_programs, src_file

NUMBERS = "{X 10.0,Y 20.0,Z 30.0,A 5.0,B 0.0,C 0.0}"
TAKEN = (
    f"BASE_DATA[3]={NUMBERS}",
    "$TOOL=TOOL_DATA[1]",
    "$BASE=BASE_DATA[3]",
    "LIN {X 1,Y 2,Z 3,A 0,B 0,C 0}",
)
HANDLER = f"INTERRUPT DECL 3 WHEN $IN[1] DO h()\nEND\nDEF h()\nBASE_DATA[3]={NUMBERS.replace('10', '99')}"
SETS = "BASE_DATA[3]={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0}"


@pytest.mark.parametrize(
    ("place", "other", "text", "left"),
    [
        ("k.src", "below/o.src", src_file("O", HANDLER), True),
        ("own/k.src", "o.src", src_file("O", HANDLER), True),
        ("Program/k.src", "System/sps.sub", src_file("SPS", SETS), True),
        (
            "one/k.src",
            "other/sps.sub",
            src_file("SPS", SETS),
            True,
        ),  # no R1 says that it is another controller
        ("k.src", "below/o.src", src_file("O", SETS), False),  # does not run at any time
        ("one/R1/k.src", "other/R1/sps.sub", src_file("SPS", SETS), False),
        ("one/R1/k.src", "one/R1/System/sps.sub", src_file("SPS", SETS), True),
    ],
)
def test_what_runs_at_any_time_counts_in_any_folder_of_a_controller(
    tmp_path: Path, place: str, other: str, text: str, left: bool
) -> None:
    positions = read_programs(tmp_path, {place: src_file("K", *TAKEN), other: text})[place].positions
    assert bool(positions.barred) is left


@pytest.mark.parametrize("statement", ["BASE_DATA[1].X=5", "$ROBROOT.X=5"])
def test_an_entry_set_in_a_folder_below_leaves_the_points_above(tmp_path: Path, statement: str) -> None:
    own = src_file("K", "$TOOL=TOOL_DATA[1]", "$BASE=BASE_DATA[1]", TAKEN[-1])
    files = {"k.src": own, "below/o.src": src_file("O", statement)}
    assert read_programs(tmp_path, files)["k.src"].positions.barred


TAUGHT = ("PDAT_ACT=PP1", "FDAT_ACT=FP1", "BAS(#PTP_PARAMS,100)", "PTP XP1")
LIST = dat_file(
    "K", f"DECL E6POS XP1={POINT}", 'DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " "}'
)


@pytest.mark.parametrize(
    ("lines", "more", "left"),
    [
        (TAUGHT, "", False),
        (("setf(FP1)", *TAUGHT), "DEF setf(f:OUT)\nDECL FDAT f\nf.BASE_NO=1\nEND\n", True),
        (("setf(FP1)", *TAUGHT), "DEF setf(f:IN)\nDECL FDAT f\nEND\n", False),
        (("LIN XP1 WITH $TOOL=STOOL2(FP1), $BASE=SBASE(FP1)",), "", False),
        (("$TOOL=TOOL_DATA[1]", "$BASE=BASE_DATA[1]", "FDAT_ACT=FP1", "LIN XP1"), "", True),
        (("IF x THEN", "FDAT_ACT=FP1", "ENDIF", "BAS(#CP_PARAMS,2)", "LIN XP1"), "", True),
    ],
    ids=["taught", "passed", "passed_in", "with", "not_in_force", "in_a_branch"],
)
def test_frame_data_count_where_they_are_in_force(
    tmp_path: Path, lines: tuple[str, ...], more: str, left: bool
) -> None:
    files = {"k.src": src_file("K", *lines) + more, "k.dat": LIST}
    positions = read_programs(tmp_path, files)["k.dat"].positions
    assert bool(positions.barred) is left


def test_a_coupled_base_leaves_the_points_below_it() -> None:
    line = krl.LINE.format(10)
    assert krl.positions_of(krl.SET.format(1) + "$ACT_EX_AX=1\n" + line).barred
    assert not krl.positions_of(krl.SET.format(1) + "$ACT_EX_AX=0\n" + line).barred
