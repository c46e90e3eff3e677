"""CELLCAL for KUKA and CellcalServer for ABB as they ship, executed statement by statement, without a driver."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cellcal.fake_devices.abb.controller import AbbController
from cellcal.fake_devices.abb.program import SOURCES as RAPID_SOURCES
from cellcal.fake_devices.krl_programs.source import parse_lines, parse_source
from cellcal.fake_devices.kuka.controller import KukaController
from cellcal.fake_devices.kuka.program import SOURCES as KRL_SOURCES
from cellcal.fake_devices.kuka.variables import VariableTable
from cellcal.fake_devices.program_text.expressions import KRL, RAPID, ProgramTextError, parse_expression
from cellcal.fake_devices.rapid_programs.source import parse_module
from cellcal.fake_devices.shown_joints import ShownJoints
from cellcal.fake_devices.world import World

BRANDS = ("kuka", "abb")
NAMES = {
    "kuka": ("CC_REQ", "CC_ACK", "CC_STATE", "CC_STOP", "CC_HB", "CC_AXIS", "CC_LIFE"),
    "abb": tuple(
        f"CellcalServer/{name}" for name in ("nReq", "nAck", "nState", "nStop", "nHeart", "jTarget", "nLife")
    ),
}
CYCLE_S = 0.004
CLOSE_DEG = (3.0, -2.0, 2.0, 1.0, 2.0, 1.0)
BACK_DEG = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NEAR_DEG = (10.0, -10.0, 10.0, 5.0, 30.0, 5.0)
FAR_DEG = (40.0, -20.0, 20.0, 5.0, 30.0, 5.0)
BEYOND_DEG = (400.0, -20.0, 20.0, 5.0, 30.0, 5.0)


class Bench:
    """One controller with its program; time goes by only with its cycles."""

    def __init__(self, brand: str, *, at_once: int = 500, folder: Path | None = None) -> None:
        self.world = World(time_factor=0.0, hidden=False)
        self.arm = self.world.add_arm("robot", "fanuc_m6ib")
        shown = ShownJoints(self.arm, (100.0,) * 6, np.random.default_rng(1))
        self.brand, self.now_s = brand, 0.0
        self.kuka = self.abb = None
        if brand == "kuka":
            sources = folder or KRL_SOURCES
            self.kuka = KukaController(
                self.arm, ("0", "KR"), self.passed_s, shown, sources=sources, statements_per_cycle=at_once
            )
            table = VariableTable(self.kuka)
            self.read: Callable[[str], str | None] = table.read
            self.write: Callable[[str, str], bool] = table.write
            self.run: Callable[[], None] = self.kuka.run_programs
        else:
            sources = folder or RAPID_SOURCES
            self.abb = AbbController(
                self.arm, "0", self.passed_s, shown, sources=sources, instructions_per_cycle=at_once
            )
            self.read, self.write, self.run = (
                self.abb.read_symbol,
                self.abb.write_symbol,
                self.abb.run_program,
            )
        names = NAMES[brand]
        self.req, self.ack, self.state, self.stop, self.heart, self.target, self.life = names
        self.beat = 0
        self.is_alive = True

    def passed_s(self) -> float:
        return self.now_s

    def number(self, name: str) -> int:
        text = self.read(name)
        assert text is not None
        return int(float(text))

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.now_s += CYCLE_S
            self.world.clock.advance(CYCLE_S)
            if self.is_alive:
                self.beat = self.beat % 30_000 + 1
                assert self.write(self.heart, str(self.beat))
            self.run()

    def until(self, condition: Callable[[], bool], most_s: float = 60.0) -> float:
        """Run until a condition holds; return how long it took."""
        began_s = self.now_s
        while not condition():
            assert self.now_s - began_s < most_s, "it has not come so far"
            self.cycles(1)
        return self.now_s - began_s

    def order(self, number: int, joints_deg: tuple[float, ...]) -> None:
        if self.brand == "kuka":
            axes = ", ".join(f"A{axis} {value}" for axis, value in enumerate(joints_deg, 1))
            assert self.write(self.target, f"{{E6AXIS: {axes}}}")
            assert self.write("CC_VEL", "10")
        else:
            assert self.write(self.target, f"[[{','.join(map(str, joints_deg))}],[{','.join(['9E9'] * 6)}]]")
            assert self.write("CellcalServer/nTime", "2")
        assert self.write(self.req, str(number))

    def set_stop(self, *, on: bool) -> None:
        words = ("TRUE", "FALSE") if self.brand == "kuka" else ("1", "0")
        assert self.write(self.stop, words[0 if on else 1])

    def until_waiting(self) -> None:
        self.until(lambda: self.number(self.state) == 1)

    def joints_deg(self) -> list[float]:
        return [float(value) for value in np.degrees(self.arm.joints_rad)]

    def pause(self) -> None:
        if self.kuka is not None:
            self.kuka.open_gate(is_open=True)
        if self.abb is not None:
            self.abb.press_emergency_stop()

    def press_start(self) -> None:
        if self.kuka is not None:
            self.kuka.acknowledge()
            self.kuka.programs.robot.press_start()
        if self.abb is not None:
            self.abb.turn_to_auto()

    def start_anew(self) -> None:
        if self.kuka is not None:
            self.kuka.mend()
        if self.abb is not None:
            self.abb.mend()

    def carry_out(self, number: int, joints_deg: tuple[float, ...]) -> None:
        """Order a step and wait for its end, as a client does."""
        self.order(number, joints_deg)
        self.until(lambda: self.number(self.ack) == number and self.number(self.state) == 1)
        assert self.joints_deg() == pytest.approx(joints_deg, abs=1e-4)


@pytest.fixture(params=BRANDS)
def bench(request: pytest.FixtureRequest) -> Bench:
    found = Bench(request.param)
    found.until_waiting()
    return found


def test_a_step_is_acknowledged_where_the_arm_has_arrived_and_not_before(bench: Bench) -> None:
    bench.order(1, NEAR_DEG)
    while bench.number(bench.ack) != 1:
        bench.cycles(1)
    assert bench.joints_deg() == pytest.approx(NEAR_DEG, abs=1e-4)
    bench.carry_out(2, FAR_DEG)


@pytest.mark.parametrize("brand", BRANDS)
def test_a_stop_between_any_two_statements_leaves_a_standing_arm_and_no_pending_step(brand: str) -> None:
    bench = Bench(brand, at_once=1)
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


def test_an_arm_without_a_heartbeat_stands_within_a_second(bench: Bench) -> None:
    bench.order(1, FAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    bench.cycles(20)
    bench.is_alive = False
    silent_s = bench.until(lambda: bench.number(bench.state) == 3)
    assert 0.4 < silent_s < 0.9
    bench.until(lambda: not bench.arm.is_moving, most_s=0.5)
    assert bench.joints_deg()[0] < FAR_DEG[0] - 1.0


@pytest.mark.parametrize("stop_first", [True, False])
def test_start_after_a_pause_does_not_resume_the_old_motion(bench: Bench, stop_first: bool) -> None:
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


def test_a_request_that_comes_while_the_arm_moves_is_the_next_step(bench: Bench) -> None:
    bench.order(1, NEAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    bench.order(2, FAR_DEG)
    bench.until(lambda: bench.number(bench.ack) == 2)
    assert bench.joints_deg() == pytest.approx(FAR_DEG, abs=1e-4)


def test_external_axes_stand_while_the_arm_moves(bench: Bench) -> None:
    controller = bench.kuka or bench.abb
    assert controller is not None
    bench.cycles(5)  # its first motion, to where it stands, is over
    controller.external[0] = 1234.5
    bench.carry_out(1, NEAR_DEG)
    assert controller.external[0] == pytest.approx(1234.5, abs=1e-3)


def test_a_program_that_is_started_anew_gives_up_what_was_ordered_before(bench: Bench) -> None:
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
    bench = Bench("kuka")
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
    bench = Bench("abb")
    assert bench.abb is not None
    bench.until_waiting()
    bench.order(1, BEYOND_DEG)
    bench.until(lambda: not bench.abb.program_runs)  # type: ignore[union-attr]
    assert bench.abb.log[0][0] == 50027
    assert not bench.arm.is_moving


@pytest.mark.parametrize("way", ["cancel_program", "select_program"])
def test_a_kuka_without_a_started_program_is_off(way: str) -> None:
    bench = Bench("kuka")
    assert bench.kuka is not None
    bench.until_waiting()
    getattr(bench.kuka.programs.robot, way)()
    bench.cycles(2)
    assert bench.number("CC_STATE") == 0


def test_the_load_is_that_of_the_tool_that_is_mounted() -> None:
    kuka, abb = Bench("kuka"), Bench("abb")
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


def damaged(folder: Path, source: Path, removed: str) -> Path:
    for file in source.iterdir():
        text = file.read_text(encoding="ascii")
        (folder / file.name).write_text(text.replace(removed, "", 1), encoding="ascii")
    return folder


def test_without_the_advance_stop_a_resume_is_impossible(tmp_path: Path) -> None:
    bench = Bench("kuka", folder=damaged(tmp_path, KRL_SOURCES, "   WAIT SEC 0\n"))
    bench.until_waiting()
    bench.order(1, FAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    assert bench.number("CC_ACK") == 1, "the advance run goes on while the arm moves"


def test_a_path_that_is_not_cleared_goes_on(tmp_path: Path) -> None:
    bench = Bench("abb", folder=damaged(tmp_path, RAPID_SOURCES, "      ClearPath;\n"))
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
        "PTP X C_PTP",
        "HALT",
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
        "WaitTime 1;",
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
