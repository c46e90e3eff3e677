"""kill -9 of the very command a technician runs, over real sockets; `cellcal resume` brings the robot home."""

import asyncio
import json
import random
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import free_address, running_fakes, write_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.record.journal import Journal
from cellcal.service.record.run_store import RunStore

KEYS = (
    "saved_counts",
    "wire_is_hooked",
    "accept_plan",
    "accept_mastering",
    "may_move",
    "retry",
    "new_battery",
    "power_cycle",
)
KILLED_AT = ((4, 12), (20, 30))  # between so many findings of about sixty


async def run_cellcal(*words: str, until: Callable[[], bool] = lambda: False) -> tuple[int, str, str]:
    """Run a command to its end, or kill it once ``until`` holds."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "cellcal",
        *words,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    talk = asyncio.create_task(process.communicate())
    while not (await asyncio.wait({talk}, timeout=0.05))[0]:
        if until():
            process.kill()
            break
    out, err = await talk
    assert process.returncode is not None
    return process.returncode, out.decode(), err.decode()


async def answer_questions(fake_client: FakeCellClient, path: Path) -> None:
    """Be the hands at the cabinet: exchange the battery at once, turn the switch when the alarms ask for it."""
    await fake_client.inject_fault("new_battery")
    while "power cycle 1" not in [step for step, _ in findings_of(path)]:
        await asyncio.sleep(0.2)
    await fake_client.inject_fault("power_cycle")


def findings_of(path: Path) -> list[Any]:
    """Return what the journal holds of the recovery."""
    with Journal.open_file(read_cell_file(path).cell.data_dir / "journal.db") as journal:
        assert journal.verify_chain() is None
        newest = RunStore(journal).list_runs()[-1]
    if newest.procedure != "mastering_recovery":
        return []
    return [(finding.step, finding.value) for finding in newest.past.findings]


async def test_a_killed_recovery_is_resumed_to_the_exact_turns(tmp_path: Path) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=5, time_factor=1000.0)
    answers = tmp_path / "answers.json"
    answers.write_text(json.dumps(dict.fromkeys(KEYS, "yes")))
    common = ("--cell", str(path), "--answers", str(answers), "--json")
    rng = random.Random(4)
    async with running_fakes(path) as fake_client:
        code, _, errors = await run_cellcal("run", "mastering_record", *common)
        assert code == 0, errors
        await fake_client.inject_fault("battery_loss", axes="all")
        hands = asyncio.create_task(answer_questions(fake_client, path))
        words: tuple[str, ...] = ("run", "mastering_recovery")
        before: list[Any] = []
        for least, most in KILLED_AT:
            enough = rng.randint(least, most)
            code, _, errors = await run_cellcal(
                *words, *common, until=lambda n=enough: len(findings_of(path)) >= n
            )
            assert code == -9, errors
            after = findings_of(path)
            assert after[: len(before)] == before  # nothing acknowledged is lost or changed
            before, words = after, ("resume", "last")
        code, out, errors = await run_cellcal("resume", "last", *common)
        await hands
        assert code == 0, errors
        assert json.loads(out)["result"]["mode"] == "turns"
        steps = [step for step, _ in findings_of(path)]
        assert len(steps) == len(set(steps))  # none doubled
        truth = (await fake_client.read_truth())["robots"]["fanuc"]
        assert truth["counts_at_zero"] == truth["true_counts_at_zero"]
        error = await fake_client.send_command("tcp_error", robot="fanuc")
        assert error["max"] < 1e-9
