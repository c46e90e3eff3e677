"""What the cell process starts by itself after a loss, over real drivers and sockets: only what the cell file allows."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.record.healthy_counts import LastHealthyCounts
from cellcal.service.record.journal_files import open_journal
from cellcal.service.watching.automatic_operator import CELL_FILE
from cellcal.service.watching.loss_response import WATCH
from tests.service.cell_process_session import (
    RECORD,
    ScreenSession,
    a_cell,
    confirm_until_end,
    run_outcome,
    take_the_record,
)

ALONE = "recover_alone = true\ncell_closed = true\n"
VOUCHED = f"{ALONE}records_complete = true\nwire_stays_hooked = true\n"


@asynccontextmanager
async def watching_cell_process(
    folder: Path, watch: str, *, record: bool = False
) -> AsyncIterator[ScreenSession]:
    """Yield a session with a cell whose [watch] table says more, once it has read the robot healthy."""
    async with a_cell(folder, time_factor=1000.0) as (path, fake_client):
        text = path.read_text(encoding="utf-8").replace("[watch]\n", f"[watch]\n{watch}")
        path.write_text(text, encoding="utf-8")
        person = ScreenSession(path, fake_client)
        attending = asyncio.create_task(person.cell_process.stay_connected())
        try:
            await person.wait_until(lambda session: session["connection"]["connected"])
            if record:
                await take_the_record(person)
            await wait_for_healthy_look(person)
            yield person
        finally:
            attending.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await attending


async def wait_for_healthy_look(person: ScreenSession) -> None:
    """Wait until the cell process has polled the robot, also since the run before: it polls five times a second."""
    memory = LastHealthyCounts(read_cell_file(person.cell_file).cell.data_dir)
    await person.wait_until(lambda _: memory.load_counts("fanuc"))
    watches = person.cell_process._watch.watches
    await person.wait_until(
        lambda _: (seen := watches.existing_watch("fanuc")) is not None and not seen._after_run
    )


def actors_and_answers(folder: Path, run_id: str) -> tuple[set[str], dict[str, str]]:
    """Return who acted in a run, and who answered its questions, by step."""
    with open_journal(read_cell_file(folder / "cell.toml")) as journal:
        events = journal.list_events(run_id)
    bodies = [json.loads(event.body) for event in events]
    values = [(body.get("step", ""), body.get("value")) for body in bodies]
    answers = {step: value["who"] for step, value in values if isinstance(value, dict) and "who" in value}
    return {event.actor for event in events}, answers


async def test_a_closed_cell_recovers_its_memory_up_to_the_write_and_a_person_writes(tmp_path: Path) -> None:
    async with watching_cell_process(tmp_path, VOUCHED, record=True) as person:
        await person.fake_client.inject_fault("memory_loss")
        run = await person.wait_until(lambda session: session["run"])
        assert (run["procedure"], run["who"], run["hold_to_move"]) == ("mastering_recovery", WATCH, False)
        prompt = await person.wait_until(lambda session: session["prompt"])
        assert prompt["key"] == "accept_mastering"  # moved and measured alone; the write waits
        assert person.session["losses"][0]["reasons"] == []
        assert await confirm_until_end(person) == ["accept_mastering"]
        run = await run_outcome(person)
        assert run["outcome"]["verdict"] == "passed"
        await person.wait_until(lambda session: not session["losses"])
        actors, answers = actors_and_answers(tmp_path, run["id"])
        assert WATCH in actors
        write_answers = {
            step: who for step, who in answers.items() if step.startswith("accept") or "counts" in step
        }
        assert write_answers.pop("accept the correction") == "Anna"
        assert set(write_answers.values()) == {CELL_FILE}
        assert len(write_answers) == 2  # newest counts, one plan


async def test_after_a_manual_step_every_question_goes_to_a_person(tmp_path: Path) -> None:
    async with watching_cell_process(tmp_path, VOUCHED, record=True) as person:
        await person.fake_client.inject_fault("battery_loss", axes="all")
        assert (await person.wait_until(lambda session: session["run"]))["who"] == WATCH
        question_keys = await confirm_until_end(person)
        assert question_keys[0] == "new_battery"
        assert {"power_cycle", "may_move", "accept_plan", "accept_mastering"} < {*question_keys}
        assert (await run_outcome(person))["outcome"]["verdict"] == "passed"
        await person.wait_until(lambda session: not session["losses"])


async def test_unconfirmed_facts_are_asked_first_and_nothing_moves_before(tmp_path: Path) -> None:
    async with watching_cell_process(tmp_path, ALONE, record=True) as person:
        await person.fake_client.inject_fault("memory_loss")
        prompt = await person.wait_until(lambda session: session["prompt"])
        assert (person.session["run"]["who"], prompt["key"]) == (WATCH, "saved_counts")
        stood = await person.read_joints()
        await person.answer_question("saved_counts")
        await person.answer_question("wire_is_hooked")
        await person.wait_until(lambda session: (session["prompt"] or {}).get("key") == "accept_plan")
        assert await person.read_joints() == stood
        await person.send_order({"op": "stop"})
        await run_outcome(person)
        await person.send_order({"op": "dismiss"})
        await person.wait_for_live_values(
            5
        )  # the loss is looked at again and again, and nothing is begun a second time
        assert person.session["run"] is None
        assert person.session["losses"]


@pytest.mark.parametrize(
    ("watch", "faults", "reason"),
    [
        ("", [("memory_loss", {})], "[watch] recover_alone is not set"),
        ("recover_alone = true\n", [("memory_loss", {})], "[watch] cell_closed is not confirmed"),
        (VOUCHED, [("alarm", {"code": "SRVO-068", "axis": "J3"})], "M2 needs a person's judgement"),
        (
            VOUCHED,
            [("alarm", {"code": "MOTN-017", "axis": "J3"}), ("memory_loss", {})],
            "the alarm MOTN-017 is unknown here",
        ),
    ],
)
async def test_it_is_offered_and_not_started_where_the_cell_file_does_not_allow_it(
    tmp_path: Path, watch: str, faults: list[tuple[str, dict[str, Any]]], reason: str
) -> None:
    async with watching_cell_process(tmp_path, watch) as person:
        for fault, arguments in faults:
            await person.fake_client.inject_fault(fault, device="fanuc", **arguments)
        (loss,) = await person.wait_until(lambda session: session["losses"])
        assert reason in loss["reasons"]
        assert loss["procedure"]
        await person.wait_for_live_values(15)
        assert person.session["run"] is None


async def test_the_robot_is_looked_at_as_soon_as_a_run_has_let_it_go(tmp_path: Path) -> None:
    """Not a period later: a screen would show what the run has mended, or nothing of what went wrong in it."""
    async with watching_cell_process(tmp_path, "") as person:
        await person.send_order(RECORD | {"hold_to_move": False})
        await person.wait_until(lambda session: (session["prompt"] or {}).get("key") == "wire_is_hooked")
        object.__setattr__(person.cell_process._watch._config.watch, "period_s", 3600.0)
        await person.wait_for_live_values(10)
        await person.fake_client.inject_fault("memory_loss")
        await person.send_order({"op": "stop"})
        await person.wait_until(lambda session: session["losses"])


async def test_a_loss_during_a_run_starts_no_automatic_recovery(tmp_path: Path) -> None:
    async with watching_cell_process(tmp_path, VOUCHED) as person:
        await person.send_order(RECORD | {"hold_to_move": False})
        await person.wait_until(lambda session: (session["prompt"] or {}).get("key") == "wire_is_hooked")
        await person.fake_client.inject_fault("memory_loss")
        await person.wait_for_live_values(15)
        assert person.session["run"]["who"] == "Anna"
        assert not person.session["losses"]  # the run has the robot
        await person.send_order({"op": "stop"})
        (loss,) = await person.wait_until(lambda session: session["losses"])
        assert "a run had the robot when it was lost: who works there has to judge" in loss["reasons"]
        await person.send_order({"op": "dismiss"})
        await person.wait_for_live_values(15)
        assert person.session["run"] is None
