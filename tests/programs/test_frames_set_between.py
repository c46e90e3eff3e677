"""Ways by which another frame comes between a setting in numbers and a move: loops, handlers, names in quotes."""

from pathlib import Path

import pytest

from cellcal.drivers.program_registry import read_program
from tests.programs import test_abb_frames_in_numbers as rapid
from tests.programs import test_fanuc_frames_in_numbers as listings
from tests.programs import test_kuka_two_bases as krl
from tests.programs.test_across_files import rapid_module, read_programs

OTHER = f"PROC other()\n{rapid.SET_2}\nENDPROC"
BY_NAME = 'SetAllDataVal "wobjdata"\\Object:="Frame1", w2;'


@pytest.mark.parametrize(
    ("lines", "routines"),
    [
        ([*rapid.BEGIN, "WHILE di1=1 DO", rapid.MOVE, "other;", "ENDWHILE"], OTHER),
        ([*rapid.BEGIN, "FOR i FROM 1 TO 2 DO", rapid.MOVE, "other;", "ENDFOR"], OTHER),
        ([*rapid.BEGIN, rapid.MOVE.replace("MoveL", "MoveLSync").replace(";", ', "other";')], OTHER),
        ([*rapid.BEGIN, 'SetDataVal "Frame1", w2;', rapid.MOVE], ""),
        ([*rapid.BEGIN, BY_NAME, rapid.MOVE], ""),
        ([*rapid.BEGIN, rapid.MOVE, "ERROR", "other;", "RETRY;"], OTHER),
        ([*rapid.BEGIN, "main;", rapid.MOVE, rapid.SET_2], ""),
        ([*rapid.BEGIN, "again;", rapid.MOVE, rapid.SET_2], "PROC again()\nmain;\nENDPROC"),
    ],
    ids=["while", "for", "sync", "by_name", "by_names", "handler", "itself", "circle"],
)  # fmt: skip
def test_a_rapid_move_is_left_where_another_setting_may_come_between(lines: list[str], routines: str) -> None:
    assert rapid.places(rapid.read(*lines, routines=routines)) == [None]


def test_a_rapid_call_that_sets_the_same_numbers_changes_nothing() -> None:
    same = OTHER.replace(rapid.SET_2, rapid.SET_1)
    body = ["WHILE di1=1 DO", rapid.MOVE, "other;", "ENDWHILE", "ERROR", "TRYNEXT;"]
    assert rapid.places(rapid.read(*rapid.BEGIN, *body, routines=same)) == [807.8]
    handled = rapid.read(*rapid.BEGIN, rapid.MOVE, "other;", "ERROR", "RETRY;", routines=OTHER)
    assert rapid.places(handled) == [807.8]


@pytest.mark.parametrize(
    ("other", "left"),
    [
        (f"PROC n()\n{BY_NAME}\nENDPROC", True),
        ("PROC n()\nSetDataVal name, w2;\nENDPROC", True),
        ('PROC n()\nSetDataVal "q1", w2;\nENDPROC', False),
        ("TRAP hit\nother;\nENDTRAP", True),
        ("TRAP hit\nSetDO do1, 1;\nENDTRAP", False),
    ],
)
def test_another_module_may_set_what_it_does_not_name(tmp_path: Path, other: str, left: bool) -> None:
    own = rapid.module_of(*rapid.BEGIN, rapid.MOVE, routines=OTHER)
    found = read_programs(tmp_path, {"m.mod": own, "n.mod": rapid_module("n", other)})["m.mod"]
    assert bool(found.positions.barred) is left


FIRST, LAST = krl.SET.format(1) + krl.LINE.format(10), krl.LINE.format(11)


@pytest.mark.parametrize(
    ("body", "left"),
    [
        (FIRST + krl.SET.format(2) + "LOOP\n" + LAST + "sub()\nENDLOOP\n", [1]),
        (FIRST + krl.SET.format(2) + "LOOP\nREPEAT\n" + LAST + "UNTIL x\nsub()\nENDLOOP\n", [1]),
        (FIRST + "LOOP\n" + krl.SET.format(2) + LAST + "sub()\nENDLOOP\n", []),
        (FIRST + "BAS(command,2)\n" + LAST, [1]),
        ("INTERRUPT DECL 3 WHEN $IN[1] DO $BASE=BASE_DATA[2]\n" + FIRST + LAST, [0, 1]),
        ("TRIGGER WHEN PATH=1 DELAY=0 DO $BASE=BASE_DATA[2]\n" + FIRST + LAST, [0, 1]),
    ],
    ids=["loop", "two_loops", "set_again", "chosen", "interrupt", "trigger"],
)  # fmt: skip
def test_a_krl_move_is_left_where_another_setting_may_come_between(body: str, left: list[int]) -> None:
    assert sorted(krl.positions_of(body).barred) == left


def test_a_krl_loop_that_calls_another_file_below_the_move(tmp_path: Path) -> None:
    for body, left in (
        (LAST + "sub()\n", [1]),
        ("$TOOL=TOOL_DATA[1]\n" + krl.SET.format(2) + LAST + "sub()\n", []),
    ):
        text = f"DEF k()\n$TOOL=TOOL_DATA[1]\n{FIRST}{krl.SET.format(2)}LOOP\n{body}ENDLOOP\nEND\n"
        found = read_programs(tmp_path, {"k.src": text, "sub.src": krl.SUB})["k.src"]
        assert sorted(found.positions.barred) == left


BEGIN = [*listings.FIRST, *listings.TOOL]


def test_a_listing_that_calls_itself_may_come_back_with_other_frames(tmp_path: Path) -> None:
    again = [*BEGIN, "  CALL {}", listings.move(1), *listings.SECOND, *listings.TOOL, listings.move(2)]
    itself = listings.read(*[line.format("RDK") for line in again], count=2)
    assert listings.places(itself) == [None, 507.8]
    files = {
        "RDK.LS": listings.listing(*[line.format("NEXT") for line in again], count=2),
        "NEXT.LS": listings.listing("  CALL RDK", count=0, name="NEXT"),
    }
    assert listings.places(read_programs(tmp_path, files)["RDK.LS"]) == [None, 507.8]


@pytest.mark.parametrize("started", ["RUN RDK", "RUN OTHER", "DO[1]=ON"])
def test_a_listing_beside_others_that_run_is_left_where_one_sets_frames(tmp_path: Path, started: str) -> None:
    files = {
        "RDK.LS": listings.listing(*BEGIN, listings.move(1), count=1),
        "MAIN.LS": listings.listing(f"  {started}", "  CALL RDK", "  CALL OTHER", count=0, name="MAIN"),
        "OTHER.LS": listings.listing(*listings.SECOND, count=0, name="OTHER"),
    }
    left = None if started.startswith("RUN") else 807.8
    assert listings.places(read_programs(tmp_path, files)["RDK.LS"]) == [left]


def test_without_ways_to_them_the_moves_of_one_file_stand_in_their_numbers() -> None:
    code = f"DEF k()\n$TOOL=TOOL_DATA[1]\n{FIRST}INTERRUPT OFF 3\nTRIGGER WHEN PATH=1 DELAY=0 DO $OUT[1]=TRUE\n{LAST}END\n"
    assert read_program("k.src", code.encode()).positions.barred == {}


@pytest.mark.parametrize(("statement", "left"), [("  Set Frame", None), ("  DO[5]=ON", 807.8)])
def test_a_macro_may_be_any_listing_that_none_calls_by_name(
    tmp_path: Path, statement: str, left: float | None
) -> None:
    files = {
        "RDK.LS": listings.listing(*BEGIN, statement, listings.move(1), count=1),
        "OTHER.LS": listings.listing(*listings.SECOND, count=0, name="OTHER"),
    }
    assert listings.places(read_programs(tmp_path, files)["RDK.LS"]) == [left]
