"""A cure that passed after the position record says what the controller's zero is, until the next record."""

from pathlib import Path
from typing import Any

from cellcal.calibration.mastering.position_record import ShownValue
from cellcal.procedures.run_history import EventKind
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal import NewEvent
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.proved_cures import POSITION_RECORD
from cellcal.service.record.run_store import RunStore
from tests.procedures.certified_runs import cell_config

SERIAL = "F-1"


def add_run(
    config: CellConfig,
    number: int,
    procedure: str,
    *more: NewEvent,
    word: str,
    serial: str = SERIAL,
    result: Any = None,
) -> str:
    """Put a run into the journal that ended with a verdict; return its id."""
    run_id = f"{procedure}-{number:012x}"
    cell = {"devices": [{"role": "robot", "identity": {"serial": serial}}]}
    with open_journal(config) as journal:
        journal.append_all(
            run_id,
            [
                NewEvent(EventKind.STARTED, {"procedure": procedure, "cell": cell}),
                *more,
                NewEvent(
                    EventKind.ENDED,
                    {"verdict": "passed", "reason": "", "judgement": {"word": word}, "result": result},
                ),
            ],
        )
    return run_id


def add_record(config: CellConfig, number: int) -> None:
    stored = NewEvent(EventKind.STORED, {"what": POSITION_RECORD, "robot_serial": SERIAL, "value": {}})
    add_run(config, number, "position_record", stored, word="pass")


def cure_in_force(config: CellConfig) -> str:
    with open_journal(config) as journal:
        cure, _ = RunStore(journal).cures_since_record(SERIAL)
    return "" if cure is None else cure.run_id


def test_the_newest_cure_that_passed_counts_until_the_next_record(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    add_record(config, 1)
    assert cure_in_force(config) == ""
    add_run(config, 2, "position_cure", word="fail")
    add_run(config, 3, "position_cure", word="pass", serial="another")
    add_run(config, 4, "drift_check", word="pass")
    assert cure_in_force(config) == ""
    first = add_run(config, 5, "position_cure", word="pass")
    assert cure_in_force(config) == first
    add_run(config, 6, "position_cure", word="undecided")
    assert cure_in_force(config) == first
    second = add_run(config, 7, "position_cure", word="pass")
    assert cure_in_force(config) == second
    add_record(config, 8)
    assert cure_in_force(config) == ""


def test_a_cure_that_is_gone_on_with_counts_by_its_next_end(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    add_record(config, 1)
    first = add_run(config, 2, "position_cure", word="pass")
    second = add_run(config, 3, "position_cure", word="pass")
    assert cure_in_force(config) == second
    with open_journal(config) as journal:
        journal.append_all(second, [NewEvent(EventKind.FORGOTTEN, {"keep": 1, "step": "measure"})])
    assert cure_in_force(config) == first
    with open_journal(config) as journal:
        end = {"verdict": "passed", "reason": "", "judgement": {"word": "fail"}}
        journal.append_all(second, [NewEvent(EventKind.ENDED, end)])
    assert cure_in_force(config) == first


def test_what_the_controller_showed_in_the_cure_is_kept(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    values = [{"name": "offset", "value": "1.5", "axis": 0, "is_zero": True}]
    add_run(config, 1, "position_cure", word="pass", result={"shown": values})
    with open_journal(config) as journal:
        cure, _ = RunStore(journal).cures_since_record(SERIAL)
    assert cure is not None
    assert cure.shown == (ShownValue("offset", "1.5", 0, is_zero=True),)


def test_a_cure_that_proved_nothing_is_told_until_one_passes_or_a_record_is_taken(tmp_path: Path) -> None:
    config = cell_config(tmp_path)

    def open_run() -> str:
        with open_journal(config) as journal:
            return RunStore(journal).cures_since_record(SERIAL)[1]

    add_record(config, 1)
    assert open_run() == ""
    run_id = add_run(config, 2, "position_cure", word="fail")
    assert open_run() == run_id
    add_run(config, 3, "position_cure", word="pass")
    assert open_run() == ""
    run_id = add_run(config, 4, "position_cure", word="undecided")
    assert open_run() == run_id
    add_record(config, 5)
    assert open_run() == ""
