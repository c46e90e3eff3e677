"""A position brought back at the pendant is proved axis by axis, or the axis and its turns are named."""

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.mastering.position_record import ArmPositionRecord, ShownValue, drive_of_ratios
from cellcal.calibration.uncertainty import Verdict
from cellcal.drivers.interfaces import Alarm, Answer, Instruction, PositionCure, PositionHistory
from cellcal.procedures.catalogue import CATALOGUE
from cellcal.procedures.cell import MotionLevel
from cellcal.procedures.position_cure import PositionCureSpec, position_cure
from cellcal.procedures.procedure_definition import missing_needs
from cellcal.procedures.recovery import pendant_cures
from cellcal.procedures.recovery.cure_result import PositionCureResult, changed_constants
from cellcal.procedures.recovery.cure_verdict import verdict_on_cure
from cellcal.procedures.recovery.pendant_cures import (
    AxisCure,
    NotBroughtBackError,
    bring_back_axis,
    cure_instruction,
)
from cellcal.procedures.run import DeclinedError, RefusalError, Run
from cellcal.procedures.verdict import ProcedureVerdict
from tests.procedures.ideal_devices import ScriptedTechnician
from tests.procedures.memory_ledgers import CrashError, MemoryLedger, MortalLedger
from tests.procedures.procedure_scenes import ProcedureScene, healthy_scene
from tests.procedures.shown_arm import ShownArm, cure_scene


async def cure(made: ProcedureScene) -> tuple[PositionCureResult, ProcedureVerdict]:
    result = await position_cure(Run(made.cell, MemoryLedger()), made.spec)
    return result, verdict_on_cure(made.spec.limit_rad, result)


def figure_named(verdict: ProcedureVerdict, name: str) -> Any:
    return next(figure for figure in verdict.characteristics if figure.name == name)


async def test_counters_updated_at_their_marks_pass_with_what_could_not_be_determined() -> None:
    made = await cure_scene()
    result, verdict = await cure(made)
    assert verdict.overall_decision is Verdict.PASS
    assert [axis.brought_back for axis in result.axes] == [False, True, False, False, True, False]
    assert all(axis.is_right and 0.0 < axis.hidden_rad < 0.02 for axis in result.axes)
    asked_keys = [key for key in made.technician.instructions if key.startswith("bring_back")]
    assert asked_keys == ["bring_back_revolution_counters"] * 2
    assert made.arm.writes == 0


async def test_an_axis_that_is_a_turn_off_fails_by_its_name_and_passes_when_it_is_updated_again() -> None:
    made = await cure_scene(leaves_turns={4: -1})
    result, verdict = await cure(made)
    assert verdict.overall_decision is Verdict.FAIL
    assert [axis.turns_off for axis in result.axes] == [0, 0, 0, 0, -1, 0]
    assert result.axes[4].offset_rad == pytest.approx(-2 * np.pi / 80.0)
    assert figure_named(verdict, "axis 5: motor turns that it is off").decision is Verdict.FAIL
    assert any("Axis 5 stands -1 motor turns (-4.500 deg)" in remark for remark in verdict.remarks)
    assert isinstance(made.arm, ShownArm)
    made.arm.lost_axes, made.arm.leaves_turns = [4], {}
    made.arm.lost_axes.clear()  # the controller takes it as good
    made.technician.does["bring_back_revolution_counters"] = lambda: setattr(made.arm, "lost_turns", (0,) * 6)
    made.spec = replace(made.spec, axes_again=(5,))
    again, verdict = await cure(made)
    assert verdict.overall_decision is Verdict.PASS
    assert again.axes[4].brought_back


async def test_a_zero_that_was_not_kept_is_no_whole_turn_and_fails() -> None:
    made = await cure_scene()
    made.arm.true_zero = tuple(
        zero + (60_000 if axis == 1 else 0) for axis, zero in enumerate(made.arm.true_zero)
    )
    result, verdict = await cure(made)
    assert verdict.overall_decision is Verdict.FAIL
    assert result.axes[1].found == "new"
    shift_rad = -60_000 / 2**19 * 2 * np.pi / 153.0
    assert abs(result.axes[1].offset_rad - shift_rad) <= result.axes[1].u_rad


async def test_machine_data_that_changed_fail_although_every_axis_is_right() -> None:
    made = await cure_scene()
    assert made.cell.position_record is not None
    before = ShownValue("$MAMES", "0.0", 2, "deg", is_constant=True)
    record = replace(made.cell.position_record, shown=(*made.cell.position_record.shown, before))
    made.cell = replace(made.cell, position_record=record)
    assert isinstance(made.arm, ShownArm)
    made.arm.constants = (replace(before, value="1.5"),)
    result, verdict = await cure(made)
    assert all(axis.is_right for axis in result.axes)
    assert result.changed_constants == ("$MAMES of axis 3: 0.0, now 1.5",)
    assert verdict.overall_decision is Verdict.FAIL


def test_a_zero_that_was_made_anew_may_differ_from_that_of_the_record() -> None:
    offsets = tuple(ShownValue("cal_offset", f"{axis}.5", axis, "rad", is_zero=True) for axis in range(6))
    changed = tuple(replace(each, value="9.9") if each.axis in (1, 4) else each for each in offsets)
    record = cast(ArmPositionRecord, SimpleNamespace(shown=offsets))
    assert changed_constants(record, changed) == (
        "cal_offset of axis 2: 1.5, now 9.9",
        "cal_offset of axis 5: 4.5, now 9.9",
    )
    assert changed_constants(record, changed, renewed=(4,)) == ("cal_offset of axis 2: 1.5, now 9.9",)
    assert changed_constants(record, ()) == ()


@pytest.mark.parametrize(
    ("keeps", "alarms", "is_whole", "ends"),
    [
        (True, (), True, ""),
        (
            True,
            (Alarm("20032", "Rev. counter not updated"),),
            True,
            "was lost while this run was interrupted: 20032",
        ),
        (True, (), False, "declined"),
        (False, (), True, "declined"),
    ],
)
async def test_a_loss_between_two_entries_of_a_run_is_no_reason_to_go_on(
    monkeypatch: pytest.MonkeyPatch, keeps: bool, alarms: tuple[Alarm, ...], is_whole: bool, ends: str
) -> None:
    made, facts = await cure_scene(), cast(list[Any], [])
    shows = replace(made.arm.capabilities, keeps_position_history=keeps)
    monkeypatch.setattr(ShownArm, "capabilities", shows)

    async def position_history(since: tuple[str, ...]) -> PositionHistory:
        return PositionHistory(alarms if since else (), ("newest",), is_whole=is_whole)

    monkeypatch.setattr(made.arm, "position_history", position_history, raising=False)
    with pytest.raises(CrashError):
        await position_cure(Run(made.cell, MortalLedger(facts, 40, stored=True)), made.spec)
    assert "position_kept" not in made.technician.instructions
    ledger = MemoryLedger(facts)
    made.technician.refuses = {"position_kept"} if ends else set()
    resumed = position_cure(Run(made.cell, ledger, ledger.past()), made.spec)
    if ends:
        with pytest.raises((RefusalError, DeclinedError), match=ends):
            await resumed
    else:
        assert verdict_on_cure(made.spec.limit_rad, await resumed).overall_decision is Verdict.PASS
    assert ("position_kept" in made.technician.instructions) is (ends == "declined")


async def test_an_axis_that_stays_lost_is_asked_for_again_and_then_given_up() -> None:
    made = await cure_scene()
    made.technician.does.pop("bring_back_revolution_counters")
    with pytest.raises(NotBroughtBackError, match="not synchronised"):
        await cure(made)
    assert made.technician.instructions.count("bring_back_revolution_counters") == 5
    assert made.arm.moves == []


async def test_work_that_was_done_in_an_earlier_entry_is_only_to_be_confirmed() -> None:
    made = await cure_scene()
    lost = AxisCure(1, PositionCure.REVOLUTION_COUNTERS, "kept", was_lost=True)
    await bring_back_axis(made.cell, lost)
    read, key = made.technician.read, "bring_back_revolution_counters"
    first = read[key]
    await bring_back_axis(made.cell, lost)
    assert "brought back already" not in first
    assert read[key].startswith("The controller shows axis 2 as brought back already: ")
    await bring_back_axis(made.cell, replace(lost, was_lost=False))  # a person wants it done
    assert "brought back already" not in read[key]


async def test_without_a_record_or_with_other_gears_or_another_robot_nothing_begins() -> None:
    made = await cure_scene()
    assert made.cell.position_record is not None
    measured = made.cell.position_record.measured
    for record, words in (
        (None, "no position record"),
        (replace(made.cell.position_record, measured=replace(measured, robot_serial="X")), "is of robot X"),
        (
            replace(
                made.cell.position_record, measured=replace(measured, drive=drive_of_ratios([100.0] * 6))
            ),
            "gear ratios",
        ),
    ):
        made.cell = replace(made.cell, position_record=record)
        with pytest.raises(RefusalError, match=words):
            await cure(made)
    assert made.technician.instructions == []


async def test_a_loss_whose_axes_are_not_named_is_refused_until_a_person_names_them() -> None:
    made = await cure_scene()

    async def unnamed() -> Any:
        condition = await ShownArm.read_condition(made.arm)  # type: ignore[arg-type]
        return replace(condition, alarms=tuple(replace(alarm, axis=None) for alarm in condition.alarms))

    made.arm.read_condition = unnamed  # type: ignore[method-assign]
    with pytest.raises(RefusalError, match="names no axis"):
        await cure(made)
    made.spec = replace(made.spec, axes_again=(9,))
    with pytest.raises(RefusalError, match="not there"):
        await cure(made)


def test_a_robot_whose_mastering_is_open_or_whose_gears_are_unknown_does_not_get_it() -> None:
    lacks = missing_needs(CATALOGUE["position_cure"], healthy_scene().cell)
    assert len(lacks) == 2
    assert "at its pendant" in lacks[0]
    assert "gear ratio" in lacks[1]


@pytest.mark.parametrize("ratios", [[100.0, 0.5], [100.0, float("nan")], [[100.0]]])
def test_ratios_that_are_none_are_refused(ratios: Any) -> None:
    with pytest.raises(CalibrationError, match="motor turns"):
        drive_of_ratios(ratios)


def test_each_make_is_asked_in_its_own_words() -> None:
    texts = {
        (cure, zero): cure_instruction(AxisCure(2, cure, zero, True)).text
        for cure in PositionCure
        for zero in ("kept", "new")
    }
    assert "Axis 3: " in texts[PositionCure.REVOLUTION_COUNTERS, "kept"]
    assert "fine calibration" in texts[PositionCure.REVOLUTION_COUNTERS, "new"]
    assert "Axis U: " in texts[PositionCure.ABSOLUTE_DATA, "kept"]
    assert "home position anew" in texts[PositionCure.ABSOLUTE_DATA, "new"]
    assert "Axis A3: " in texts[PositionCure.MASTERING_GAUGE, "new"]
    assert "EMD" in texts[PositionCure.MASTERING_GAUGE, "new"]


@pytest.mark.parametrize("cure_at_pendant", [PositionCure.REVOLUTION_COUNTERS, PositionCure.ABSOLUTE_DATA])
async def test_an_axis_is_called_back_or_not_only_where_the_controller_tells_each_axis(
    cure_at_pendant: PositionCure, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pendant_cures, "WATCH_S", 0.001)
    refusal_texts: list[str] = []
    made = await cure_scene(lost=(1,))

    class Watched(ScriptedTechnician):
        async def confirm(self, instruction: Instruction) -> Answer:
            for _ in range(50):  # looks are made meanwhile
                if not refusal_texts:
                    await asyncio.sleep(0.002)
            made.arm.lost_axes.clear()
            return await super().confirm(instruction)

        def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
            refusal_texts.append(text)

    assert isinstance(made.arm, ShownArm)
    made.arm.cure = cure_at_pendant
    cell = replace(made.cell, operator=Watched())
    await bring_back_axis(cell, AxisCure(1, cure_at_pendant, "kept", True))
    each_axis = cure_at_pendant is PositionCure.REVOLUTION_COUNTERS
    assert refusal_texts[:1] == (["Axis 2 is not brought back yet."] if each_axis else [])


async def test_a_person_who_jogs_is_asked_for_and_nothing_is_commanded() -> None:
    made = await cure_scene()
    made.cell = replace(made.cell, level=MotionLevel.OBSERVE)
    made.technician.does["jog_by_hand"] = lambda: None
    with pytest.raises(Exception, match="was not turned as asked"):
        await cure(made)
    assert "jog_by_hand" in made.technician.instructions
    assert made.arm.moves == []
    assert isinstance(made.spec, PositionCureSpec)
