"""A step that looks for alarms never takes a robot that does not answer for one without alarms."""

import ast
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cellcal import procedures
from cellcal.drivers.errors import UnreachableError
from cellcal.drivers.interfaces import Condition, Readiness
from cellcal.procedures.motion.robot_readiness import check_position_kept
from cellcal.procedures.recovery.position_alarms import check_no_alarm
from cellcal.procedures.steps.mastering import read_alarms

PROCEDURES = Path(procedures.__file__).parent
WAITS = "wait_for_robot"  # a controller that is switched off and on: not to be reached is what it expects


class SilentRobot:
    """A robot whose cable is out."""

    name = "fanuc"

    async def read_condition(self) -> Condition:
        return Condition(Readiness.UNREACHABLE, "no connection.", "Check the cable.")


@pytest.mark.parametrize("step", [read_alarms, check_no_alarm, check_position_kept])
async def test_a_robot_that_does_not_answer_is_an_error(step: Any) -> None:
    cell: Any = SimpleNamespace(robot=SilentRobot(), mastering=None)
    with pytest.raises(UnreachableError, match="no connection") as raised:
        await step(cell)
    assert raised.value.remedy == "Check the cable."


def test_procedures_read_conditions_in_one_place() -> None:
    found = {
        (path.name, function.name)
        for path in PROCEDURES.rglob("*.py")
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(function, ast.AsyncFunctionDef | ast.FunctionDef)
        and any(
            isinstance(node, ast.Attribute) and node.attr == "read_condition" for node in ast.walk(function)
        )
    }
    assert found == {("robot_condition.py", "read_reached_condition"), ("mastering.py", WAITS)}
