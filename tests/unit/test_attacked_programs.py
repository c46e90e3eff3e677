"""What people and other clients do to the programs that ship, and the programs that send joints beside them."""

from pathlib import Path

import pytest

from cellcal.fake_devices.abb_web_services.program import SOURCES as RAPID_SOURCES
from cellcal.fake_devices.kuka_variables.program import BOTH, SENSOR
from cellcal.fake_devices.kuka_variables.program import SOURCES as KRL_SOURCES
from cellcal.fake_devices.program_text.expressions import ProgramTextError
from tests.unit.helpers.program_bench import (
    BRANDS,
    CLOSE_DEG,
    FAR_DEG,
    NEAR_DEG,
    ProgramBench,
    damaged,
)


@pytest.fixture(params=BRANDS)
def bench(request: pytest.FixtureRequest) -> ProgramBench:
    """The program that moves the arm, waiting."""
    found = ProgramBench(request.param)
    found.until_waiting()
    return found


@pytest.fixture(params=BRANDS)
def streaming(request: pytest.FixtureRequest) -> ProgramBench:
    """The same with the program that sends joints, put together as the set-up page says."""
    found = ProgramBench(request.param, program=BOTH)
    found.until_waiting()
    return found


def test_an_override_of_ten_per_cent_is_slow_and_not_silent(bench: ProgramBench) -> None:
    bench.order(1, NEAR_DEG)
    usual_s = bench.until(lambda: bench.number(bench.ack) == 1)
    bench.turn_override(10)
    bench.order(2, FAR_DEG)
    slow_s = bench.until(lambda: bench.number(bench.ack) == 2)
    assert slow_s > 5.0 * usual_s
    assert bench.number(bench.state) == 1
    assert bench.joints_deg() == pytest.approx(FAR_DEG, abs=1e-4)


def test_a_counter_that_begins_anew_orders_one_step(bench: ProgramBench) -> None:
    for number, joints in ((30_000, NEAR_DEG), (1, CLOSE_DEG), (2, NEAR_DEG)):
        bench.carry_out(number, joints)


def test_the_same_request_again_is_no_step(bench: ProgramBench) -> None:
    bench.carry_out(1, NEAR_DEG)
    bench.order(1, FAR_DEG)  # a message that was sent twice
    bench.cycles(300)
    assert bench.joints_deg() == pytest.approx(NEAR_DEG, abs=1e-4)
    assert not bench.arm.is_moving


def test_a_target_that_is_written_during_a_step_belongs_to_the_next(bench: ProgramBench) -> None:
    bench.order(1, NEAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    bench.write_target(FAR_DEG)
    bench.until(lambda: bench.number(bench.ack) == 1)
    assert bench.joints_deg() == pytest.approx(NEAR_DEG, abs=1e-4)
    bench.cycles(300)
    assert not bench.arm.is_moving


@pytest.mark.parametrize("cycles", [20, 150, 400])
def test_a_program_that_a_person_starts_anew_in_mid_step_gives_the_step_up(
    bench: ProgramBench, cycles: int
) -> None:
    bench.order(1, FAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    bench.cycles(cycles)
    bench.pause()
    bench.cycles(300)
    stood = bench.joints_deg()
    bench.start_anew()
    bench.until_waiting()
    bench.cycles(300)
    assert bench.joints_deg() == stood
    bench.carry_out(2, NEAR_DEG)


@pytest.mark.parametrize("silent_first", [True, False])
def test_a_mode_switch_in_mid_step_stops_the_arm_and_going_on_is_watched(
    bench: ProgramBench, silent_first: bool
) -> None:
    bench.order(1, FAR_DEG)
    bench.until(lambda: bench.arm.is_moving)
    bench.cycles(60)
    bench.turn_mode_switch()
    bench.cycles(60)
    stood, life = bench.joints_deg(), bench.number(bench.life)
    assert not bench.arm.is_moving
    bench.is_alive = not silent_first
    bench.cycles(300)
    assert (bench.joints_deg(), bench.number(bench.life)) == (stood, life)
    bench.press_start()
    if silent_first:  # its client has gone: the arm goes on for half a second at most
        bench.until(lambda: bench.number(bench.state) == 3, most_s=2.0)
        bench.cycles(100)
        assert not bench.arm.is_moving
        assert bench.joints_deg()[0] < FAR_DEG[0] - 1.0
    else:
        bench.until(lambda: bench.number(bench.ack) == 1)
        assert bench.joints_deg() == pytest.approx(FAR_DEG, abs=1e-4)


def stop_steps(bench: ProgramBench, count: int) -> None:
    """Order steps and stop each: each stop begins main anew, or a routine of it."""
    for number in range(1, count + 1):
        bench.order(number, FAR_DEG if number % 2 else CLOSE_DEG)
        bench.until(lambda: bench.arm.is_moving)
        bench.set_stop(on=True)
        bench.until(lambda: bench.number(bench.state) == 3)
        bench.set_stop(on=False)
        bench.until_waiting()


def test_joints_are_sent_while_steps_are_carried_out_and_stopped(streaming: ProgramBench) -> None:
    assert streaming.sends_joints
    stop_steps(streaming, 7)
    assert streaming.sends_joints
    streaming.carry_out(8, NEAR_DEG)
    streaming.start_anew()
    assert not streaming.sends_joints
    streaming.until(lambda: streaming.sends_joints)


def test_without_a_reset_of_its_identity_a_stream_ends_after_some_stops(tmp_path: Path) -> None:
    folder = damaged(tmp_path, RAPID_SOURCES, "    EGMReset idCellcal;\n")
    bench = ProgramBench("abb", program=BOTH, folder=folder)
    bench.until_waiting()
    with pytest.raises(ProgramTextError, match=r"no identity of a stream is free"):
        stop_steps(bench, 8)


def test_a_kuka_without_the_context_of_rsi_halts_and_goes_on_without_it() -> None:
    bench = ProgramBench("kuka", program=BOTH)
    assert bench.kuka is not None
    bench.kuka.programs.context_files.clear()
    bench.cycles(200)
    life = bench.number("CC_LIFE")
    bench.cycles(100)
    assert bench.number("CC_LIFE") == life  # a driver takes it for not running
    assert not bench.sends_joints
    for _ in range(2):  # RSI_CREATE and RSI_ON each halt
        bench.kuka.programs.robot.press_start()
        bench.cycles(50)
    bench.until_waiting()
    bench.carry_out(1, NEAR_DEG)


def test_the_program_of_rsi_alone_sends_joints_and_moves_nothing() -> None:
    bench = ProgramBench("kuka", program=SENSOR)
    assert bench.kuka is not None
    stood = bench.joints_deg()
    for _ in range(3):
        bench.cycles(700)
        bench.order(1, FAR_DEG)
        bench.cycles(300)
        assert bench.sends_joints
        assert bench.joints_deg() == stood
        bench.kuka.programs.restart()
        assert not bench.sends_joints  # a context ends with its program
    assert KRL_SOURCES.joinpath(f"{SENSOR}.SRC").is_file()
