"""What is remembered after a run: the counts that it left healthy, and never later ones."""

import logging
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from cellcal.procedures.run import DeclinedError
from cellcal.procedures.run_history import EventKind
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.record.healthy_counts import LastHealthyCounts
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.runs.launch import resume_run_on, start_run_on
from cellcal.service.runs.run_procedure import RunConditions
from cellcal.service.runs.stale_run import agree_if_old
from tests.procedures.procedure_scenes import LOST, recording_scene


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    return read_cell_file(write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=60.0))


async def test_resuming_a_run_that_has_passed_forgets_nothing_after_a_loss(config: CellConfig) -> None:
    made, memory = recording_scene(), LastHealthyCounts(config.cell.data_dir)
    first = await start_run_on(config, made.cell, "mastering_record", made.spec, RunConditions())
    healthy = memory.load_counts(made.arm.name)
    assert healthy is not None
    assert healthy.counts == await made.arm.encoder_counts()
    made.arm.lose_encoders(LOST)
    made.arm.battery_flat, made.arm.unestablished = False, set()  # and nothing tells of it any more

    again = await resume_run_on(config, made.cell, "last", RunConditions())

    assert (again.run_id, again.verdict) == (first.run_id, RunVerdict.PASSED)
    assert await made.arm.encoder_counts() != healthy.counts
    assert memory.load_counts(made.arm.name) == healthy


async def test_a_disk_that_takes_nothing_takes_nothing_from_a_run_that_has_passed(
    config: CellConfig, caplog: pytest.LogCaptureFixture
) -> None:
    made = recording_scene()
    config.cell.data_dir.mkdir(parents=True, exist_ok=True)
    (config.cell.data_dir / f"last_healthy_{made.arm.name}.json").mkdir()  # no file can take its place
    with caplog.at_level(logging.WARNING):
        outcome = await start_run_on(config, made.cell, "mastering_record", made.spec, RunConditions())
    assert outcome.verdict is RunVerdict.PASSED
    assert "were not kept as healthy" in caplog.text


@pytest.mark.parametrize(
    ("hours", "expected_question"),
    [(0.1, ""), (7.9, ""), (9.0, "stood still for 9.0 hours"), (-2.0, "stands 2.0 hours before")],
)
async def test_a_run_that_stood_still_for_a_shift_goes_on_only_if_a_person_agrees(
    config: CellConfig, hours: float, expected_question: str
) -> None:
    made = recording_scene()
    with open_journal(config) as journal:
        event = journal.append(
            "run-1",
            EventKind.STARTED,
            {"procedure": "mastering_record", "version": 1, "spec": {}, "cell": {}},
        )
        now = datetime.fromisoformat(event.wall_utc) + timedelta(hours=hours)
        await agree_if_old(made.technician, journal, "run-1", now_utc=now)
        assert made.technician.instructions == (["run_is_old"] if expected_question else [])
        assert expected_question in made.technician.read.get("run_is_old", "")
        made.technician.refuses = {"run_is_old"}
        if expected_question:
            with pytest.raises(DeclinedError, match="was not continued"):
                await agree_if_old(made.technician, journal, "run-1", now_utc=now)
