"""Frame data, $BASE and $TOOL of KUKA programs that get another value while the program runs."""

import pytest

from cellcal.drivers.programs.barred import COMPUTED, OVERWRITTEN, SOURCE_OF_TARGET
from tests.programs.test_across_files import dat_file, frames_of_position, read_programs, src_file

POINT = "{X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 2,T 2}"
DATA = "{{TOOL_NO 1,BASE_NO {},IPO_FRAME #BASE}}"
POINTS = (
    *(f"DECL E6POS X{name}={POINT}" for name in ("P1", "P2", "P3")),
    f"DECL FDAT FP1={DATA.format(1)}",
    f"DECL FDAT FP2={DATA.format(2)}",
)
TO_P1 = ("FDAT_ACT=FP1", "BAS(#CP_PARAMS,2)", "LIN XP1")
SET_BOTH = ("$BASE=BASE_DATA[1]", "$TOOL=TOOL_DATA[1]")
WRITTEN_FRAMES = ("$TOOL={X 0,Y 0,Z 150,A 0,B 0,C 0}", "$BASE={X 1600,Y 0,Z 0,A 0,B 0,C 0}")
TAKING_FRAME = ("END", "DEF SETIT(F:OUT)", "DECL FRAME F", "F=BASE_DATA[2]")


@pytest.mark.parametrize(
    ("lines", "name", "expected"),
    [
        (("FP1.BASE_NO=2", *TO_P1), "XP1", COMPUTED),
        (("fp1 . tool_no = 2", *TO_P1), "XP1", COMPUTED),
        (("FP1=FP2", *TO_P1), "XP1", COMPUTED),
        (("FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}", *TO_P1), "XP1", COMPUTED),
        ((*TO_P1, "FP1.BASE_NO=n"), "XP1", COMPUTED),  # the second time that the program runs
        (("FP1=FP2", *TO_P1, "LIN XP3"), "XP3", COMPUTED),  # taken with the same data
        (("FDAT_ACT=FP1", "FDAT_ACT.BASE_NO=2", "BAS(#CP_PARAMS,2)", "LIN XP1"), "XP1", COMPUTED),
        (
            (*TO_P1, "FDAT_ACT={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}", "BAS(#CP_PARAMS,2)", "LIN XP1"),
            "XP1",
            COMPUTED,
        ),
        (("FP2=FP1", *TO_P1), "XP1", ("1", "1")),
        (("IF FP1.BASE_NO==1 THEN", "ENDIF", *TO_P1), "XP1", ("1", "1")),
        (("FP9.BASE_NO=2", *TO_P1), "XP1", ("1", "1")),
    ],
)
def test_frame_data_that_a_program_sets_leave_their_points(lines, name, expected, tmp_path):
    files = {"a.dat": dat_file("A", *POINTS), "a.src": src_file("A", *lines)}
    assert frames_of_position(read_programs(tmp_path, files)["a.dat"], name) == expected


def test_frame_data_of_all_programs_are_set_by_any_of_them(tmp_path):
    shown = [line.replace("DECL", "DECL GLOBAL") for line in POINTS]
    files = {
        "a.dat": dat_file("A", *shown, public="PUBLIC"),
        "a.src": src_file("A", *TO_P1),
        "b.src": src_file("B", "FP1.BASE_NO=2"),
        "c.dat": dat_file("C", *POINTS),  # data of its own, which B does not see
        "c.src": src_file("C", *TO_P1),
    }
    found = read_programs(tmp_path, files)
    assert frames_of_position(found["a.dat"], "XP1") == COMPUTED
    assert frames_of_position(found["c.dat"], "XP1") == ("1", "1")


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (("SETIT($BASE)", f"LIN {POINT}", *TAKING_FRAME), COMPUTED),
        (("SETIT( $tool )", f"LIN {POINT}", *TAKING_FRAME), COMPUTED),
        (("IF CLOSE($BASE) THEN", "ENDIF", f"LIN {POINT}"), COMPUTED),  # not given: it may set it
        (("SETIT($BASE.X)", f"LIN {POINT}", *TAKING_FRAME), COMPUTED),
        (("SETIT($BASE)", f"LIN {POINT}", TAKING_FRAME[0], "DEF SETIT(F:IN)", "DECL FRAME F"), ("1", "1")),
    ],
)
def test_a_call_that_gets_the_base_may_set_it(lines, expected, tmp_path):
    found = read_programs(tmp_path, {"a.src": src_file("A", *SET_BOTH, *lines)})["a.src"]
    name = next(name for name in found.positions.names if name.startswith("LIN@"))
    assert frames_of_position(found, name) == expected


def test_a_base_in_the_world_is_the_null_frame(tmp_path):
    lines = ("$BASE = $WORLD", "$TOOL=TOOL_DATA[1]", f"LIN {POINT}")
    found = read_programs(tmp_path, {"a.src": src_file("A", *lines)})["a.src"]
    assert frames_of_position(found, "LIN@4") == ("1", "0")


def test_points_that_a_target_is_computed_from_have_that_reason(tmp_path):
    lines = (*SET_BOTH, "LIN OFF:XP1", "LIN SHIFTED(XP2,50.0)", "LIN XP3")
    data = dat_file("A", *POINTS[:3], "DECL FRAME OFF={X 5,Y 0,Z 0,A 0,B 0,C 0}")
    found = read_programs(tmp_path, {"a.dat": data, "a.src": src_file("A", *lines)})["a.dat"]
    assert frames_of_position(found, "XP1") == SOURCE_OF_TARGET
    assert frames_of_position(found, "XP2") == SOURCE_OF_TARGET
    assert frames_of_position(found, "XP3") == ("1", "1")


def test_the_submit_interpreter_counts_as_a_program(tmp_path):
    config = dat_file("$CONFIG", f"DECL GLOBAL E6POS GP1={POINT}", public="PUBLIC")
    submit = src_file("SPS", "LOOP", "GP1.Z=10", "BASE_DATA[2].X=5", "ENDLOOP")
    files = {
        "$config.dat": config,
        "a.dat": dat_file("A", *POINTS),
        "a.src": src_file("A", *SET_BOTH, "LIN GP1", *TO_P1),
        "sps.sub": submit,
    }
    found = read_programs(tmp_path, files)
    assert frames_of_position(found["$config.dat"], "GP1") == OVERWRITTEN
    assert frames_of_position(found["a.dat"], "XP2") == COMPUTED
    assert frames_of_position(found["a.dat"], "XP1") == ("1", "1")


IN_BASE_2 = ("FDAT_ACT=FP2", "BAS(#CP_PARAMS,2)", "LIN XP2")
COPY = ("XH=XP1", "XH.Z=XH.Z+100", "LIN XH")
INTERRUPTED = "INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO RETREAT ( )"
COPIED_OTHERWISE = "it was taught in another frame than a.src sets where it moves to a copy of it"


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ((*IN_BASE_2, *COPY), COPIED_OTHERWISE),  # in the base of the form before it
        ((*TO_P1, *COPY), ("1", "1")),
        ((*TO_P1, "IF $IN[1] THEN", *IN_BASE_2, "ENDIF", *COPY), COPIED_OTHERWISE),
        ((*IN_BASE_2, "GRIP()", *COPY), COPIED_OTHERWISE),
        ((*IN_BASE_2, "OVER()", "END", "DEF OVER()", *COPY), COPIED_OTHERWISE),  # the caller's base
        ((*TO_P1, "OVER()", "END", "DEF OVER()", *COPY), ("1", "1")),
        ((*IN_BASE_2, *TO_P1, *COPY), ("1", "1")),
        (
            (INTERRUPTED, *TO_P1, *COPY, "END", "DEF RETREAT()", "$BASE=BASE_DATA[2]"),
            COPIED_OTHERWISE,
        ),
        (
            (INTERRUPTED, *TO_P1, *COPY, "END", "DEF RETREAT()", "$OUT[1]=FALSE"),
            ("1", "1"),
        ),
        (COPY, ("1", "1")),  # nothing is known of the base
    ],
)
def test_a_copy_is_moved_to_in_the_base_of_the_inline_forms_before_it(lines, expected, tmp_path):
    files = {"a.dat": dat_file("A", *POINTS), "a.src": src_file("A", "DECL E6POS XH", *lines)}
    assert frames_of_position(read_programs(tmp_path, files)["a.dat"], "XP1") == expected


@pytest.mark.parametrize(
    ("others", "expected"),
    [
        ({}, "written"),
        ({"b.src": src_file("B", *WRITTEN_FRAMES, "LIN XP2")}, "written"),
        (
            {"b.src": src_file("B", WRITTEN_FRAMES[0], "$BASE={X 1,Y 0,Z 0,A 0,B 0,C 0}", "LIN XP1")},
            "different",
        ),
        (
            {"b.src": src_file("B", "$TOOL={X 0,Y 0,Z 9,A 0,B 0,C 0}", WRITTEN_FRAMES[1], "LIN XP1")},
            "different",
        ),
    ],
)
def test_frames_written_out_in_one_file_count_for_points_of_another(others, expected, tmp_path):
    data = dat_file(
        "$CONFIG", *(f"DECL GLOBAL E6POS X{name}={POINT}" for name in ("P1", "P2")), public="PUBLIC"
    )
    files = {"a.src": src_file("A", *WRITTEN_FRAMES, "LIN XP1"), "$config.dat": data, **others}
    program = read_programs(tmp_path, files)["$config.dat"]
    found = frames_of_position(program, "XP1")
    if expected == "written":
        tool, base = found
        assert program.frames.flange_tip[tool].position_m == (0.0, 0.0, 0.15)
        assert program.frames.base_frame[base].position_m == (1.6, 0.0, 0.0)
    else:
        assert expected in found
