"""Every procedure of the catalogue survives a crash at its steps, and stops the robot when cancelled."""

import asyncio
import os
import re
from collections.abc import Awaitable, Callable
from functools import partial
from itertools import pairwise
from typing import Any

import pytest
from pydantic_core import to_jsonable_python

from cellcal.procedures.catalogue import CATALOGUE, DEFINITIONS
from cellcal.procedures.progress import StepProgress
from cellcal.procedures.refit import LEFT_OUT
from cellcal.procedures.run import Run
from cellcal.procedures.run_history import EventKind
from tests.procedures.conclusions import has_same_result
from tests.procedures.memory_ledgers import CrashError, MemoryLedger, MortalLedger
from tests.procedures.procedure_scenes import (
    ProcedureScene,
    alignment_with_outlier,
    scene_for,
    user_frame_scene,
)
from tests.procedures.test_record_by_places import recording_places
from tests.procedures.test_recovery_by_places import lost_places

NAMES = [entry.name for entry in DEFINITIONS]
FURTHER: dict[str, Callable[[], Awaitable[ProcedureScene]]] = {
    f"{procedure} by {what}": made
    for what, record, recovery in (
        ("touched points", partial(recording_places, "probe"), partial(lost_places, "point")),
        ("a seat", partial(recording_places, "seat"), partial(lost_places, "seat")),
        ("a tracker", partial(recording_places, "tracker"), partial(lost_places, "target")),
    )
    for procedure, made in (("mastering_record", record), ("mastering_recovery", recovery))
} | {"fixture_alignment by all lengths but one": alignment_with_outlier}
CASES = [*NAMES, *FURTHER]
LIMIT_BY_ENVIRONMENT = os.environ.get("CELLCAL_CRASHES", "")
CRASHES = int(
    LIMIT_BY_ENVIRONMENT or 3
)  # of a procedure's writes, evenly spread; `make soak ARGS=matrix` takes all of them
FEW = int(LIMIT_BY_ENVIRONMENT or 1)  # of further scenes of a procedure, and of moves
LONG = {  # of procedures that take long: an arm that waits at each contact, and many lengths to judge
    "probed_frame": int(LIMIT_BY_ENVIRONMENT or 1),
    "robot_calibration": int(LIMIT_BY_ENVIRONMENT or 1),
    "mastering_record": int(LIMIT_BY_ENVIRONMENT or 1),
    "mastering_recovery": int(LIMIT_BY_ENVIRONMENT or 1),
    "position_record": int(LIMIT_BY_ENVIRONMENT or 1),
    "position_cure": int(LIMIT_BY_ENVIRONMENT or 1),
}


async def _scene_of(case: str) -> ProcedureScene:
    """Return a scene of the procedure in which it goes on until it knows enough."""
    if case in FURTHER:
        return await FURTHER[case]()
    return user_frame_scene(accuracy_class="C") if case == "three_point_frame" else await scene_for(case)


def _procedure_of(case: str) -> Callable[[Run, Any], Awaitable[Any]]:
    return CATALOGUE[case.partition(" by ")[0]].procedure


async def _run_whole(case: str) -> tuple[object, MemoryLedger, ProcedureScene]:
    made, ledger = await _scene_of(case), MemoryLedger()
    return await _procedure_of(case)(Run(made.cell, ledger), made.spec), ledger, made


_UNDISTURBED: dict[str, tuple[object, MemoryLedger, ProcedureScene]] = {}


async def _find_undisturbed(case: str) -> tuple[object, MemoryLedger, ProcedureScene]:
    """Return how a case ends undisturbed, run once for all tests, which compare with it and change nothing."""
    if case not in _UNDISTURBED:
        _UNDISTURBED[case] = await _run_whole(case)
    return _UNDISTURBED[case]


def _spread_places(case: str, count: int, *, between: bool = False) -> list[int]:
    """Return places evenly spread over so many; ``between``: others, half-way between these, and the last."""
    most = FEW if case in FURTHER else LONG.get(case, CRASHES)
    places = _even_places(count, most)
    if not between:
        return places
    return sorted({*((a + b) // 2 for a, b in pairwise([0, *places])), *(places[-1:] if most > 1 else [])})


def _even_places(count: int, most: int) -> list[int]:
    """Return the first, the last and those between; of two the middle and the last, of one the middle."""
    if most < 3:
        return sorted({count // 2, *([count - 1] if most == 2 else [])}) if count else []
    return sorted({round(k * (count - 1) / (most - 1)) for k in range(most)}) if count else []


@pytest.mark.parametrize("name", NAMES)
async def test_the_outline_is_what_really_runs(name: str) -> None:
    _, ledger, made = await _find_undisturbed(name)
    entry = CATALOGUE[name]
    ran: dict[str, int] = {}
    for finding in ledger.past().findings:
        phase = re.sub(r" \d+$", "", finding.step)
        ran[phase] = ran.get(phase, 0) + 1
    outline = {phase.name: phase for phase in entry.outline(made.spec)}
    assert ran.keys() <= outline.keys()
    for phase in outline.values():
        if not phase.adaptive:
            assert ran.get(phase.name) == len(phase.step_names), phase.name


@pytest.mark.parametrize("name", NAMES)
async def test_a_replay_gives_the_identical_result_and_moves_nothing(name: str) -> None:
    result, ledger, made = await _run_whole(name)
    moves, writes = len(made.arm.moves), made.arm.writes
    again = await CATALOGUE[name].procedure(
        Run(made.cell, MemoryLedger(ledger.facts), ledger.past()), made.spec
    )
    assert again == result
    assert (len(made.arm.moves), made.arm.writes) == (moves, writes)


async def test_a_length_is_left_out_in_the_scene_that_says_so() -> None:
    result, _, _ = await _find_undisturbed("fixture_alignment by all lengths but one")
    assert [aside.reason for aside in result.set_aside] == [LEFT_OUT]  # type: ignore[attr-defined]


@pytest.mark.parametrize("stored", [False, True])
@pytest.mark.parametrize("case", CASES)
async def test_a_crash_at_any_write_loses_and_doubles_nothing(case: str, stored: bool) -> None:
    result, whole, _ = await _find_undisturbed(case)
    steps = [finding.step for finding in whole.past().findings]
    for dies_at in _spread_places(case, len(whole.facts), between=stored and not LIMIT_BY_ENVIRONMENT):
        made = await _scene_of(case)
        facts: list = []
        mortal = MortalLedger(facts, dies_at, stored=stored)
        with pytest.raises(CrashError):
            await _procedure_of(case)(Run(made.cell, mortal), made.spec)
        interrupted = str(facts[-1][1].get("step", "")) if facts else ""
        acknowledged = MemoryLedger(list(facts)).past().findings
        ledger = MemoryLedger(facts)
        resumed = await _procedure_of(case)(Run(made.cell, ledger, ledger.past()), made.spec)
        findings = ledger.past().findings
        assert findings[: len(acknowledged)] == acknowledged
        assert [finding.step for finding in findings] == steps
        assert has_same_result(to_jsonable_python(resumed), to_jsonable_python(result), interrupted), (
            interrupted
        )


@pytest.mark.parametrize("case", CASES)
async def test_a_cancel_in_any_step_stops_the_robot_and_is_resumed_to_the_same_result(case: str) -> None:
    result, whole, _ = await _find_undisturbed(case)
    started = [body["step"] for kind, body in whole.facts if kind in (EventKind.ENTERED, EventKind.INTENT)]
    for index in _spread_places(case, len(started)):
        made, ledger = await _scene_of(case), MemoryLedger()
        await _cancelled_in(started[index], case, made, ledger)
        assert made.arm.stops == 1, started[index]
        assert ledger.facts[-1][0] == EventKind.FAILED
        assert ledger.facts[-1][1]["stopped"] is True
        again = MemoryLedger(ledger.facts)
        resumed = await _procedure_of(case)(Run(made.cell, again, again.past()), made.spec)
        assert has_same_result(to_jsonable_python(resumed), to_jsonable_python(result), started[index]), (
            started[index]
        )


async def _cancelled_in(step: str, case: str, made: ProcedureScene, ledger: MemoryLedger) -> None:
    def cancel_at_step(progress: StepProgress) -> None:
        if progress.kind == "started" and progress.step == step:
            task.cancel()

    run = Run(made.cell, ledger, announce=cancel_at_step)
    task = asyncio.create_task(_procedure_of(case)(run, made.spec))
    with pytest.raises(asyncio.CancelledError):
        await task


@pytest.mark.parametrize("case", CASES)
async def test_a_cancel_in_the_middle_of_a_move_leaves_the_robot_standing_there_and_says_so(
    case: str,
) -> None:
    result, _, undisturbed = await _find_undisturbed(case)
    began = len((await _scene_of(case)).arm.moves)
    for number in _even_places(len(undisturbed.arm.moves) - began, FEW):
        made, ledger = await _scene_of(case), MemoryLedger()
        stood = await _cancelled_on_the_way(began + number + 1, case, made, ledger)
        assert len(made.arm.moves) == began + number + 1  # it went no further
        assert not made.arm.moving
        assert made.arm.true_joints.tolist() == stood.tolist()
        assert made.arm.stops == 1
        kind, last = ledger.facts[-1]
        assert (kind, last["stopped"]) == (EventKind.FAILED, True)
        again = MemoryLedger(ledger.facts)
        resumed = await _procedure_of(case)(Run(made.cell, again, again.past()), made.spec)
        assert made.arm.data == undisturbed.arm.data
        assert (made.arm.tools, made.arm.frames) == (undisturbed.arm.tools, undisturbed.arm.frames)
        if not case.startswith(("mastering_recovery", "position_cure")):  # a jog taken up again ends beside
            assert to_jsonable_python(resumed) == to_jsonable_python(result), last["step"]


async def _cancelled_on_the_way(number: int, case: str, made: ProcedureScene, ledger: MemoryLedger) -> Any:
    """Cancel a run in the middle of its n-th move; return the joints (6,) at which the arm then was."""
    stood = []

    def cancel_during_move(move: int) -> None:
        if move == number:
            stood.append(made.arm.true_joints)
            task.cancel()

    made.arm.midway = cancel_during_move
    task = asyncio.create_task(_procedure_of(case)(Run(made.cell, ledger), made.spec))
    with pytest.raises(asyncio.CancelledError):
        await task
    made.arm.midway = None
    (at,) = stood
    return at
