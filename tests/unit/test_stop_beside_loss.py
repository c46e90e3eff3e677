"""A robot that has lost its position may be stopped as well: each make says so where its link tells it."""

import pytest

from cellcal.drivers.abb.robot_web_services import state as abb
from cellcal.drivers.fanuc.rmi import rmi_state as rmi
from cellcal.drivers.interfaces import Condition, Readiness
from cellcal.drivers.kuka.variables import state as kuka
from cellcal.drivers.yaskawa.condition import condition_of as yaskawa_condition
from cellcal.drivers.yaskawa.state import AlarmEntry, ControllerStatus

LOST = {1: "NotAMSSynchronized"}
NO_POWER = rmi.RmiStatus(
    has_servo_power=False,
    pendant_enabled=True,
    motion_runs=False,
    single_step=False,
    next_sequence_id=1,
    override=1.0,
)
TURNS, PRESSED = "SRVO-062 BZAL alarm (G:1 A:2)", "SRVO-001 Operator panel E-stop"
OUT_OF_RANGE = AlarmEntry(4107, 2, "OUT OF RANGE(ABSO DATA)", 3)
OVERLOAD = AlarmEntry(4320, 0, "OVERLOAD(CONTINUE)", 1)


def of_abb(mode: str, motors: str) -> Condition:
    return abb.condition_of(abb.ControllerState(mode, motors, LOST))


def of_kuka(*, safety: bool, stop: bool) -> Condition:
    return kuka.condition_of(kuka.ControllerState("#T1", False, safety, stop, (1,)))


def of_yaskawa(word_2: int, *alarms: AlarmEntry) -> Condition:
    return yaskawa_condition(ControllerStatus(0x22, word_2), alarms)


@pytest.mark.parametrize(
    ("condition", "stop"),
    [
        (of_abb("MANR", "emergencystop"), "the motors are off (emergencystop)."),
        (of_abb("MANR", "emergencystopreset"), "the motors are off (emergencystopreset)."),
        (of_abb("AUTO", "guardstop"), "the motors are off (guardstop)."),
        (of_abb("MANR", "guardstop"), None),  # the enabling device is released
        (of_abb("MANR", "motoroff"), None),
        (of_kuka(safety=False, stop=True), "the operator safety is open."),
        (of_kuka(safety=True, stop=True), "a stop message is active."),
        (of_kuka(safety=True, stop=False), None),
        (of_yaskawa(0x10, OUT_OF_RANGE), None),  # takes the servo power itself
        (of_yaskawa(0x12, OUT_OF_RANGE), "the robot is on hold."),
        (of_yaskawa(0x10, OUT_OF_RANGE, OVERLOAD), "alarm 4320 OVERLOAD(CONTINUE)."),
        (rmi.condition_of(NO_POWER, (PRESSED, TURNS)), "SRVO-001 Operator panel E-stop."),
        (rmi.condition_of(NO_POWER, (TURNS, PRESSED)), None),  # older than the loss: it may be released
        (rmi.condition_of(NO_POWER, (TURNS,)), None),
    ],
)
def test_a_stop_is_told_beside_a_lost_position(condition: Condition, stop: str | None) -> None:
    assert condition.readiness is Readiness.POSITION_LOST
    assert (None if condition.stop is None else str(condition.stop.message)) == stop
    if condition.stop is not None:
        assert (condition.stop.readiness, bool(condition.stop.remedy)) == (Readiness.STOPPED, True)


@pytest.mark.parametrize("mode", ["AUTO", "MANR"])
def test_an_abb_emergency_stop_comes_before_the_mode(mode: str) -> None:
    condition = abb.condition_of(abb.ControllerState(mode, "emergencystop", {}))
    assert condition.readiness is Readiness.STOPPED
