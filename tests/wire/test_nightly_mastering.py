"""One look at night at a FANUC whose mastering is read and not written: the record, and losses that are shown no more."""

from dataclasses import replace
from pathlib import Path

from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.exit_codes import ExitCode
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import RunStore
from cellcal.service.watching.nightly_look import LookedAtRobot, look_at_cell, night_exit_code
from tests.unit.test_watch import record_of
from tests.wire.driver_cases import open_retrying
from tests.wire.fake_devices_process import run_fakes
from tests.wire.tp_cell import TP_CASE, TP_CELL


async def look(config: CellConfig, *, accept: bool = False) -> LookedAtRobot:
    accepted = frozenset({"fanuc"} if accept else ())
    (found,) = await look_at_cell(config, accept=accepted, report=lambda _: None)
    return found


async def test_mastering_that_is_not_the_records_is_told_where_it_is_only_read(tmp_path: Path) -> None:
    with run_fakes(tmp_path, TP_CELL) as (path, fake_client):
        config = read_cell_file(path)
        entry = config.robot_named("fanuc")
        async with open_retrying(entry) as robot:
            await TP_CASE.heal(fake_client, robot)
            mastering, drive = await robot.read_mastering(), await robot.drive_train()
        assert (await look(config)).state == "not compared"
        with open_journal(config) as journal:
            record = replace(record_of(mastering.counts_at_zero), robot_serial=entry.serial, drive=drive)
            RunStore(journal).put_mastering_record(record, actor="anna")
        assert (await look(config)).state == "unchanged"
        await fake_client.inject_fault("old_backup", axis="J3")
        for accept in (False, True, False):
            found = await look(config, accept=accept)
            assert (found.state, night_exit_code([found])) == ("changed", ExitCode.OUT_OF_TOLERANCE), found
            assert "J3" in found.sentence
            assert ("--accept does not answer its mastering" in found.sentence) is accept


async def test_a_loss_is_told_until_a_new_record_where_the_old_counts_were_typed_again(
    tmp_path: Path,
) -> None:
    with run_fakes(tmp_path, TP_CELL) as (path, fake_client):
        config = read_cell_file(path)
        entry = config.robot_named("fanuc")
        async with open_retrying(entry) as robot:
            await TP_CASE.heal(fake_client, robot)
            mastering = await robot.read_mastering()
        record = replace(record_of(mastering.counts_at_zero), robot_serial=entry.serial)
        with open_journal(config) as journal:
            RunStore(journal).put_mastering_record(record, actor="anna")
        await fake_client.inject_fault("memory_loss")
        assert (await look(config)).state == "position lost"
        await fake_client.inject_fault("type_mastering", counts=list(mastering.counts_at_zero))
        for _ in range(2):
            found = await look(config)
            assert (found.state, night_exit_code([found])) == ("changed", ExitCode.OUT_OF_TOLERANCE), found
        with open_journal(config) as journal:
            RunStore(journal).put_mastering_record(replace(record, sha256="d0d0"), actor="anna")
        assert (await look(config)).state == "unchanged"
