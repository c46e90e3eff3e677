"""What the cell file answers by itself in a recovery that the watch started, and from where on people answer."""

import pytest

from cellcal.drivers.interfaces import Answer, Instruction, Question
from cellcal.drivers.operator.scripted import ScriptedOperator
from cellcal.procedures.mastering_record import HOOK_WIRE
from cellcal.procedures.mastering_recovery import AT_REFERENCE
from cellcal.procedures.recovery.position_alarms import NEW_BATTERY, POWER_CYCLE, SLOW_MOTION
from cellcal.service.configuration.cell_file import WatchTable
from cellcal.service.watching.automatic_operator import CELL_FILE, AutomaticOperator

PLAN = Instruction("accept_plan", "The robot will move.")
NEWEST = Instruction("saved_counts", "Is no newer record at hand?")
WRITE = Instruction("accept_mastering", "Write the mastering data to the controller?")
YES = {
    each.key: "yes"
    for each in (PLAN, NEWEST, WRITE, HOOK_WIRE, NEW_BATTERY, POWER_CYCLE, SLOW_MOTION, AT_REFERENCE)
}
VOUCHED = WatchTable(recover_alone=True, cell_closed=True, records_complete=True, wire_stays_hooked=True)


def automatic_operator(watch: WatchTable) -> AutomaticOperator:
    return AutomaticOperator(watch, ScriptedOperator(YES | {"retry": "yes", "plate": "F-1"}, person="Anna"))


async def test_a_checked_plan_and_confirmed_facts_are_answered_automatically() -> None:
    alone = automatic_operator(VOUCHED)
    for instruction in (NEWEST, HOOK_WIRE, PLAN):
        assert await alone.confirm(instruction) == Answer(CELL_FILE)


@pytest.mark.parametrize(
    "instruction",
    [WRITE, NEW_BATTERY, POWER_CYCLE, SLOW_MOTION, AT_REFERENCE, Instruction("retry", "Try again?")],
)
async def test_manual_steps_looks_and_writes_go_to_a_person_and_so_does_all_that_follows(
    instruction: Instruction,
) -> None:
    alone = automatic_operator(VOUCHED)
    assert (await alone.confirm(PLAN)).who == CELL_FILE
    assert (await alone.confirm(instruction)).who == "Anna"
    assert (await alone.confirm(PLAN)).who == "Anna"  # a called person may stand in the cell


async def test_what_only_a_person_knows_ends_it_too() -> None:
    alone = automatic_operator(VOUCHED)
    assert (await alone.ask_question(Question("plate", "What does the plate say?"))).who == "Anna"
    assert (await alone.confirm(PLAN)).who == "Anna"


@pytest.mark.parametrize("instruction", [NEWEST, HOOK_WIRE])
async def test_unconfirmed_facts_are_asked(instruction: Instruction) -> None:
    assert (
        await automatic_operator(WatchTable(recover_alone=True, cell_closed=True)).confirm(instruction)
    ).who == "Anna"


async def test_without_the_permission_no_plan_is_approved() -> None:
    assert (await automatic_operator(WatchTable(wire_stays_hooked=True)).confirm(PLAN)).who == "Anna"
