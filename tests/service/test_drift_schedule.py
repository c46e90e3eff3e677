"""A drift check becomes due so many days after the last one that ended well; it is reported, nothing moves."""

import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from cellcal.procedures.run_history import EventKind
from cellcal.service.configuration.cell_file import CellConfig, ConfigError, read_cell_file
from cellcal.service.record.drift_schedule import DriftReminder, next_drift_checks
from cellcal.service.record.journal import NewEvent
from cellcal.service.record.journal_files import journal_path, open_journal
from cellcal.service.runs.run_preview import list_procedures
from cellcal.service.site.cell_alarms import CellAlarmWatch
from cellcal.service.site.cell_state import DueDates
from cellcal.service.site.controller_tap import ControllerTap
from tests.procedures.certified_runs import cell_config, run_in
from tests.procedures.procedure_scenes import scene_for

TODAY = datetime.now(UTC).date()


def weekly_check_config(folder: Path, days: str = "7") -> CellConfig:
    """Return a cell whose file wants a check every week."""
    path = cell_config(folder).path
    path.write_text(path.read_text().replace("drift_check_days = 14", f"drift_check_days = {days}"))
    return read_cell_file(path)


def add_ended_run(
    config: CellConfig, number: int, verdict: str, serial: str = "F-1", procedure: str = "drift_check"
) -> None:
    """Put a run into the journal that began and ended now."""
    run_id = f"{procedure}-{number:012x}"
    cell = {"devices": [{"role": "robot", "identity": {"serial": serial}}]}
    events = [
        NewEvent(EventKind.STARTED, {"procedure": procedure, "cell": cell}),
        NewEvent(EventKind.ENDED, {"verdict": verdict, "reason": ""}),
    ]
    with open_journal(config) as journal:
        journal.append_all(run_id, events)


def test_a_damaged_journal_tells_of_the_checks_before_the_damage(tmp_path: Path) -> None:
    config = weekly_check_config(tmp_path)
    robot = config.robots[0]
    for number in range(2):
        add_ended_run(config, number, "passed", serial=robot.serial)
    with closing(sqlite3.connect(journal_path(config))) as database, database:
        database.execute("UPDATE event SET body = '{' WHERE seq = 3")
    assert next_drift_checks(config, TODAY)[robot.name] == TODAY + timedelta(7)
    with closing(sqlite3.connect(journal_path(config))) as database, database:
        database.execute("DELETE FROM event WHERE seq = 1")
        database.execute("UPDATE event SET body = '{' WHERE seq = 3")
    assert next_drift_checks(config, TODAY)[robot.name] == TODAY


@pytest.mark.parametrize("days_back", [1, 400, 20_000])
def test_a_check_of_a_day_to_come_does_not_put_off_the_next_for_years(tmp_path: Path, days_back: int) -> None:
    config = weekly_check_config(tmp_path)
    add_ended_run(config, 1, "passed")
    clock_set_back = TODAY - timedelta(days_back)
    assert next_drift_checks(config, clock_set_back)[config.robots[0].name] == clock_set_back


async def test_a_week_after_the_last_check_the_next_is_reported_as_due(tmp_path: Path) -> None:
    config = weekly_check_config(tmp_path)
    robot, other = (each.name for each in config.robots)
    assert next_drift_checks(config, TODAY) == {robot: TODAY, other: TODAY}  # never checked
    journal_path(config).parent.mkdir(parents=True, exist_ok=True)
    journal_path(config).touch()  # opened for the first time
    assert next_drift_checks(config, TODAY) == {robot: TODAY, other: TODAY}
    await run_in(config, await scene_for("drift_check"), "drift_check")
    due = TODAY + timedelta(7)
    assert next_drift_checks(config, TODAY) == {robot: due, other: TODAY}
    assert {row.name: row.due for row in list_procedures(config) if row.due} == {"drift_check": due}
    assert {"what": f"drift check of {robot}", "due": due.isoformat()} in DueDates(config).due_items(0.0)


def test_where_the_cell_file_says_nothing_nothing_is_due(tmp_path: Path) -> None:
    path = cell_config(tmp_path).path
    path.write_text(path.read_text().replace("drift_check_days = 14\n", ""))
    config = read_cell_file(path)
    assert next_drift_checks(config, TODAY) == {}
    assert not any(row.due for row in list_procedures(config))
    assert not any("drift" in due_item["what"] for due_item in DueDates(config).due_items(0.0))


@pytest.mark.parametrize("days", ["0", "-7", "nan", "4000", '"weekly"'])
def test_days_that_are_none_are_refused_by_name(tmp_path: Path, days: str) -> None:
    with pytest.raises(ConfigError, match="drift_check_days"):
        weekly_check_config(tmp_path, days)


def test_only_a_check_of_this_robot_that_ended_well_counts(tmp_path: Path) -> None:
    config = weekly_check_config(tmp_path)
    robot = config.robots[0].name
    add_ended_run(config, 1, "refused")
    add_ended_run(config, 2, "passed", serial="another")
    add_ended_run(config, 3, "passed", procedure="accuracy_check")
    assert next_drift_checks(config, TODAY)[robot] == TODAY
    add_ended_run(config, 4, "passed")
    add_ended_run(config, 5, "cancelled")
    assert next_drift_checks(config, TODAY)[robot] == TODAY + timedelta(7)


def test_a_reminder_looks_again_after_a_while_and_keeps_what_it_knew(tmp_path: Path) -> None:
    config = weekly_check_config(tmp_path)
    reminder = DriftReminder(config)
    first = reminder.list_due(0.0)
    add_ended_run(config, 1, "passed")
    assert reminder.list_due(DriftReminder.EVERY_S - 0.1) == first
    later = reminder.list_due(DriftReminder.EVERY_S)
    assert later != first
    journal_path(config).write_bytes(b"this is no database")
    for extra in journal_path(config).parent.glob("*-wal"):
        extra.unlink()
    assert reminder.list_due(2 * DriftReminder.EVERY_S) == later


def test_an_overdue_check_is_an_alarm_until_it_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = weekly_check_config(tmp_path)
    add_ended_run(config, 1, "passed")
    late = TODAY + timedelta(30)

    class LaterClock(datetime):
        @classmethod
        def now(cls, tz: object = None) -> "LaterClock":  # type: ignore[override]
            return cls(late.year, late.month, late.day, tzinfo=UTC)

    monkeypatch.setattr("cellcal.service.site.cell_alarms.datetime", LaterClock)
    troubles = CellAlarmWatch(config, ControllerTap(None), DueDates(config))
    of_robot = f"drift check of {config.robots[0].name}"
    raised = {alarm.source: up for _ in range(3) for alarm, up in troubles.update_alarms(100.0)}
    assert raised[of_robot]
    monkeypatch.undo()
    cleared = {alarm.source: up for _ in range(3) for alarm, up in troubles.update_alarms(500.0)}
    assert cleared[of_robot] is False
