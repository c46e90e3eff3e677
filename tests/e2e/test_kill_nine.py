"""kill -9 at random instants of a running recovery: nothing acknowledged is lost or doubled, same end."""

import asyncio
import json
import multiprocessing
import os
import random
import tempfile
from pathlib import Path
from typing import Any

from cellcal.procedures.run_history import EventKind
from cellcal.service.record.journal import Journal
from cellcal.service.record.run_store import RunStore, RunView
from tests.e2e.kill_nine.world import SceneServer, parts_of, run_child
from tests.machine_speed import stretched_s
from tests.procedures.conclusions import comparable_result
from tests.procedures.procedure_scenes import ProcedureScene, recovery_scene

KILLS = 4  # `make soak ARGS=kill` makes a hundred
_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(["tests.e2e.kill_nine.world"])


def _one_life(
    made: ProcedureScene, journal: Path, run_id: str | None, kill: dict[str, Any] | None
) -> SceneServer:
    """Let a process run or resume the recovery until it ends or is killed."""
    ours, theirs = _context.Pipe()
    arguments = (theirs, journal, "mastering_recovery", parts_of(made), run_id)
    process = _context.Process(target=run_child, args=arguments, daemon=True)
    process.start()
    theirs.close()
    served = SceneServer(made, ours)
    served.until_closed(process.kill, **(kill or {}))
    process.join(stretched_s(120.0))
    assert process.exitcode in ((0,) if kill is None else (0, -9))
    served.killed = process.exitcode == -9
    process.close()
    ours.close()
    return served


def _the_run(path: Path) -> RunView | None:
    with Journal.open_file(path) as journal:
        assert journal.damage is None
        runs = RunStore(journal).list_runs()
    return runs[-1] if runs else None


def _steps_stored(path: Path) -> list[tuple[str, Any]]:
    with Journal.open_file(path) as journal:
        events = [(event.kind, json.loads(event.body)) for event in journal.list_events()]
    return [(body["step"], body["value"]) for kind, body in events if kind == EventKind.FINDING]


def kill_and_resume(kills: int, seed: int) -> list[str]:
    """Kill so many processes, some runs twice; return how runs ended otherwise than the undisturbed one."""
    with tempfile.TemporaryDirectory() as folder:
        made = asyncio.run(recovery_scene())
        undisturbed = _one_life(made, Path(folder) / "whole.db", None, None)
        whole = _the_run(Path(folder) / "whole.db")
        assert whole is not None
        assert whole.state == "passed"
        wrong: list[str] = []
        done = trial = 0
        while done < kills:
            trial += 1
            rng = random.Random(f"{seed}/{trial}")
            end, killed = _one_run(Path(folder) / f"{trial}.db", rng, undisturbed.calls)
            wrong += [f"run {trial}: {difference}" for difference in _list_differences(end, whole)]
            done += killed
    return wrong


def _one_run(path: Path, rng: random.Random, calls: int) -> tuple[RunView, int]:
    """Kill one run once or twice and finish it; return how it ended, and the kills."""
    made = asyncio.run(recovery_scene())
    acknowledged: list[tuple[str, Any]] = []
    run_id, killed = None, 0
    for life in range(rng.choice((1, 1, 2))):
        kill = {
            "at_call": rng.randrange(1, calls >> life),
            "after_s": rng.choice((0.0, rng.random() / 50)),
        }
        served = _one_life(made, path, run_id, kill)
        acknowledged, killed = acknowledged + served.acknowledged, killed + served.killed
        view = _the_run(path)
        run_id = view.run_id if view else None
    acknowledged += _one_life(made, path, run_id, None).acknowledged
    end, stored = _the_run(path), _steps_stored(path)
    assert end is not None
    names = [name for name, _ in stored]
    assert len(names) == len(set(names))  # none doubled
    assert all(fact in stored for fact in acknowledged)  # none lost
    return end, killed


def _list_differences(end: RunView, whole: RunView) -> list[str]:
    if end.state != "passed":
        return [f"{end.state}: {end.reason}"]
    found, expected = comparable_result(end.result), comparable_result(whole.result)
    return [f"{key} is {found[key]}, not {expected[key]}" for key in expected if found[key] != expected[key]]


def test_kills_lose_nothing_and_end_in_the_same_result() -> None:
    kills = int(os.environ.get("CELLCAL_KILLS", KILLS))
    assert kill_and_resume(kills, seed=1) == []
