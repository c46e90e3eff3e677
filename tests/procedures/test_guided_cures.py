"""ABB, Yaskawa and KUKA over the wire: the loss is seen, the work at the pendant is led through, and it is proved."""

from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.uncertainty import Verdict
from cellcal.drivers.interfaces import Readiness
from tests.procedures.guided_cures import AXES, CureScenario, guided_bench, play_scenario


@pytest.mark.parametrize(
    ("brand", "wrong"),
    [
        pytest.param("abb", {2: -1.0, 4: 0.0}, marks=pytest.mark.soak),  # most of a minute; `cures` has more
        ("yaskawa", {0: 0.0, 1: 2.0}),
        pytest.param("kuka", {2: 0.4}, marks=pytest.mark.soak),
    ],
)
async def test_an_axis_brought_back_wrongly_is_named_and_then_right(
    tmp_path: Path, brand: str, wrong: dict[int, float]
) -> None:
    async with guided_bench(tmp_path, brand) as bench:
        record = await bench.take_record(poses=16)
        assert len({value.axis for value in record.shown}) >= 6
        turn_rad = await bench.turn_rad()
        await bench.hands.lose_position(tuple(wrong))
        condition = await bench.cell.robot.read_condition()
        assert condition.readiness is Readiness.POSITION_LOST
        assert {alarm.axis for alarm in condition.alarms if alarm.axis is not None} == set(wrong)
        slips = {axis: turns * float(turn_rad[axis]) for axis, turns in wrong.items()}
        off = tuple(axis for axis, turns in wrong.items() if turns)
        first = await play_scenario(bench, CureScenario(tuple(wrong), slips, off))
        assert (first.word, first.names_truth) == ("fail", True), first.reason
        bench.hands.slips_rad, bench.hands.by_dial = {}, set()
        bench.hands.forgets = set()
        result, verdict = await bench.bring_back(axes_again=[axis + 1 for axis in off])
        assert verdict.overall_decision is Verdict.PASS
        assert [axis.name for axis in result.axes if axis.brought_back] == [AXES[brand][axis] for axis in off]
        assert np.abs((await bench.hands.read_truth())["error_rad"]).max() < 1e-3
