"""``cellcal watch`` on a fake cell: it says what it watches, sees the loss by itself, and offers the recovery."""

import asyncio
import os
import sys
from pathlib import Path

from cellcal.drivers.operator.scripted import ScriptedOperator
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import free_address, running_fakes, write_cell_file
from cellcal.service.record.healthy_counts import HealthyCounts, LastHealthyCounts
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.launch import RunTarget, start_run
from cellcal.service.watching.loss_response import WATCH
from tests.machine_speed import stretched_s

PATIENCE_S = stretched_s(120.0)


async def until_said(process: asyncio.subprocess.Process, words: str, heard: list[str]) -> None:
    assert process.stderr is not None
    async with asyncio.timeout(PATIENCE_S):
        while words not in " ".join(" ".join(heard).split()):
            line = await process.stderr.readline()
            assert line, f"it ended without saying {words!r}: {heard}"
            heard.append(line.decode())


async def first_seen(memory: LastHealthyCounts) -> HealthyCounts:
    async with asyncio.timeout(PATIENCE_S):
        seen = memory.load_counts("fanuc")
        while seen is None:
            await asyncio.sleep(0.05)
            seen = memory.load_counts("fanuc")
        return seen


async def test_a_loss_is_seen_and_the_recovery_is_offered(tmp_path: Path) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=8, time_factor=500.0)
    memory = LastHealthyCounts(read_cell_file(path).cell.data_dir)
    async with running_fakes(path) as door:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "cellcal", "watch", str(path),
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env=os.environ | {"COLUMNS": "200"},
        )  # fmt: skip
        try:
            heard: list[str] = []
            await until_said(process, "fanuc: watched", heard)
            healthy = await first_seen(memory)
            truth = (await door.read_truth())["robots"]["fanuc"]
            assert list(healthy.counts) == truth["counts_read"]
            await door.inject_fault("battery_low")
            await until_said(process, "Exchange it with the controller switched ON", heard)
            await door.inject_fault("battery_loss", axes="all")
            await until_said(process, "lost its position", heard)
            await until_said(process, "Most likely M1", heard)
            await until_said(process, "recover_alone is not set", heard)
            await until_said(process, "cellcal run mastering_recovery", heard)
            assert (
                memory.load_counts("fanuc") == healthy
            )  # what was healthy is not overwritten by what was lost
        finally:
            process.terminate()
            await process.communicate()


async def test_a_recovery_that_starts_alone_ends_at_the_first_question_where_nobody_is(
    tmp_path: Path,
) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=8, time_factor=1000.0)
    allowed = "recover_alone = true\ncell_closed = true\nrecords_complete = true\nwire_stays_hooked = true\n"
    path.write_text(path.read_text().replace("[watch]\n", f"[watch]\n{allowed}"))
    config = read_cell_file(path)
    async with running_fakes(path) as door:
        hands = ScriptedOperator({"wire_is_hooked": "yes", "accept_plan": "yes"})
        record = await start_run(RunTarget(config, hands, "fanuc"), "mastering_record", {})
        assert record.verdict is RunVerdict.PASSED
        (config.cell.data_dir / "last_healthy_fanuc.json").unlink(
            missing_ok=True
        )  # so that its look can be seen
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "cellcal", "watch", str(path), stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env=os.environ | {"COLUMNS": "200"},
        )  # fmt: skip
        try:
            heard: list[str] = []
            await until_said(process, "fanuc: watched", heard)
            await first_seen(LastHealthyCounts(config.cell.data_dir))
            await door.inject_fault("memory_loss")
            await until_said(process, "The cell file allows it", heard)
            await until_said(process, "nobody is at this terminal", heard)
            await until_said(process, "Write the mastering data to the controller?", heard)
            await until_said(process, "cellcal resume", heard)
            await door.inject_fault("protective_stop", device="ur")  # and it goes on watching
            await until_said(process, "ur: protective stop", heard)
        finally:
            process.terminate()
            await process.communicate()
    with open_journal(config) as journal:
        store = RunStore(journal)
        run = store.find_run(store.resolve_run_id("last"))
        assert {event.actor for event in journal.list_events(run.run_id)} == {WATCH}
    assert (run.procedure, run.state) == ("mastering_recovery", RunVerdict.CELL_FAILED)
    last = run.past.findings[-1].step
    assert last == "compare with drawn poses"  # it moved and measured; nothing was written


async def test_of_a_robot_without_counts_its_stops_are_told_and_what_is_not_seen_is_said(
    tmp_path: Path,
) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=8, time_factor=500.0)
    async with running_fakes(path) as door:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "cellcal", "watch", str(path),
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env=os.environ | {"COLUMNS": "200"},
        )  # fmt: skip
        try:
            heard: list[str] = []
            await until_said(process, "ur: watched every 0.2 s: its stops and faults only", heard)
            await until_said(process, "a lost position is NOT seen", heard)
            await door.inject_fault("protective_stop", device="ur")
            await until_said(process, "ur: protective stop. Find out what the arm met", heard)
            await door.inject_fault("unlock_protective_stop", device="ur")
            await until_said(process, "ur: neither stopped nor out of reach any more", heard)
        finally:
            process.terminate()
            await process.communicate()
