"""A journal whose end was cut off is told by every command and the screen; nothing goes on without a person."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from cellcal.service.certificates.certificate import issue_certificate
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.exit_codes import ExitCode
from cellcal.service.record.journal_files import journal_path
from tests.procedures.cells import touching
from tests.procedures.certified import cell_config, run_in
from tests.service.desks import RECORD, at_desk, take_the_record


async def cut(folder: Path) -> tuple[CellConfig, str]:
    """Return a cell whose journal lost its last event after a certificate was issued."""
    config = cell_config(folder)
    outcome = await run_in(config, touching(), "six_point_tcp")
    issue_certificate(config, outcome.run_id)
    cut_off(journal_path(config))
    return config, outcome.run_id


def cut_off(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("DELETE FROM event WHERE seq = (SELECT max(seq) FROM event)")


async def test_show_and_backup_tell_it_as_runs_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, run_id = await cut(tmp_path)
    cell = str(config.path)
    for words in (["runs", "--cell", cell], ["show", run_id, "--cell", cell]):
        assert run_command_line(words) == ExitCode.SIGNATURE, words
        assert "end of the journal is missing" in " ".join(capsys.readouterr().err.split())
    kept = tmp_path / "kept"
    kept.mkdir()
    assert run_command_line(["backup", cell, "--to", str(kept)]) != ExitCode.PASS
    assert "end of the journal is missing" in " ".join(capsys.readouterr().err.split())
    assert not list(kept.iterdir())
    assert run_command_line(["backup", cell, "--to", str(kept), "--accept-missing-end"]) == ExitCode.PASS
    assert list(kept.iterdir())


async def test_at_the_desk_nothing_begins_until_a_person_has_accepted_it(tmp_path: Path) -> None:
    async with at_desk(tmp_path) as person:
        await take_the_record(person)
        cut_off(journal_path(person.desk._config))
        refused = await person.order(RECORD)
        assert (refused["ok"], refused["code"]) == (False, "store.end_missing")
        assert person.session["run"] is None
        assert (await person.order(RECORD | {"accept_missing_end": True}))["ok"]
        await person.until(lambda session: session["prompt"])
        await person.order({"op": "stop"})
