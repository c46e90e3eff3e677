"""A robot that has lost its position may be stopped as well: each make says so where its link tells it."""

from dataclasses import replace

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


def of_kuka(mode: str, *, safety: bool, stop: bool, lost: tuple[int, ...] = (1,)) -> Condition:
    return kuka.condition_of(kuka.ControllerState(mode, False, safety, stop, lost))


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
        (of_kuka("#EX", safety=False, stop=True), "the operator safety is open."),
        (of_kuka("#T1", safety=False, stop=True), "a stop message is active."),
        (of_kuka("#T1", safety=False, stop=False), None),  # a person jogs with the gate open
        (of_kuka("#T1", safety=True, stop=True), "a stop message is active."),
        (of_kuka("#T1", safety=True, stop=False), None),
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


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        (abb.condition_of(abb.ControllerState("MANR", "guardstop", {})), Readiness.NOT_READY),
        (of_kuka("#T1", safety=False, stop=False, lost=()), Readiness.NOT_READY),
        (of_kuka("#T2", safety=True, stop=False, lost=()), Readiness.NOT_READY),
        (of_kuka("#T1", safety=False, stop=True, lost=()), Readiness.STOPPED),
        (of_yaskawa(0x00), Readiness.NOT_READY),  # neither servo power nor remote
        (rmi.condition_of(NO_POWER, ("SRVO-003 Deadman switch released", PRESSED)), Readiness.NOT_READY),
        (rmi.condition_of(NO_POWER, ()), Readiness.NOT_READY),
        (rmi.condition_of(NO_POWER, (PRESSED,)), Readiness.STOPPED),
        (
            rmi.condition_of(replace(NO_POWER, pendant_enabled=False), ("SRVO-003 Deadman switch released",)),
            Readiness.STOPPED,
        ),
    ],
)
def test_a_person_who_lets_go_of_the_enabling_device_has_stopped_nothing(
    condition: Condition, expected: Readiness
) -> None:
    """Between two jogs the drives are off; a procedure by hand goes on there, and ends at an emergency stop."""
    assert condition.readiness is expected
