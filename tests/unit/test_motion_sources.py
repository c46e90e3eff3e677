"""CELLCAL for KUKA and CellcalServer for ABB as they ship, executed statement by statement, without a driver."""

from pathlib import Path

import pytest

from cellcal.fake_devices.abb_web_services.program import SOURCES as RAPID_SOURCES
from cellcal.fake_devices.krl_programs.source import parse_lines, parse_source
from cellcal.fake_devices.kuka_variables.program import SOURCES as KRL_SOURCES
from cellcal.fake_devices.program_text.expressions import KRL, RAPID, ProgramTextError, parse_expression
from cellcal.fake_devices.rapid_programs.source import parse_module
from tests.unit.helpers.program_bench import (
    BACK_DEG,
    BEYOND_DEG,
    BRANDS,
    CLOSE_DEG,
    FAR_DEG,
    NEAR_DEG,
    ProgramBench,
    damaged,
)


@pytest.fixture(params=BRANDS)
def bench(request: pytest.FixtureRequest) -> ProgramBench:
    found = ProgramBench(request.param)
    found.until_waiting()
    return found


def test_a_step_is_acknowledged_where_the_arm_has_arrived_and_not_before(bench: ProgramBench) -> None:
    bench.order(1, NEAR_DEG)
    while bench.number(bench.ack) != 1:
        bench.cycles(1)
    assert bench.joints_deg() == pytest.approx(NEAR_DEG, abs=1e-4)
    bench.carry_out(2, FAR_DEG)


@pytest.mark.parametrize("brand", BRANDS)
def test_a_stop_between_any_two_statements_leaves_a_standing_arm_and_no_pending_step(brand: str) -> None:
    bench = ProgramBench(brand, at_once=1)
    bench.until_waiting()
    for cycles in range(0, 60, 2):
        request = bench.number(bench.ack) + 1
        bench.order(request, NEAR_DEG)
        bench.cycles(cycles)
        bench.set_stop(on=True)
        bench.until(lambda: bench.number(bench.state) == 3, most_s=1.0)
        bench.cycles(10)
        stood = bench.joints_deg()
        assert not bench.arm.is_moving
        assert bench.number(bench.ack) == bench.number(bench.req) or bench.number(bench.state) == 3
        bench.set_stop(on=False)
        bench.until_waiting()
        bench.cycles(30)
        assert bench.joints_deg() == stood, f"the old step ran, stopped after {cycles} statements"
        bench.carry_out(request + 1, CLOSE_DEG if cycles % 4 else BACK_DEG)


def test_an_arm_without_a_heartbeat_stands_within_a_second(bench: ProgramBench) -> None:
    bench.order(1, FAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    bench.cycles(20)
    bench.is_alive = False
    silent_s = bench.until(lambda: bench.number(bench.state) == 3)
    assert 0.4 < silent_s < 0.9
    bench.until(lambda: not bench.arm.is_moving, most_s=0.5)
    assert bench.joints_deg()[0] < FAR_DEG[0] - 1.0


@pytest.mark.parametrize("stop_first", [True, False])
def test_start_after_a_pause_does_not_resume_the_old_motion(bench: ProgramBench, stop_first: bool) -> None:
    bench.order(1, FAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    bench.cycles(60)
    bench.pause()
    bench.cycles(10)
    bench.set_stop(on=stop_first)
    bench.is_alive = False  # its client has given up
    bench.cycles(300)
    life, stood = bench.number(bench.life), bench.joints_deg()
    bench.cycles(100)
    assert bench.number(bench.life) == life, "a program that is paused counts"
    bench.press_start()
    bench.cycles(400)
    assert bench.number(bench.state) == 3
    travelled = abs(bench.joints_deg()[0] - stood[0])
    assert travelled < (
        2.5 if stop_first else 16.0
    )  # a step that nothing has stopped ends with its heartbeat


def test_a_request_that_comes_while_the_arm_moves_is_the_next_step(bench: ProgramBench) -> None:
    bench.order(1, NEAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    bench.order(2, FAR_DEG)
    bench.until(lambda: bench.number(bench.ack) == 2)
    assert bench.joints_deg() == pytest.approx(FAR_DEG, abs=1e-4)


def test_external_axes_stand_while_the_arm_moves(bench: ProgramBench) -> None:
    controller = bench.kuka or bench.abb
    assert controller is not None
    bench.cycles(5)  # its first motion, to where it stands, is over
    controller.external[0] = 1234.5
    bench.carry_out(1, NEAR_DEG)
    assert controller.external[0] == pytest.approx(1234.5, abs=1e-3)


def test_a_program_that_is_started_anew_gives_up_what_was_ordered_before(bench: ProgramBench) -> None:
    bench.pause()
    bench.cycles(5)
    bench.order(1, FAR_DEG)
    stood = bench.joints_deg()
    bench.start_anew()
    bench.until_waiting()
    bench.cycles(100)
    assert bench.joints_deg() == stood
    bench.carry_out(2, NEAR_DEG)


def test_kuka_refuses_a_target_beyond_a_limit_and_runs_on() -> None:
    bench = ProgramBench("kuka")
    assert bench.kuka is not None
    bench.until_waiting()
    bench.order(1, BEYOND_DEG)
    bench.until(lambda: bench.number("CC_STATE") == 4)
    assert bench.number("CC_BAD") == 1
    assert not bench.kuka.stop_message
    bench.set_stop(on=True)
    bench.until(lambda: bench.number("CC_STATE") == 3)
    bench.set_stop(on=False)
    bench.until_waiting()
    bench.carry_out(2, NEAR_DEG)


def test_abb_stops_at_a_target_beyond_a_limit_with_an_event_and_no_life() -> None:
    bench = ProgramBench("abb")
    assert bench.abb is not None
    bench.until_waiting()
    bench.order(1, BEYOND_DEG)
    bench.until(lambda: not bench.abb.program_runs)  # type: ignore[union-attr]
    assert bench.abb.log[0][0] == 50027
    assert not bench.arm.is_moving


@pytest.mark.parametrize("way", ["cancel_program", "select_program"])
def test_a_kuka_without_a_started_program_is_off(way: str) -> None:
    bench = ProgramBench("kuka")
    assert bench.kuka is not None
    bench.until_waiting()
    getattr(bench.kuka.programs.robot, way)()
    bench.cycles(2)
    assert bench.number("CC_STATE") == 0


def test_the_load_is_that_of_the_tool_that_is_mounted() -> None:
    kuka, abb = ProgramBench("kuka"), ProgramBench("abb")
    assert kuka.kuka is not None
    assert abb.abb is not None
    kuka.write("CC_TOOL", "2")
    kuka.start_anew()
    abb.abb.tool_name = "tPin"
    abb.start_anew()
    for each in (kuka, abb):
        each.until_waiting()
        each.carry_out(1, NEAR_DEG)
    assert (kuka.kuka.tool_number, kuka.kuka.load_kg) == (2, 1.25)
    assert (abb.abb.tool_name, abb.abb.payload_kg()) == ("tMounted", 1.25)
    abb.abb.tool_name = "tGripper"  # selected while the program runs: the module moves with the one of before
    abb.carry_out(2, FAR_DEG)
    assert abb.abb.payload_kg() == 1.25


def test_without_the_advance_stop_a_resume_is_impossible(tmp_path: Path) -> None:
    bench = ProgramBench("kuka", folder=damaged(tmp_path, KRL_SOURCES, "   WAIT SEC 0\n"))
    bench.until_waiting()
    bench.order(1, FAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    assert bench.number("CC_ACK") == 1, "the advance run goes on while the arm moves"


def test_a_path_that_is_not_cleared_goes_on(tmp_path: Path) -> None:
    bench = ProgramBench("abb", folder=damaged(tmp_path, RAPID_SOURCES, "      ClearPath;\n"))
    bench.until_waiting()
    bench.order(1, FAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    bench.set_stop(on=True)
    bench.cycles(1000)
    assert bench.joints_deg() == pytest.approx(FAR_DEG, abs=1e-4)


@pytest.mark.parametrize(
    "statement",
    [
        "LIN X",
        'RET=RSI_CREATE("A.rsi",ID,FALSE)',
        "RET=RSI_ON(#ABSOLUTE)",
        "PTP X C_PTP",
        "X()=1",
        "SWITCH X",
        "WHILE X",
        "X==1",
        "CONTINUE",
        "A=B'1'",
    ],
)
def test_a_krl_statement_that_is_not_known_is_refused_with_its_line(statement: str) -> None:
    with pytest.raises(ProgramTextError, match=r"^TRY\.SRC, line 3: "):
        parse_source("TRY.SRC", f"DEF TRY()\n\n   {statement}\nEND")


@pytest.mark.parametrize(
    "instruction",
    [
        "MoveL p1, v100, fine, tool0;",
        "EGMActJoint idCellcal;",
        "EGMRunJoint idCellcal, EGM_STOP_HOLD;",
        "nA := 1",
        "Set do1;",
        "MoveAbsJ j, v100, z10, tool0;",
    ],
)
def test_a_rapid_instruction_that_is_not_known_is_refused_with_its_line(instruction: str) -> None:
    text = f"MODULE Try\n  PROC main()\n    {instruction}\n  ENDPROC\nENDMODULE"
    with pytest.raises(ProgramTextError, match=r"Try\.mod, line 3: "):
        parse_module("Try.mod", text)


class Names:
    """Values of names in an expression."""

    def read(self, name: str, index: int | None, member: str) -> object:
        return {"A": True, "B": False, "N": 2}[name]

    def call(self, name: str, arguments: object) -> object:
        raise AssertionError(name)


def test_comparisons_bind_as_each_language_says() -> None:
    assert parse_expression("(N==2) AND A", KRL).evaluate(Names()) is True
    assert parse_expression("N = 2 AND A OR B", RAPID).evaluate(Names()) is True
    with pytest.raises(ProgramTextError):  # in KRL AND binds before ==
        parse_expression("N==2 AND A", KRL).evaluate(Names())


def test_lines_of_the_submit_interpreter_are_read_without_a_head() -> None:
    assert len(parse_lines("SPS", "A=1\nIF A==1 THEN\nA=2\nENDIF").routines["LINES"]) == 2
