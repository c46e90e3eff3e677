"""Which tool and base moves to KUKA points without frame data of their own are done with."""

import pytest

from tests.programs.test_across_files import dat_file, frames_of_position, read_programs, src_file

POINT = "{X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2}"
DATA = "{{TOOL_NO {},BASE_NO {},IPO_FRAME #{}}}"
POINTS = (
    *(f"DECL E6POS X{name}={POINT}" for name in ("P0", "P1", "P2", "P3", "P4", "P9")),
    f"DECL FDAT FP0={DATA.format(1, 0, 'BASE')}",
    f"DECL FDAT FP9={DATA.format(0, 0, 'BASE')}",
    f"DECL FDAT FP1={DATA.format(1, 2, 'BASE')}",
    f"DECL FDAT FP3={DATA.format(3, 4, 'BASE')}",
    f"DECL FDAT FS1={DATA.format(5, 6, 'BASE')}",
    f"DECL FDAT FOUT={DATA.format(5, 6, 'TCP')}",
)
P1 = ("FDAT_ACT=FP1", "BAS(#PTP_PARAMS,100)", "PTP XP1")
CIRCLE = ("LDAT_ACT=LCPDAT1", "FDAT_ACT=FP3", "BAS(#CP_PARAMS,2)", "CIRC XP2, XP3")
COMPUTED = "its tool or base is set while the program runs"


def block(data: str, *segments: str) -> tuple[str, ...]:
    header = f"SPLINE WITH $VEL=SVEL_CP(0.2,,L1), $TOOL=STOOL2({data}), $BASE=SBASE({data}.BASE_NO), $ACC=SACC_CP(L1)"
    return (header, *segments, "ENDSPLINE")


@pytest.mark.parametrize(
    ("lines", "name", "expected"),
    [
        ((*P1, *CIRCLE), "XP2", ("3", "4")),  # the circle's auxiliary point has none of its own
        ((*P1, *CIRCLE), "XP3", ("3", "4")),
        ((*P1, "LIN XP4"), "XP4", ("1", "2")),  # behind an inline form
        ((*P1, "IF $IN[1] THEN", "$OUT[1]=TRUE", "ENDIF", "LIN XP4"), "XP4", ("1", "2")),
        ((*P1, "IF $IN[1] THEN", *CIRCLE, "ENDIF", "LIN XP4"), "XP4", COMPUTED),
        ((*P1, "IF $IN[1] THEN", *CIRCLE, "ELSE", "LIN XP4", "ENDIF"), "XP4", ("1", "2")),
        ((*P1, "SUB()", "LIN XP4"), "XP4", COMPUTED),  # what is called may move
        ((*P1, "LOOP", "LIN XP4", *CIRCLE, "ENDLOOP"), "XP4", COMPUTED),  # from the circle the second time
        ((*P1, "GOTO M1", *CIRCLE, "M1:", "LIN XP4"), "XP4", COMPUTED),
        (("FDAT_ACT=FOUT", "BAS(#CP_PARAMS,2)", "LIN XP4"), "XP4", "external tool"),
        (("FDAT_ACT=FGONE", "BAS(#CP_PARAMS,2)", "LIN XP4"), "XP4", COMPUTED),
        ((*P1, "$BASE=BASE_DATA[9]", "LIN XP1"), "XP1", COMPUTED),  # not the base that it was taught in
        ((*P1, "SUB()", "LIN XP1"), "XP1", COMPUTED),
        (P1, "XP1", ("1", "2")),
        (block("FS1", "SPL XP1", "SLIN XP2", "SCIRC XP2, XP4"), "XP2", ("5", "6")),
        (block("FS1", "SPL XP1", "SLIN XP2", "SCIRC XP2, XP4"), "XP4", ("5", "6")),
        ((*P1, *block("FS1", "SPL XP2"), "LIN XP4"), "XP4", ("1", "2")),  # a block's settings end with it
        (
            ("SCIRC XP2, XP3 WITH $TOOL=STOOL2(FP3), $BASE=SBASE(FP3.BASE_NO)",),
            "XP2",
            ("3", "4"),
        ),
        (("SLIN XP4 WITH $TOOL=STOOL2(FP3), $BASE=SBASE(FP1.BASE_NO)",), "XP4", COMPUTED),
        (("SLIN XP4 WITH $TOOL=STOOL2(FP3), $BASE=BASE_DATA[2]",), "XP4", COMPUTED),
        ((*CIRCLE, *P1, "LIN XP2"), "XP2", "different tools or frames"),
        (("BAS(#INITMOV,0)", "BAS(#TOOL,1)", "LIN XP1"), "XP1", "taught with another tool or frame"),
        (("BAS(#INITMOV,0)", "BAS(#TOOL,1)", "LIN XP0"), "XP0", ("1", "0")),
        (("BAS(#INITMOV,0)", "LIN XP0"), "XP0", ("1", "0")),  # which sets tool 1
        (("BAS(#INITMOV,0)", "LIN XP9"), "XP9", "taught with another tool or frame"),
        (("BAS(#INITMOV,0)", "INIT_CELL()", "LIN XP1"), "XP1", ("1", "2")),  # it may set both
        (("BAS(#INITMOV,0)", "BAS(#TOOL,1)", "XP4=XP1", "LIN XP4"), "XP1", "taught in another frame"),
        (
            ("BAS(#INITMOV,0)", "XP4=XP1", "BAS(#TOOL,1)", "LIN XP4", *CIRCLE),
            "XP1",
            "taught in another frame",
        ),
        (("BAS(#INITMOV,0)", "BAS(#TOOL,1)", "XP4=XP0", "LIN XP4"), "XP0", ("1", "0")),
        (("XP3=XP1", "FDAT_ACT=FP3", "BAS(#CP_PARAMS,2)", "LIN XP3"), "XP1", "taught in another frame"),
    ],
)
def test_a_move_takes_the_frames_in_force(lines, name, expected, tmp_path):
    files = {"a.dat": dat_file("A", *POINTS), "a.src": src_file("A", *lines)}
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], name)
    assert found == expected if isinstance(expected, tuple) else expected in found


def test_a_spline_block_leaves_the_frames_outside_as_they_were(tmp_path):
    lines = (*P1, "SPLINE", "SPL XP2", "ENDSPLINE", "LIN XP4")
    files = {"a.dat": dat_file("A", *POINTS), "a.src": src_file("A", *lines)}
    assert frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP4") == ("1", "2")


@pytest.mark.parametrize(("base", "expected"), [(2, ("1", "2")), (4, "taught in another frame")])
def test_a_copy_that_is_passed_to_a_routine_counts_where_the_routine_goes_to_it(base, expected, tmp_path):
    routine = ("DEF MB(P :IN)", "DECL E6POS P, Y", "Y = P", f"BAS(#BASE,{base})", "LIN Y")
    lines = (*P1, "XP4 = XP1", "MB(XP4)", "END", *routine)
    files = {"a.dat": dat_file("A", *POINTS), "a.src": src_file("A", *lines)}
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1")
    assert found == expected if isinstance(expected, tuple) else expected in found


@pytest.mark.parametrize(("base", "expected"), [(2, ("1", "2")), (4, "taught in another frame")])
def test_a_base_that_a_called_routine_leaves_counts_for_a_copy(base, expected, tmp_path):
    routine = ("DEF MB(P :IN)", "DECL E6POS P", f"BAS(#BASE,{base})", "LIN P")
    lines = ("BAS(#TOOL,1)", "BAS(#BASE,2)", "XP4 = XP1", "MB(XP2)", "LIN XP4", "END", *routine)
    files = {"a.dat": dat_file("A", *POINTS), "a.src": src_file("A", *lines)}
    found = frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1")
    assert found == expected if isinstance(expected, tuple) else expected in found
