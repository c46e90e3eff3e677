"""Undo gives back what the controller held before a write, byte for byte, from the journal alone."""

from dataclasses import replace
from pathlib import Path

import pytest

from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.canonical_json import canonical_json
from cellcal.procedures.mastering_undo import MasteringUndo, mastering_sha256, mastering_undo
from cellcal.procedures.run import RefusalError, Run
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.run_procedure import run_procedure
from tests.procedures.certified_runs import HOW, cell_config, run_in
from tests.procedures.ideal_devices import ZERO
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.procedure_scenes import (
    WRITTEN,
    ProcedureScene,
    calibration_scene,
    recovery_scene,
    undo_scene,
)

SERIAL = "F-1"


def encode_mastering(data: MasteringData) -> bytes:
    return canonical_json({"counts_at_zero": list(data.counts_at_zero), "mastered": data.mastered}).encode()


async def undo_write(config: CellConfig, made: ProcedureScene, of_run: str = "") -> RunOutcome:
    with open_journal(config) as journal:
        cell = RunStore(journal).with_history(replace(made.cell, config_sha256=config.sha256), SERIAL)
        return await run_procedure(cell, "mastering_undo", MasteringUndo(of_run), journal, how=HOW)


async def test_zeros_that_were_written_are_undone_to_the_last_byte_and_done_again(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), calibration_scene()
    before = made.arm.data
    calibrated = await run_in(config, made, "robot_calibration")
    after = made.arm.data
    assert calibrated.verdict is RunVerdict.PASSED
    assert encode_mastering(after) != encode_mastering(before)
    undone = await undo_write(config, made)
    assert (undone.verdict, undone.judgement["word"]) == (RunVerdict.PASSED, "pass")
    assert encode_mastering(made.arm.data) == encode_mastering(before)
    assert undone.result.of_run == calibrated.run_id
    assert undone.result.restored_sha256 == undone.result.backup_sha256 == mastering_sha256(before)
    assert 0.001 < undone.result.displaced_m < 0.5
    again = await undo_write(config, made)  # the undo has written too: its own undo brings the zeros back
    assert again.result.of_run == undone.run_id
    assert encode_mastering(made.arm.data) == encode_mastering(after)
    number = calibrated.run_id.removeprefix("robot_calibration-")  # as the history shows it
    chosen = await undo_write(config, made, number)
    assert chosen.verdict is RunVerdict.PASSED
    assert encode_mastering(made.arm.data) == encode_mastering(before)


async def test_a_recovery_undone_leaves_the_robot_as_unmastered_as_it_was(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), await recovery_scene()
    before = made.arm.data
    assert not before.mastered
    assert (await run_in(config, made, "mastering_recovery")).verdict is RunVerdict.PASSED
    assert made.arm.data.mastered
    undone = await undo_write(config, made)
    assert undone.verdict is RunVerdict.PASSED
    assert encode_mastering(made.arm.data) == encode_mastering(before)


async def test_nothing_is_written_before_the_yes(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), calibration_scene()
    await run_in(config, made, "robot_calibration")
    data_before, writes = made.arm.data, made.arm.writes
    made.technician.refuses = {"accept_mastering"}
    assert (await undo_write(config, made)).verdict is RunVerdict.DECLINED
    assert (made.arm.data, made.arm.writes) == (data_before, writes)


async def test_counts_of_another_epoch_are_not_put_back(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), calibration_scene()
    await run_in(config, made, "robot_calibration")
    made.arm.epoch += 1
    refused = await undo_write(config, made)
    assert (refused.verdict, refused.code) == (RunVerdict.REFUSED, "procedure.wrong_backup")


async def test_without_a_write_there_is_nothing_to_undo(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), undo_scene()
    refused = await undo_write(config, made)
    assert (refused.verdict, refused.code) == (RunVerdict.REFUSED, "procedure.no_backup")
    assert made.arm.data == MasteringData(WRITTEN, mastered=True)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"robot_serial": "F-2"}, "procedure.no_backup"),
        ({"sha256": "0" * 64}, "procedure.no_backup"),
        ({"data": MasteringData(WRITTEN, mastered=True)}, "procedure.no_backup"),
        (
            {
                "data": MasteringData(WRITTEN, mastered=True),
                "sha256": mastering_sha256(MasteringData(WRITTEN, mastered=True)),
            },
            "procedure.nothing_to_undo",
        ),
    ],
)
async def test_a_backup_that_does_not_fit_is_refused(change: dict[str, object], code: str) -> None:
    made = undo_scene()
    (backup,) = made.cell.backups
    made.cell = replace(made.cell, backups=(replace(backup, **change),))  # type: ignore[arg-type]
    with pytest.raises(RefusalError) as error_info:
        await mastering_undo(Run(made.cell, MemoryLedger()), MasteringUndo())
    assert error_info.value.code == code
    assert made.arm.writes == 0


async def test_what_another_hand_wrote_meanwhile_is_what_is_shown_as_old() -> None:
    made = undo_scene()
    result = await mastering_undo(Run(made.cell, MemoryLedger()), MasteringUndo())
    assert result.undone == MasteringData(WRITTEN, mastered=True)
    assert result.restored == MasteringData(ZERO, mastered=True)
