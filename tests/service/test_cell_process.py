"""The cell process: one run for any number of screens, over real drivers and sockets."""

import asyncio
import time
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from cellcal.drivers.wire.cancellation import cancel_until_done
from cellcal.procedures.cell import Cell
from cellcal.service.cell_process.loss_watch import LossWatch
from cellcal.service.cell_process.run_in_progress import RunInProgress
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.record.healthy_counts import LastHealthyCounts
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import RunStore
from tests.service.cell_process_session import (
    COMMAND,
    RECORD,
    ScreenSession,
    a_cell,
    open_session,
    open_session_of,
    run_outcome,
    take_the_record,
    without_a_wire_to_the_gauge,
)


async def test_an_order_is_obeyed_once_and_only_for_what_its_sender_saw(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        seen_revision = person.cell_process.rev
        first = await person.send_order(RECORD, rev=seen_revision, press="one press")
        again = await person.send_order(RECORD, rev=seen_revision, press="one press")
        late = await person.send_order(RECORD, rev=seen_revision, press="another tablet")
        assert first["ok"]
        assert again == first
        assert (late["ok"], late["code"]) == (False, "desk.stale")
        assert late["session"]["run"]["procedure"] == "mastering_record"
        prompt = await person.wait_until(lambda session: session["prompt"])
        await person.answer_question(prompt["key"])
        doubled = await person.send_order({"op": "answer", "prompt_id": prompt["id"]})
        assert (doubled["ok"], doubled["code"]) == (False, "desk.stale")
        await person.send_order({"op": "stop"})


async def test_an_answer_that_comes_twice_at_once_is_one_answer(tmp_path: Path) -> None:
    """After a lost link the late press and its repetition arrive together."""
    async with open_session(tmp_path) as person:
        await person.send_order(RECORD)
        prompt = await person.wait_until(lambda session: session["prompt"])
        envelope = {"id": "one press", "rev": person.cell_process.rev, "who": "Anna"}
        envelope |= {"people": [{"name": "Anna", "role": "technician"}]}
        envelope |= {"order": {"op": "answer", "prompt_id": prompt["id"]}}
        both = await asyncio.gather(
            *(person.cell_process.execute_command(COMMAND.validate_python(envelope)) for _ in range(2))
        )
        assert [reply["ok"] for reply in both] == [True, True], both
        assert both[0] == both[1]
        await person.wait_until(
            lambda session: session["prompt"] is None or session["prompt"]["id"] != prompt["id"]
        )
        await person.send_order({"op": "stop"})


async def test_a_move_waits_for_the_button_and_ends_with_it(tmp_path: Path) -> None:
    async with open_session(tmp_path, time_factor=20.0) as person:
        await person.send_order(RECORD | {"hold_to_move": True})
        await person.answer_question("wire_is_hooked")
        await person.answer_question("accept_plan")
        await person.wait_until(lambda session: session["waits_for_hold"])
        stood = await person.read_joints()
        holding = asyncio.create_task(_hold_button(person))
        await person.wait_until(lambda _: person.live["devices"][0]["value"]["moving"])
        holding.cancel()  # no word of letting go: the screen just falls silent
        await person.wait_until(lambda session: session["waits_for_hold"])
        joints_after = await person.read_joints()
        await person.wait_for_live_values(5)
        assert joints_after != stood
        assert await person.read_joints() == joints_after
        await person.send_order({"op": "stop"})
        ended = await person.wait_until(lambda session: session["run"]["outcome"] and session["run"])
        assert ended["outcome"]["verdict"] == "cancelled"


async def test_a_stopped_run_is_journalled_and_goes_on_where_it_was(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        await person.send_order(RECORD | {"hold_to_move": False})
        await person.answer_question("wire_is_hooked")
        await person.answer_question("accept_plan")
        await person.wait_until(lambda session: "capture 2" in session["run"]["found"])
        await person.send_order({"op": "stop"})
        run = await person.wait_until(lambda session: session["run"]["outcome"] and session["run"])
        found = list(run["found"])
        await person.send_order({"op": "resume", "run_id": run["id"], "hold_to_move": False})
        await person.answer_question("wire_is_hooked")  # a condition: asked on every entry
        resumed = await person.wait_until(
            lambda session: (
                session["run"]["id"] == run["id"]
                and len(session["run"]["found"]) >= len(found)
                and session["run"]
            )
        )
        assert resumed["found"][: len(found)] == found
        await person.send_order({"op": "stop"})
        with open_journal(read_cell_file(tmp_path / "cell.toml")) as journal:
            steps = [finding.step for finding in RunStore(journal).find_run(run["id"]).past.findings]
        assert len(steps) == len(set(steps))


async def test_the_approved_plan_is_shown_until_the_run_has_left_it_also_after_a_restart(
    tmp_path: Path,
) -> None:
    async with open_session(tmp_path) as person:
        await person.send_order(RECORD | {"hold_to_move": False, "settings": {"poses": 12}})
        await person.answer_question("wire_is_hooked")
        plan = await person.wait_until(
            lambda session: ((session["prompt"] or {}).get("data") or {}).get("plan")
        )
        assert person.session["run"]["series"] is None
        await person.answer_question("accept_plan")
        series = await person.wait_until(lambda session: session["run"]["series"])
        assert [pose["name"] for pose in series["poses"]] == [pose["name"] for pose in plan["poses"]]
        await person.wait_until(lambda session: len(session["run"]["series"]["measured"]) >= 2)
        await person.send_order({"op": "stop"})
        run = await person.wait_until(lambda session: session["run"]["outcome"] and session["run"])
        assert run["series"] is None
        taken = sum(step.startswith("capture") for step in run["found"])
        await person.send_order({"op": "resume", "run_id": run["id"], "hold_to_move": False})
        await person.answer_question("wire_is_hooked")
        await person.wait_until(lambda session: (session["prompt"] or {}).get("key") == "may_move")
        plan_series = person.session["run"]["series"]
        assert (plan_series["measured"], plan_series["poses"]) == (list(range(taken)), series["poses"])
        await person.answer_question("may_move")
        moved = await person.wait_until(
            lambda session: session["run"]["series"]["next"] is not None and session["run"]
        )
        assert moved["series"]["next"] >= taken
        assert moved["series"]["elsewhere_rad"] is None
        outcome = await person.wait_until(lambda session: session["run"]["outcome"])
        assert (outcome["verdict"], person.session["run"]["series"]) == ("passed", None)


async def test_no_length_is_asked_for_outside_a_step_that_needs_it(tmp_path: Path) -> None:
    """A gauge that is read by a person is not looked at ten times a second, nor is a row of a file taken so."""
    async with a_cell(tmp_path) as (path, fake_client):
        without_a_wire_to_the_gauge(path)
        async with open_session_of(path, fake_client) as person:
            await person.wait_until(lambda _: person.live)
            person.live = {}
            await person.wait_until(lambda _: person.live)
            assert person.session["prompt"] is None
            gauge = next(device for device in person.live["devices"] if device["role"] == "gauge")
            assert (gauge["value"], gauge["settle"], gauge["message"]) == (None, None, "")


async def test_an_order_that_cannot_be_done_now_is_refused_with_the_reason(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        unknown = await person.send_order({"op": "start", "procedure": "mastering_recrod"})
        assert not unknown["ok"]
        assert "mastering_record" in unknown["message"] + unknown["remedy"]
        refused = await person.send_order(
            {"op": "start", "procedure": "mastering_recovery", "hold_to_move": False}
        )
        assert refused["ok"]
        outcome = await person.wait_until(lambda session: session["run"]["outcome"])
        assert outcome["verdict"] == "refused"
        assert "record" in outcome["reason"]
        unsigned = await person.send_order({"op": "sign", "run_id": "another", "lines": ["done"]})
        assert (unsigned["ok"], unsigned["code"]) == (False, "desk.refused")
        run_id = person.session["run"]["id"]
        unsigned = await person.send_order({"op": "sign", "run_id": run_id, "lines": ["done"]})
        assert "not every line" in unsigned["message"] or "cannot be signed" in unsigned["message"]
        await person.send_order({"op": "dismiss"})
        await person.send_order(RECORD)
        busy = await person.send_order({"op": "select_robot", "robot": "ur"})
        assert "under way" in busy["message"]
        await person.send_order({"op": "stop"})
        await person.send_order({"op": "dismiss"})
        await person.send_order({"op": "select_robot", "robot": "ur"})
        await person.wait_until(
            lambda session: session["robot"] == "ur" and session["connection"]["connected"]
        )


async def test_a_loss_is_seen_on_the_screen_with_its_answer(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        memory = LastHealthyCounts(read_cell_file(tmp_path / "cell.toml").cell.data_dir)
        await person.wait_until(lambda _: memory.load_counts("fanuc"))  # it has seen the robot healthy
        await person.fake_client.inject_fault("battery_loss", axes="all")
        losses = await person.wait_until(lambda session: session["losses"])
        assert (losses[0]["robot"], losses[0]["procedure"]) == ("fanuc", "mastering_recovery")
        assert losses[0]["mode"] == "M1"


async def test_after_a_restart_in_mid_run_the_loss_is_on_the_screen_and_the_run_goes_on(
    tmp_path: Path,
) -> None:
    async with a_cell(tmp_path) as (path, fake_client):
        async with open_session_of(path, fake_client) as person:
            await take_the_record(person)
            await person.fake_client.inject_fault("battery_loss", axes="all")
            (loss,) = await person.wait_until(lambda session: session["losses"])
            await person.send_order(
                {"op": "start", "procedure": loss["procedure"], "settings": loss["settings"]}
            )
            question = await person.wait_until(lambda session: session["prompt"])
        async with open_session_of(path, fake_client) as person:
            again = await person.wait_until(lambda session: session["prompt"])
            assert (again["key"], person.session["run"]["who"]) == (question["key"], "service")
            (shown,) = person.session["losses"]
            assert (shown["words"], shown["procedure"]) == (loss["words"], loss["procedure"])
            assert "a run had the robot when it was lost: who works there has to judge" in shown["reasons"]


async def test_a_run_that_a_person_declined_says_once_how_it_ended(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        await person.send_order(RECORD)
        prompt = await person.wait_until(lambda session: session["prompt"])
        await person.send_order({"op": "decline", "prompt_id": prompt["id"]})
        outcome = (await run_outcome(person))["outcome"]
        assert outcome["reason"]
        assert (outcome["certificate"], outcome["no_certificate"]) == (None, "")


async def test_a_start_while_the_robot_is_looked_at_does_not_displace_the_unfinished_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replies, person_of_look = list[dict[str, Any]](), list[ScreenSession]()
    look_before = LossWatch.look_before_resuming

    async def press_and_look(watch: LossWatch, cell: Cell, *, now_s: float) -> None:
        screen = person_of_look[0]
        replies.append(await screen.send_order({"op": "start", "procedure": "drift_check"}))
        replies.append(await screen.send_order({"op": "select_robot", "robot": "ur"}))
        await look_before(watch, cell, now_s=now_s)

    async with a_cell(tmp_path) as (path, fake_client):
        async with open_session_of(path, fake_client) as person:
            await person.send_order(RECORD)
            await person.wait_until(lambda session: session["prompt"])
            run_id = person.session["run"]["id"]
        monkeypatch.setattr(LossWatch, "look_before_resuming", press_and_look)
        person = ScreenSession(path, fake_client)
        person_of_look.append(person)
        attending = asyncio.create_task(person.cell_process.stay_connected())
        await person.wait_until(lambda session: len(replies) == 2 and session["connection"]["connected"])
        assert (replies[0]["ok"], person.session["robot"], person.session["run"]) == (False, "ur", None)
        assert "cannot be used" in replies[0]["message"]
        monkeypatch.undo()
        await person.send_order({"op": "select_robot", "robot": "fanuc"})
        await person.wait_until(lambda session: session["run"] and session["run"]["id"] == run_id)
        await cancel_until_done(attending, every_s=1.0)


async def test_after_a_restart_the_robot_of_the_run_under_way_is_selected(tmp_path: Path) -> None:
    async with a_cell(tmp_path) as (path, fake_client):
        data_dir = read_cell_file(path).cell.data_dir
        data_dir.mkdir()
        RunInProgress(data_dir).save_run("drift_check-1", "ur", hold_to_move=True)
        assert ScreenSession(path, fake_client).session["robot"] == "ur"
        RunInProgress(data_dir).save_run("drift_check-1", "sold", hold_to_move=True)
        assert ScreenSession(path, fake_client).session["robot"] == "fanuc"


@pytest.mark.parametrize(
    "order",
    [
        {"op": "move", "joints": [0, 0]},
        {"op": "start", "procedure": "mastering_record", "robot_speed": 9},
        {"op": "start", "procedure": "x" * 300},
        {"op": "answer", "prompt_id": "a", "value": "x" * 5000},
    ],
)
def test_a_malformed_order_is_refused_on_receipt(order: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        COMMAND.validate_python({"id": "1", "rev": 1, "who": "Anna", "order": order})


async def _hold_button(person: ScreenSession) -> None:
    while True:
        await person.send_order({"op": "hold", "held": True, "at_s": time.monotonic()})
        await asyncio.sleep(0.1)
