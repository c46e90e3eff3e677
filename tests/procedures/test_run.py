"""The engine: each test is a sentence of what a run promises."""

import asyncio
from dataclasses import dataclass

import pytest

from cellcal.drivers.errors import DeviceTimeoutError, MotionStoppedError
from cellcal.drivers.interfaces import Answer, Instruction
from cellcal.procedures.cell import Cell
from cellcal.procedures.progress import PauseGate, StepProgress
from cellcal.procedures.questions import ask_confirmation
from cellcal.procedures.run import DeclinedError, ReplayMismatchError, Run
from cellcal.procedures.run_history import EventKind, RunHistory
from cellcal.service.record.journal import Journal, StoreError
from cellcal.service.runs.journal_ledger import JournalLedger
from tests.procedures.ideal_devices import IdealArm, ScriptedTechnician
from tests.procedures.memory_ledgers import CrashError, MemoryLedger, MortalLedger


@dataclass(frozen=True)
class SumResult:
    """A result with an awkward float."""

    total: float
    parts: tuple[float, ...]


class CountingWorld:
    """Counts what really happened."""

    def __init__(self) -> None:
        self.arm, self.technician = IdealArm(), ScriptedTechnician()
        self.cell = Cell("test", self.arm, self.technician)
        self.done: list[str] = []


world_of: dict[int, CountingWorld] = {}


async def read_value(cell: Cell, value: float) -> float:
    world_of[id(cell.robot)].done.append(f"read {value}")
    return value / 3.0


async def turn_axis(cell: Cell, axis: int) -> tuple[float, ...]:
    await cell.robot.move_joints(tuple(0.1 * (k == axis) for k in range(6)), speed_rad_s=0.1)
    world_of[id(cell.robot)].done.append(f"turn {axis}")
    return (await cell.robot.read_joints()).joints_rad


async def write_value(cell: Cell, value: float) -> float:
    world_of[id(cell.robot)].done.append(f"write {value}")
    return value


def add_values(values: tuple[float, ...]) -> SumResult:
    return SumResult(sum(values), values)


async def toy_procedure(run: Run, values: tuple[float, ...]) -> SumResult:
    """Read, move, calculate, write."""
    await run.ensure("a person is there", ask_confirmation, Instruction("there", "Are you there?"))
    read_values = [await run.step(f"read {k}", read_value, value) for k, value in enumerate(values, 1)]
    await run.move("turn", turn_axis, 2)
    total = await run.solve("add", add_values, tuple(read_values))
    await run.step("inside: read 1", read_value, 9.0)
    await run.write("write", write_value, total.total)
    return total


VALUES = (0.1, 0.7, 1e-17)


@pytest.fixture
def world():
    made = CountingWorld()
    world_of[id(made.arm)] = made
    yield made
    del world_of[id(made.arm)]


async def test_a_run_returns_what_its_steps_found(world: CountingWorld) -> None:
    ledger = MemoryLedger()
    result = await toy_procedure(Run(world.cell, ledger), VALUES)
    assert result == add_values(tuple(v / 3.0 for v in VALUES))
    assert [step.step for step in ledger.past().findings] == [
        *("read 1", "read 2", "read 3", "turn", "add", "inside: read 1", "write")
    ]
    assert ledger.event_kinds("turn") == ["intent", "finding"]
    assert ledger.event_kinds("read 1") == ["step_entered", "finding"]
    assert ledger.event_kinds("a person is there") == ["step_entered", "condition"]


async def test_a_finished_run_replays_identically_and_touches_nothing_but_its_conditions(
    world: CountingWorld,
) -> None:
    ledger = MemoryLedger()
    first = await toy_procedure(Run(world.cell, ledger), VALUES)
    done, moves, instruction_count = (
        list(world.done),
        list(world.arm.moves),
        len(world.technician.instructions),
    )
    again = await toy_procedure(Run(world.cell, MemoryLedger(ledger.facts), ledger.past()), VALUES)
    assert again == first
    assert (world.done, world.arm.moves) == (done, moves)
    assert world.technician.instructions[instruction_count:] == ["there"]


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("dies_at", range(16))
async def test_a_crash_at_any_write_is_resumed_to_the_same_result(
    world: CountingWorld, dies_at: int, stored: bool
) -> None:
    facts: list = []
    with pytest.raises(CrashError):
        await toy_procedure(Run(world.cell, MortalLedger(facts, dies_at, stored=stored)), VALUES)
    finding_count = len(MemoryLedger(list(facts)).past().findings)
    done = len(world.done)
    ledger = MemoryLedger(facts)
    result = await toy_procedure(Run(world.cell, ledger, ledger.past()), VALUES)
    assert result == add_values(tuple(v / 3.0 for v in VALUES))
    assert len(ledger.past().findings) == 7
    assert len(world.done) - done == 7 - finding_count - (finding_count <= 4)  # "add" touches nothing


async def test_a_run_that_died_between_intent_and_outcome_asks_before_it_moves(world: CountingWorld) -> None:
    facts: list = []
    with pytest.raises(CrashError):
        await toy_procedure(Run(world.cell, MortalLedger(facts, 8, stored=True)), VALUES)
    ledger = MemoryLedger(facts)
    assert ledger.past().in_doubt == "turn"
    world.technician.refuses = {"may_move"}
    moves = list(world.arm.moves)
    with pytest.raises(DeclinedError):
        await toy_procedure(Run(world.cell, ledger, ledger.past()), VALUES)
    assert world.arm.moves == moves
    world.technician.refuses = set()
    ledger = MemoryLedger(facts)
    await toy_procedure(Run(world.cell, ledger, ledger.past()), VALUES)
    assert world.technician.instructions.count("may_move") == 2
    approvals = [body for kind, body in ledger.facts if kind == EventKind.APPROVAL]
    assert [(body["key"], body["before"], body["who"]) for body in approvals] == [
        ("may_move", "a person is there", "anna")
    ]


async def test_a_failed_step_stops_the_robot_and_says_why_in_the_journal(world: CountingWorld) -> None:
    ledger = MemoryLedger()

    async def failing_step(cell: Cell) -> None:
        raise MotionStoppedError("arm", "protective stop", remedy="Clear it on the pendant.")

    with pytest.raises(MotionStoppedError):
        await Run(world.cell, ledger).move("go", failing_step)
    assert world.arm.stops == 1
    kind, body = ledger.facts[-1]
    assert (kind, body["code"], body["stopped"]) == ("failed", "device.stopped", True)
    assert ledger.past().in_doubt is None


async def test_a_robot_that_cannot_be_stopped_leaves_the_step_in_doubt(world: CountingWorld) -> None:
    ledger = MemoryLedger()

    class UnstoppableArm(IdealArm):
        async def stop(self) -> None:
            raise DeviceTimeoutError("arm", "no answer")

    async def failing_step(cell: Cell) -> None:
        raise MotionStoppedError("arm", "cable")

    with pytest.raises(MotionStoppedError):
        await Run(Cell("test", UnstoppableArm(), world.technician), ledger).move("go", failing_step)
    assert ledger.past().in_doubt == "go"


async def test_a_cancelled_step_stops_the_robot_once_and_re_raises_even_if_cancelled_again(
    world: CountingWorld,
) -> None:
    ledger = MemoryLedger()
    entered = asyncio.Event()

    async def waiting_step(cell: Cell) -> None:
        entered.set()
        await asyncio.Event().wait()

    task = asyncio.create_task(Run(world.cell, ledger).move("wait", waiting_step))
    await entered.wait()
    task.cancel()
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert world.arm.stops == 1
    assert ledger.event_kinds("wait") == ["intent", "failed"]


async def test_a_run_cancelled_while_a_failed_step_stops_the_robot_ends_and_asks_for_no_retry(
    world: CountingWorld,
) -> None:
    ledger, stopping, stopped = MemoryLedger(), asyncio.Event(), asyncio.Event()

    class SlowToStopArm(IdealArm):
        async def stop(self) -> None:
            stopping.set()
            await stopped.wait()

    async def failing_step(cell: Cell) -> None:
        raise DeviceTimeoutError("arm", "no answer")

    run = Run(Cell("test", SlowToStopArm(), world.technician), ledger)
    task = asyncio.create_task(run.move("go", failing_step))
    await stopping.wait()
    task.cancel()
    await asyncio.sleep(0)
    stopped.set()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert world.technician.instructions == []
    assert ledger.event_kinds("go") == ["intent", "failed"]


async def test_an_unreachable_device_is_retried_only_after_confirmation(world: CountingWorld) -> None:
    ledger = MemoryLedger()
    tries: list[int] = []

    async def flaky_step(cell: Cell) -> int:
        tries.append(1)
        if len(tries) < 3:
            raise DeviceTimeoutError("arm", "no answer")
        return len(tries)

    assert await Run(world.cell, ledger).step("read", flaky_step) == 3
    assert world.technician.instructions == ["retry", "retry"]
    world.technician.refuses = {"retry"}
    tries.clear()
    with pytest.raises(DeviceTimeoutError):
        await Run(world.cell, MemoryLedger()).step("read", flaky_step)
    assert len(tries) == 1


async def test_an_unreachable_device_is_given_up_after_three_attempts(world: CountingWorld) -> None:
    async def dead_step(cell: Cell) -> None:
        raise DeviceTimeoutError("arm", "no answer")

    with pytest.raises(DeviceTimeoutError):
        await Run(world.cell, MemoryLedger()).step("read", dead_step)
    assert world.technician.instructions == ["retry", "retry"]


async def test_other_inputs_or_other_steps_than_journalled_are_refused(world: CountingWorld) -> None:
    ledger = MemoryLedger()
    await toy_procedure(Run(world.cell, ledger), VALUES)
    with pytest.raises(ReplayMismatchError, match="other inputs"):
        await toy_procedure(Run(world.cell, MemoryLedger(), ledger.past()), (0.1, 0.8, 1e-17))
    with pytest.raises(ReplayMismatchError, match="where the procedure asks"):
        await toy_procedure(Run(world.cell, MemoryLedger(), ledger.past()), (0.1, 0.7, 1e-17, 4.0))


async def test_the_last_bits_of_a_float_do_not_stop_a_replay(world: CountingWorld) -> None:
    ledger = MemoryLedger()
    await Run(world.cell, ledger).step("read", read_value, 0.3)
    past = ledger.past()
    assert (
        await Run(world.cell, MemoryLedger(), past).step("read", read_value, 0.3 * (1 + 1e-12)) == 0.3 / 3.0
    )
    with pytest.raises(ReplayMismatchError):
        await Run(world.cell, MemoryLedger(), past).step("read", read_value, 0.3 * (1 + 1e-8))


async def test_findings_after_a_redo_are_made_anew(world: CountingWorld) -> None:
    ledger = MemoryLedger()
    await toy_procedure(Run(world.cell, ledger), VALUES)
    ledger.record(EventKind.FORGOTTEN, {"keep": 1, "step": "read 2"})
    world.done.clear()
    again = MemoryLedger(ledger.facts)
    result = await toy_procedure(Run(world.cell, again, again.past()), (VALUES[0], 5.0, 6.0))
    assert result.parts == (VALUES[0] / 3.0, 5.0 / 3.0, 2.0)
    assert world.done[:2] == ["read 5.0", "read 6.0"]
    assert len(again.past().findings) == 7


async def test_two_steps_may_not_share_a_name(world: CountingWorld) -> None:
    run = Run(world.cell, MemoryLedger())
    await run.step("read", read_value, 1.0)
    with pytest.raises(ReplayMismatchError):
        await run.step("read", read_value, 2.0)
    await run.step("read again", read_value, 2.0)


async def test_a_paused_run_waits_at_the_next_border(world: CountingWorld) -> None:
    gate, ledger = PauseGate(), MemoryLedger()
    progress_events: list[StepProgress] = []
    run = Run(world.cell, ledger, gate=gate, announce=progress_events.append)
    await run.step("one", read_value, 1.0)
    gate.pause()
    task = asyncio.create_task(run.step("two", read_value, 2.0))
    for _ in range(3):
        await asyncio.sleep(0)
    assert progress_events[-1].kind == "paused"
    assert world.done == ["read 1.0"]
    gate.resume()
    await task
    assert world.done == ["read 1.0", "read 2.0"]
    assert [kind for kind, _ in ledger.facts if kind in ("paused", "continued")] == ["paused", "continued"]


async def test_progress_counts_steps_towards_what_was_expected(world: CountingWorld) -> None:
    progress_events: list[StepProgress] = []
    await toy_procedure(Run(world.cell, MemoryLedger(), expected=7, announce=progress_events.append), VALUES)
    assert [(p.step, p.index, p.expected) for p in progress_events if p.kind == "finding"] == [
        *(("read 1", 1, 7), ("read 2", 2, 7), ("read 3", 3, 7), ("turn", 4, 7), ("add", 5, 7)),
        *(("inside: read 1", 6, 7), ("write", 7, 7)),
    ]


async def test_what_is_not_a_number_never_becomes_a_finding(world: CountingWorld, tmp_path) -> None:
    with Journal.open_file(tmp_path / "journal.db") as journal:
        ledger = JournalLedger(journal, "run", "anna")
        with pytest.raises(StoreError):
            await Run(world.cell, ledger).step("read", read_value, float("nan"))
        assert [event.kind for event in journal.list_events()] == []


async def test_the_answer_names_the_person(world: CountingWorld) -> None:
    answer = await Run(world.cell, MemoryLedger(), RunHistory()).step(
        "ask", ask_confirmation, Instruction("go", "Go?")
    )
    assert answer == Answer("anna")
