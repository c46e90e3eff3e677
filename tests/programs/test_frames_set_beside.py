"""Frames and tools that another file sets between a setting in numbers and a move: called back, or at any time."""

from pathlib import Path

import pytest

from tests.programs import test_abb_frames_in_numbers as rapid
from tests.programs import test_fanuc_frames_in_numbers as listings
from tests.programs import test_kuka_set_tables as krl
from tests.programs.test_across_files import rapid_module, read_programs

CALLED_BACK = [*rapid.BEGIN, rapid.MOVE, "other;", rapid.MOVE, rapid.SET_2]


@pytest.mark.parametrize(
    ("files", "left"),
    [
        (["PROC other()\nmain;\nENDPROC"], True),
        (["PROC other()\nthird;\nENDPROC", "PROC third()\nIF di1=1 main;\nENDPROC"], True),
        (["PROC other()\nIF f() Stop;\nENDPROC\nFUNC bool f()\nmain;\nRETURN TRUE;\nENDFUNC"], True),
        (['PROC other()\n%"ma"+"in"%;\nENDPROC'], True),
        (['PROC other()\nMoveLSync p1,v1,z1,rdkTool,"main";\nENDPROC'], True),
        (["PROC other()\nMoveLSync p1,v1,\n  z1,rdkTool,sRoutine;\nENDPROC"], True),
        (['PROC other()\nMoveLSync p1,v1,\n  z1,rdkTool,"main";\nENDPROC'], True),
        (["PROC other()\nIF di1=1 THEN main 5; ENDIF\nENDPROC"], True),
        (["PROC other()\nTEST n\nCASE 1: main nX;\nENDTEST\nENDPROC"], True),
        (['PROC other()\nFOR i FROM 1 TO 2 DO main "a",i; ENDFOR\nENDPROC'], True),
        (["PROC other()\nmain\n  5;\nENDPROC"], True),
        (["PROC other()\nmain\n;\nENDPROC"], True),
        (["PROC other()\nSetDO do1,1; ! main;\nENDPROC"], False),
        (['PROC other()\nTPWrite "main 5;"; ! main 5;\nENDPROC'], False),
        (["PROC fourth()\nmain;\nENDPROC"], False),
    ],
)
def test_a_rapid_routine_that_another_module_calls_back(tmp_path: Path, files: list[str], left: bool) -> None:
    modules = {f"n{at}.mod": rapid_module(f"n{at}", one) for at, one in enumerate(files)}
    own = read_programs(tmp_path, {"m.mod": rapid.module_of(*CALLED_BACK), **modules})["m.mod"]
    assert (None in rapid.places(own)) is left


@pytest.mark.parametrize("call", ['MoveLSync p1,v1,z1,rdkTool,"other";', 'CallByVar "oth",n;'])
def test_a_rapid_routine_that_is_called_back_by_one_in_quotes(tmp_path: Path, call: str) -> None:
    own = rapid.module_of(*rapid.BEGIN, rapid.MOVE, call, rapid.MOVE, rapid.SET_2)
    back = rapid_module("n", "PROC other()\nmain;\nENDPROC")
    assert None in rapid.places(read_programs(tmp_path, {"m.mod": own, "n.mod": back})["m.mod"])


SETTER = f"PROC set2()\n{rapid.SET_2}\nENDPROC\n"
TRAP, HELPER = "TRAP t\n{}\nENDTRAP", "PROC helper()\n{}\nENDPROC"


@pytest.mark.parametrize(
    ("own", "files", "left"),
    [
        ("", [TRAP.format("helper;"), HELPER.format("set2;")], True),
        ("", [TRAP.format("helper;") + "\n" + HELPER.format("set2;")], True),
        ("", [TRAP.format('%"set"+"2"%;')], True),
        (TRAP.format("helper;"), [HELPER.format("set2;")], True),
        ("", [TRAP.format('TPWrite "ENDTRAP PROC x";\n! ENDTRAP\nhelper;'), HELPER.format("set2;")], True),
        ("", [TRAP.format("helper;"), HELPER.format("SetDO do1,1;")], False),
        ("", [TRAP.format("helper;") + "\nPROC q()\nset2;\nENDPROC", HELPER.format("SetDO do1,1;")], False),
    ],
)
def test_a_rapid_trap_that_leads_to_a_setting_through_other_files(
    tmp_path: Path, own: str, files: list[str], left: bool
) -> None:
    lines = (*rapid.BEGIN, rapid.MOVE, "WaitTime 1;", rapid.MOVE)
    modules = {f"n{at}.mod": rapid_module(f"n{at}", one) for at, one in enumerate(files)}
    module = rapid.module_of(*lines, routines=SETTER + own)
    found = rapid.places(read_programs(tmp_path, {"m.mod": module, **modules})["m.mod"])
    assert found == ([None, None] if left else [807.8, 807.8])


def test_a_work_object_of_a_rapid_task_that_another_module_sets(tmp_path: Path) -> None:
    own = rapid.module_of(*rapid.BEGIN, rapid.MOVE, kind="TASK PERS")
    other = rapid_module("n", "PROC q()\nFrame1:=wOther;\nENDPROC")
    assert rapid.places(read_programs(tmp_path, {"m.mod": own, "n.mod": other})["m.mod"]) == [None]


def test_a_rapid_routine_that_is_called_back_with_one_frame_stands_in_it(tmp_path: Path) -> None:
    own = rapid.module_of(*rapid.BEGIN, rapid.MOVE, "other;", rapid.MOVE)
    back = rapid_module("n", "PROC other()\nmain;\nENDPROC")
    assert rapid.places(read_programs(tmp_path, {"m.mod": own, "n.mod": back})["m.mod"]) == [807.8, 807.8]


INTERRUPT = "INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO {}()\n"
STARTS = f"DEF begin()\nGLOBAL {INTERRUPT.format('sub')}INTERRUPT ON 4\nk()\nEND\n"
SETS_1, SETS_2 = krl.SUB, krl.SUB.replace("BASE_DATA[1]", "BASE_DATA[2]")
TRIGGERS = "DEF begin()\nTRIGGER WHEN PATH=0 DELAY=9 DO sub() PRIO=-1\nPTP {A1 0}\nk()\nEND\n"
SUBMIT = f"DEF sps()\nLOOP\n{krl.ENTRY.format(1, 700)}ENDLOOP\nEND\n"


@pytest.mark.parametrize(
    ("files", "left"),
    [
        ({"begin.src": STARTS, "sub.src": SETS_1}, True),
        ({"begin.src": STARTS, "sub.src": SETS_2}, False),
        ({"begin.src": TRIGGERS, "sub.src": SETS_1}, True),
        ({"begin.src": TRIGGERS, "sub.src": SETS_2}, False),
        ({"begin.src": STARTS.replace("sub()", "IR_STOPM()"), "sub.src": SETS_1}, False),
        ({"sps.sub": SUBMIT}, True),
        ({"sps.sub": "DEF sps()\nLOOP\nsub()\nENDLOOP\nEND\n", "sub.src": SETS_1}, True),
        ({"sps.sub": "DEF sps()\nLOOP\n$OUT[1]=TRUE\nENDLOOP\nEND\n", "sub.src": SETS_1}, False),
    ],
)
def test_an_entry_that_a_handler_or_a_submit_program_of_another_file_sets(
    tmp_path: Path, files: dict[str, str], left: bool
) -> None:
    own = f"DEF k()\n{krl.TOOL}{krl.ENTRY.format(1, 300)}{krl.TAKEN}{krl.LINE}END\n"
    found = read_programs(tmp_path, {"k.src": own, **files})["k.src"]
    assert bool(found.positions.barred) is left


def test_an_entry_that_a_krl_trigger_sets_is_not_known(tmp_path: Path) -> None:
    trigger = f"TRIGGER WHEN PATH=0 DELAY=9 DO {krl.ENTRY.format(1, 700)}"
    own = f"DEF k()\n{krl.TOOL}{krl.ENTRY.format(1, 300)}{trigger}PTP {{A1 0}}\n{krl.TAKEN}{krl.LINE}END\n"
    positions = read_programs(tmp_path, {"k.src": own})["k.src"].positions
    assert len(positions) - 1 in positions.barred


WORK = "$TOOL={X 0,Y 0,Z 1,A 0,B 0,C 0}\n$BASE={X 1,Y 0,Z 0,A 0,B 0,C 0}\n" + krl.LINE


@pytest.mark.parametrize(
    ("main", "first", "left"),
    [
        ("", "far()\n", True),
        ("DEF main()\nfar()\nwork()\nEND\n", "", True),
        ("DEF main()\nfar()\nwork()\nEND\n", "$IPO_MODE=#BASE\n", False),
        ("DEF main()\nfar()\nwork()\nEND\n", "BAS(#INITMOV,0)\n", False),
        ("DEF main()\nfar()\nwork()\nEND\n", "IF x THEN\n$IPO_MODE=#BASE\nENDIF\n", True),
        ("DEF main()\nfar()\nwork()\nEND\n", "GOTO over\n$IPO_MODE=#BASE\nover:\n", True),
        ("DEF main()\nfar()\nwork()\nEND\n", "$IPO_MODE=mode\n", True),
        ("DEF main()\nfar()\nwork()\nEND\n", "$IPO_MODE=FDAT_ACT.IPO_FRAME\n", True),
        ("DEF main()\nwork()\nEND\n", "$IPO_MODE=mode\n", True),
        ("DEF main()\nwork()\nEND\n", "$IPO_MODE=FDAT_ACT.IPO_FRAME\n", False),
        ("DEF main()\nwork()\nEND\n", "$IPO_MODE=#BASE ; no #TCP\n", False),
        ("DEF main()\nwork()\nEND\n", "", False),
    ],
)
def test_a_tool_in_the_cell_that_another_krl_file_chooses(
    tmp_path: Path, main: str, first: str, left: bool
) -> None:
    files = {"far.src": "DEF far()\n$IPO_MODE=#TCP\nEND\n", "work.src": f"DEF work()\n{first}{WORK}END\n"}
    files |= {"main.src": main} if main else {}
    found = read_programs(tmp_path, files)["work.src"]
    assert bool(found.positions.barred) is left


@pytest.mark.parametrize("behind", ["BAS(#INITMOV,0)\nEND\n", "END\nDEF other()\n$IPO_MODE=#BASE\nEND\n"])
def test_a_krl_file_that_chooses_its_tool_below_its_moves_or_elsewhere(tmp_path: Path, behind: str) -> None:
    files = {
        "far.src": "DEF far()\n$IPO_MODE=#TCP\nEND\n",
        "main.src": "DEF main()\nfar()\nwork()\nEND\n",
        "work.src": f"DEF work()\n{WORK}{behind}",
    }
    assert read_programs(tmp_path, files)["work.src"].positions.barred


@pytest.mark.parametrize("holds", ["$IPO_MODE=#BASE\n", "BAS(#INITMOV,0)\n"])
@pytest.mark.parametrize("first", [True, False])
def test_a_krl_file_that_calls_its_own_routine_before_it_chooses_its_tool(
    tmp_path: Path, holds: str, first: bool
) -> None:
    lines = f"near()\n{holds}" if first else f"{holds}near()\n"
    files = {
        "far.src": "DEF far()\n$IPO_MODE=#TCP\nEND\n",
        "main.src": "DEF main()\nfar()\nwork()\nEND\n",
        "work.src": f"DEF work()\n{lines}END\nDEF near()\n{WORK}END\n",
    }
    assert bool(read_programs(tmp_path, files)["work.src"].positions.barred) is first


def test_a_macro_of_another_name_may_set_a_tool_alone(tmp_path: Path) -> None:
    files = {
        "RDK.LS": listings.listing(
            *listings.TOOL, *listings.FIRST, listings.move(1), "  Set Tool", listings.move(2), count=2
        ),
        "XYZ.LS": listings.listing(*listings.set_lines("UTOOL", 99.5), count=0, name="XYZ"),
    }
    positions = read_programs(tmp_path, files)["RDK.LS"].positions
    assert list(positions.barred) == [1]
    assert (positions.tools[0] or "").startswith("9={62.5,")
