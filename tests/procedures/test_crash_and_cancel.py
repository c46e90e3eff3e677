"""Every procedure of the catalogue survives a crash at its steps, and stops the robot when cancelled."""

import asyncio
import os
import re

import pytest
from pydantic_core import to_jsonable_python

from procedures.catalogue import CATALOGUE, ENTRIES
from procedures.past import Kind
from procedures.progress import Progress
from procedures.run import Run
from tests.procedures.cells import Scene, pointing, scene_for
from tests.procedures.conclusions import same_end
from tests.procedures.ledgers import CrashError, MemoryLedger, MortalLedger

NAMES = [entry.name for entry in ENTRIES]
CRASHES = int(
    os.environ.get("CELLCAL_CRASHES", "24")
)  # of the writes of a long procedure, evenly spread; `make soak` takes all of them


async def _scene(name: str) -> Scene:
    """Return a scene of the procedure in which it goes on until it knows enough."""
    return pointing(accuracy_class="C") if name == "three_point_frame" else await scene_for(name)


async def _whole(name: str) -> tuple[object, MemoryLedger, Scene]:
    made, ledger = await _scene(name), MemoryLedger()
    return await CATALOGUE[name].procedure(Run(made.cell, ledger), made.spec), ledger, made


def _spread(count: int) -> list[int]:
    return sorted({round(k * (count - 1) / (CRASHES - 1)) for k in range(CRASHES)})


@pytest.mark.parametrize("name", NAMES)
async def test_the_outline_is_what_really_runs(name: str) -> None:
    _, ledger, made = await _whole(name)
    entry = CATALOGUE[name]
    ran: dict[str, int] = {}
    for finding in ledger.past().findings:
        phase = re.sub(r" \d+$", "", finding.step)
        ran[phase] = ran.get(phase, 0) + 1
    outline = {phase.name: phase for phase in entry.outline(made.spec)}
    assert ran.keys() <= outline.keys()
    for phase in outline.values():
        if not phase.adaptive:
            assert ran.get(phase.name) == len(phase.steps), phase.name


@pytest.mark.parametrize("name", NAMES)
async def test_a_replay_gives_the_identical_result_and_moves_nothing(name: str) -> None:
    result, ledger, made = await _whole(name)
    moves, writes = len(made.arm.moves), made.arm.writes
    again = await CATALOGUE[name].procedure(
        Run(made.cell, MemoryLedger(ledger.facts), ledger.past()), made.spec
    )
    assert again == result
    assert (len(made.arm.moves), made.arm.writes) == (moves, writes)


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("name", NAMES)
async def test_a_crash_at_any_write_loses_and_doubles_nothing(name: str, stored: bool) -> None:
    result, whole, _ = await _whole(name)
    steps = [finding.step for finding in whole.past().findings]
    for dies_at in _spread(len(whole.facts)):
        made = await _scene(name)
        facts: list = []
        mortal = MortalLedger(facts, dies_at, stored=stored)
        with pytest.raises(CrashError):
            await CATALOGUE[name].procedure(Run(made.cell, mortal), made.spec)
        interrupted = str(facts[-1][1].get("step", "")) if facts else ""
        acknowledged = MemoryLedger(list(facts)).past().findings
        ledger = MemoryLedger(facts)
        resumed = await CATALOGUE[name].procedure(Run(made.cell, ledger, ledger.past()), made.spec)
        findings = ledger.past().findings
        assert findings[: len(acknowledged)] == acknowledged
        assert [finding.step for finding in findings] == steps
        assert same_end(to_jsonable_python(resumed), to_jsonable_python(result), interrupted), interrupted


@pytest.mark.parametrize("name", NAMES)
async def test_a_cancel_in_any_step_stops_the_robot_and_is_resumed_to_the_same_result(name: str) -> None:
    result, whole, _ = await _whole(name)
    started = [body["step"] for kind, body in whole.facts if kind in (Kind.ENTERED, Kind.INTENT)]
    for index in _spread(len(started)):
        made, ledger = await _scene(name), MemoryLedger()
        await _cancelled_in(started[index], name, made, ledger)
        assert made.arm.stops == 1, started[index]
        assert ledger.facts[-1][0] == Kind.FAILED
        assert ledger.facts[-1][1]["stopped"] is True
        again = MemoryLedger(ledger.facts)
        resumed = await CATALOGUE[name].procedure(Run(made.cell, again, again.past()), made.spec)
        assert same_end(to_jsonable_python(resumed), to_jsonable_python(result), started[index]), started[
            index
        ]


async def _cancelled_in(step: str, name: str, made: Scene, ledger: MemoryLedger) -> None:
    def announce(progress: Progress) -> None:
        if progress.kind == "started" and progress.step == step:
            task.cancel()

    run = Run(made.cell, ledger, announce=announce)
    task = asyncio.create_task(CATALOGUE[name].procedure(run, made.spec))
    with pytest.raises(asyncio.CancelledError):
        await task
