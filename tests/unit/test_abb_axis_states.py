"""What the states of ABB axes ask for: a counter is updated, an axis that is not calibrated gets a new zero."""

from types import SimpleNamespace
from typing import Any

import pytest

from cellcal.drivers.abb.robot_web_services.state import ControllerState, condition_of
from cellcal.drivers.interfaces import AlarmKind, Condition, PositionCure, Readiness
from cellcal.procedures.position_cure import PositionCureSpec, _planned_cures
from cellcal.procedures.recovery.pendant_cures import cure_instruction
from cellcal.procedures.recovery.shown_position import read_axis_state


def condition_with(lost: dict[int, str]) -> Condition:
    return condition_of(ControllerState("MANR", "motoroff", lost))


async def state_with(lost: dict[int, str]) -> Any:
    async def read_condition() -> Condition:
        return condition_with(lost)

    capabilities = SimpleNamespace(position_cure=PositionCure.REVOLUTION_COUNTERS)
    robot = SimpleNamespace(name="abb", capabilities=capabilities, read_condition=read_condition)
    cell: Any = SimpleNamespace(robot=robot)
    return await read_axis_state(cell)


@pytest.mark.parametrize("word", ["NotCalibrated", "NotCommutated"])
def test_an_axis_without_calibration_asks_for_a_calibration(word: str) -> None:
    condition = condition_with({2: word, 4: "NotAMSSynchronized"})
    assert condition.readiness is Readiness.POSITION_LOST
    assert condition.message == "axes 3 are not calibrated."
    assert "fine calibration" in condition.remedy
    assert [(alarm.code, alarm.kind) for alarm in condition.alarms] == [
        (word, AlarmKind.ENCODER),
        ("20032", AlarmKind.TURNS),
    ]


def test_a_lost_counter_asks_for_its_update_alone() -> None:
    condition = condition_with({4: "NotAMSSynchronized"})
    assert condition.message == "axes 5 are not synchronised."
    assert "calibrat" not in condition.remedy


async def test_the_cure_makes_a_new_zero_where_the_controller_has_none() -> None:
    state = await state_with({2: "NotCalibrated", 4: "NotAMSSynchronized"})
    assert state.lost_axes == (2, 4)
    for asked in ("usual", "kept"):
        cures = _planned_cures(PositionCureSpec(zero=asked), state, 6)
        assert [(cure.axis, cure.zero, cure.was_lost) for cure in cures] == [
            (2, "new", True),
            (4, "kept", True),
        ]
        assert "fine calibration" in str(cure_instruction(cures[0]).text)
        assert "fine calibration" not in str(cure_instruction(cures[1]).text)
