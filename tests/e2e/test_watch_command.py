"""``cellcal watch`` on a fake cell: it says what it watches, sees the loss by itself, and offers the recovery."""

import asyncio
import json
import os
import sys
from pathlib import Path

import pytest

from cellcal.drivers.operator.scripted import ScriptedOperator
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import free_address, running_fakes, write_cell_file
from cellcal.service.exit_codes import ExitCode
from cellcal.service.record.healthy_counts import HealthyCounts, LastHealthyCounts
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.launch import RunTarget, start_run
from cellcal.service.watching.loss_response import WATCH
from tests.machine_speed import stretched_s

PATIENCE_S = stretched_s(120.0)


async def wait_for_output(process: asyncio.subprocess.Process, words: str, received_lines: list[str]) -> None:
    assert process.stderr is not None
    async with asyncio.timeout(PATIENCE_S):
        while words not in " ".join(" ".join(received_lines).split()):
            line = await process.stderr.readline()
            assert line, f"it ended without saying {words!r}: {received_lines}"
            received_lines.append(line.decode())


async def first_stored_counts(memory: LastHealthyCounts) -> HealthyCounts:
    async with asyncio.timeout(PATIENCE_S):
        healthy_counts = memory.load_counts("fanuc")
        while healthy_counts is None:
            await asyncio.sleep(0.05)
            healthy_counts = memory.load_counts("fanuc")
        return healthy_counts


async def test_a_loss_is_seen_and_the_recovery_is_offered(tmp_path: Path) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=8, time_factor=500.0)
    memory = LastHealthyCounts(read_cell_file(path).cell.data_dir)
    async with running_fakes(path) as fake_client:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "cellcal", "watch", str(path),
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env=os.environ | {"COLUMNS": "200"},
        )  # fmt: skip
        try:
            received_lines: list[str] = []
            await wait_for_output(process, "fanuc: watched", received_lines)
            healthy = await first_stored_counts(memory)
            truth = (await fake_client.read_truth())["robots"]["fanuc"]
            assert list(healthy.counts) == truth["counts_read"]
            await fake_client.inject_fault("battery_low")
            await wait_for_output(process, "Exchange it with the controller switched ON", received_lines)
            await fake_client.inject_fault("battery_loss", axes="all")
            await wait_for_output(process, "lost its position", received_lines)
            await wait_for_output(process, "Most likely M1", received_lines)
            await wait_for_output(process, "recover_alone is not set", received_lines)
            await wait_for_output(process, "cellcal run mastering_recovery", received_lines)
            assert (
                memory.load_counts("fanuc") == healthy
            )  # what was healthy is not overwritten by what was lost
        finally:
            process.terminate()
            await process.communicate()


async def test_an_automatic_recovery_ends_at_the_first_question_without_a_technician(
    tmp_path: Path,
) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=8, time_factor=1000.0)
    allowed = "recover_alone = true\ncell_closed = true\nrecords_complete = true\nwire_stays_hooked = true\n"
    path.write_text(path.read_text().replace("[watch]\n", f"[watch]\n{allowed}"))
    config = read_cell_file(path)
    async with running_fakes(path) as fake_client:
        operator = ScriptedOperator({"wire_is_hooked": "yes", "accept_plan": "yes"})
        record = await start_run(RunTarget(config, operator, "fanuc"), "mastering_record", {})
        assert record.verdict is RunVerdict.PASSED
        (config.cell.data_dir / "last_healthy_fanuc.json").unlink(
            missing_ok=True
        )  # so that its look can be seen
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "cellcal", "watch", str(path), stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env=os.environ | {"COLUMNS": "200"},
        )  # fmt: skip
        try:
            received_lines: list[str] = []
            await wait_for_output(process, "fanuc: watched", received_lines)
            await first_stored_counts(LastHealthyCounts(config.cell.data_dir))
            await fake_client.inject_fault("memory_loss")
            await wait_for_output(process, "The cell file allows it", received_lines)
            await wait_for_output(process, "there is none at this terminal", received_lines)
            await wait_for_output(process, "Write the mastering data to the controller?", received_lines)
            await wait_for_output(process, "cellcal resume", received_lines)
            await fake_client.inject_fault("protective_stop", device="ur")  # and it goes on watching
            await wait_for_output(process, "ur: protective stop", received_lines)
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


async def test_without_encoder_counts_stops_are_reported_and_the_missing_checks_are_named(
    tmp_path: Path,
) -> None:
    with free_address() as address:
        path = write_cell_file(tmp_path, address, seed=8, time_factor=500.0)
    async with running_fakes(path) as fake_client:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "cellcal", "watch", str(path),
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env=os.environ | {"COLUMNS": "200"},
        )  # fmt: skip
        try:
            received_lines: list[str] = []
            await wait_for_output(
                process, "ur: watched every 0.2 s: its stops and faults only", received_lines
            )
            await wait_for_output(process, "a lost position is NOT seen", received_lines)
            await fake_client.inject_fault("protective_stop", device="ur")
            await wait_for_output(process, "ur: protective stop. Find out what the arm met", received_lines)
            await fake_client.inject_fault("unlock_protective_stop", device="ur")
            await wait_for_output(process, "ur: neither stopped nor out of reach any more", received_lines)
        finally:
            process.terminate()
            await process.communicate()


async def test_one_look_compares_and_is_one_document(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with free_address() as address:
        cell = write_cell_file(tmp_path, address, seed=3, time_factor=50.0)
    once = ["watch", str(cell), "--once", "--json"]
    assert await asyncio.to_thread(run_command_line, once) == ExitCode.UNREACHABLE
    states = {each["robot"]: each["state"] for each in json.loads(capsys.readouterr().out)["robots"]}
    assert states == {"fanuc": "not read", "ur": "not read"}
    async with running_fakes(cell):
        for code in (ExitCode.REFUSED, ExitCode.REFUSED):  # the FANUC has no record yet
            assert await asyncio.to_thread(run_command_line, once) == code
        printed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {each["robot"]: each["state"] for each in printed["robots"]} == {
        "fanuc": "not compared",
        "ur": "unchanged",
    }


@pytest.mark.parametrize("option", [["--accept", "fanuc"], ["--json"]])
def test_what_belongs_to_one_look_is_not_ignored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: list[str]
) -> None:
    with free_address() as address:
        cell = write_cell_file(tmp_path, address, seed=3, time_factor=50.0)
    assert run_command_line(["watch", str(cell), *option]) != 0
    assert "Give --once" in capsys.readouterr().err
