"""A journal whose end was cut off is told by every command and the screen; nothing goes on without a person."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from playwright.async_api import Page, expect

from cellcal.calibration.documents.json_text import parse_json
from cellcal.procedures.run_history import EventKind
from cellcal.service.certificates.certificate import issue_certificate
from cellcal.service.certificates.sign_offs import list_sign_offs
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.exit_codes import ExitCode
from cellcal.service.record.journal_files import journal_path, open_journal
from tests.procedures.certified_runs import cell_config, run_in
from tests.procedures.procedure_scenes import tool_touch_scene
from tests.service.browser_pages import hold_to_rules, some_of
from tests.service.cell_process_session import RECORD, open_session, take_the_record
from tests.service.step_page_actions import FakePendant, at_the_pages


async def cut_journal_end(folder: Path) -> tuple[CellConfig, str]:
    """Return a cell whose journal lost its last event after a certificate was issued."""
    config = cell_config(folder)
    outcome = await run_in(config, tool_touch_scene(), "six_point_tcp")
    issue_certificate(config, outcome.run_id)
    cut_off(journal_path(config))
    return config, outcome.run_id


def cut_off(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("DELETE FROM event WHERE seq = (SELECT max(seq) FROM event)")


# the dialog's title, what is missing, what to do
SENTENCES = {
    "en": ("The end of the journal is missing.", "was issued after an event", "Restore a backup"),
    "de": ("Das Ende des Journals fehlt.", "ausgestellt", "Sicherung"),
    "es": ("Falta el final del diario.", "emitió", "copia"),
    "zh": ("日志的末尾缺失。", "签发", "备份"),
}


async def test_show_and_backup_tell_it_as_runs_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, run_id = await cut_journal_end(tmp_path)
    cell = str(config.path)
    for words in (["runs", "--cell", cell], ["show", run_id, "--cell", cell]):
        assert run_command_line(words) == ExitCode.SIGNATURE, words
        assert "end of the journal is missing" in " ".join(capsys.readouterr().err.split())
    backup_folder = tmp_path / "kept"
    backup_folder.mkdir()
    assert run_command_line(["backup", cell, "--to", str(backup_folder)]) != ExitCode.PASS
    assert "end of the journal is missing" in " ".join(capsys.readouterr().err.split())
    assert not list(backup_folder.iterdir())
    assert (
        run_command_line(["backup", cell, "--to", str(backup_folder), "--accept-missing-end"])
        == ExitCode.PASS
    )
    assert list(backup_folder.iterdir())


async def test_no_run_begins_until_a_person_has_accepted_the_missing_end(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        await take_the_record(person)
        cut_off(journal_path(person.cell_process._config))
        refused = await person.send_order(RECORD)
        assert (refused["ok"], refused["code"]) == (False, "store.end_missing")
        assert person.session["run"] is None
        assert (await person.send_order(RECORD | {"accept_missing_end": True}))["ok"]
        await person.wait_until(lambda session: session["prompt"])
        await person.send_order({"op": "stop"})
        assert "end of the journal is missing" in person.session["journal_end"]
        run_id = person.session["run"]["id"]
        accepted = accepted_in(person.cell_process._config, run_id)
        assert [who for who, _ in accepted] == ["Anna"]
        assert ".json was issued after an event that it does not have" in accepted[0][1]
        with open_journal(person.cell_process._config) as journal:
            sign_offs = [
                one for one in list_sign_offs(journal.list_events(run_id)) if one["did"] == "accepted"
            ]
        assert "end of the journal is missing" in sign_offs[0]["what"]
        assert sign_offs[0]["at_utc"]


def accepted_in(config: CellConfig, run_id: str) -> list[tuple[str, str]]:
    """Return who accepted in a run's journal that its end is missing, and what was missing."""
    with open_journal(config) as journal:
        events = [event for event in journal.list_events(run_id) if event.kind == EventKind.MISSING_END]
    return [(event.actor, parse_json(event.body)["missing"]) for event in events]


async def test_going_on_with_a_run_is_accepted_in_its_journal_too(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        config = person.cell_process._config
        await person.send_order(RECORD)
        await person.wait_until(lambda session: session["prompt"])
        run_id = person.session["run"]["id"]
        await person.send_order({"op": "stop"})
        await person.send_order({"op": "dismiss"})
        await take_the_record(person)
        cut_off(journal_path(config))
        refused = await person.send_order({"op": "resume", "run_id": run_id})
        assert refused["code"] == "store.end_missing"
        assert accepted_in(config, run_id) == []
        resume = {"op": "resume", "run_id": run_id, "accept_missing_end": True}
        assert (await person.send_order(resume))["ok"]
        await person.wait_until(lambda _: accepted_in(config, run_id))
        await person.send_order({"op": "stop"})


async def test_on_the_page_a_dialog_says_it_and_only_its_yes_goes_on(tmp_path: Path) -> None:
    async with at_the_pages(tmp_path) as pendant:
        config = read_cell_file(pendant._app.state.context.settings.cell_file)
        await _record_by(pendant)
        cut_off(journal_path(config))
        for locale, sentence in some_of(list(SENTENCES.items()), "a missing end"):
            async with pendant.viewer.open_page("#/procedure/mastering_record", locale=locale) as page:
                await page.get_by_test_id("start").click()
                dialog = page.get_by_test_id("dialog")
                for words in sentence:
                    await expect(dialog).to_contain_text(words)
                await expect(dialog.locator("[lang=en]")).to_have_count(0)
                await hold_to_rules(page, "the dialog of a missing end")
                await page.get_by_test_id("dialog-close").click()
                await expect(dialog).to_have_count(0)
                assert (await pendant.viewer.read_session())["run"] is None
                if locale == "zh":
                    await _go_on_all_the_same(pendant, page, config)
                refused = [line for line in pendant.viewer.complaints if "409" in line]
                assert refused  # the browser's own words for a refusal
                pendant.viewer.complaints.clear()
            pendant.release_control()


async def _go_on_all_the_same(pendant: FakePendant, page: Page, config: CellConfig) -> None:
    await page.get_by_test_id("start").click()
    await page.get_by_test_id("accept-missing-end").click()
    session = await pendant.viewer.wait_until(lambda session: session["prompt"])
    await expect(page.get_by_test_id("dialog")).to_have_count(0)
    assert len(accepted_in(config, session["run"]["id"])) == 1
    await page.get_by_test_id("stop").click()
    await pendant.viewer.wait_until(lambda session: session["run"]["outcome"])


async def _record_by(pendant: FakePendant) -> None:
    """Take a record, whose certificate then knows an event that will be missing."""
    await pendant.viewer.wait_until(lambda session: session["connection"]["connected"])
    await pendant.viewer.send_order(**(RECORD | {"hold_to_move": False}))
    for key in ("wire_is_hooked", "accept_plan"):
        session = await pendant.viewer.wait_until(
            lambda session, key=key: (session["prompt"] or {}).get("key") == key
        )
        await pendant.viewer.send_order(op="answer", prompt_id=session["prompt"]["id"], value="yes")
    await pendant.viewer.wait_until(lambda session: session["run"]["outcome"])
    await pendant.viewer.send_order(op="dismiss")
