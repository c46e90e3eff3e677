"""A mastering record on its way to another computer: whole, of the same robot, and never by mistake."""

import json
import sqlite3
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import TypeAdapter

from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.procedures.recovery.record_seal import seal_record
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.engineering.parameters.mastering_files import (
    FORMAT,
    RecordFileError,
    export_record,
    import_record,
    in_force,
)
from cellcal.service.record.journal import StoreError
from cellcal.service.record.journal_files import journal_path, open_journal
from cellcal.service.record.run_store import RunStore
from cellcal.service.record.signing import check_document, station_key
from cellcal.service.runs.open_cell import offline_cell
from cellcal.service.runs.run_preview import offline_cell_with_history
from tests.procedures.certified_runs import cell_config
from tests.procedures.procedure_scenes import healthy_scene, record_of

_RECORDS: TypeAdapter[MasteringRecord] = TypeAdapter(MasteringRecord)


@pytest.fixture
async def exported_record(tmp_path: Path) -> tuple[CellConfig, Path, MasteringRecord]:
    """A cell with a record, and that record as a signed file."""
    config, record = cell_config(tmp_path / "first"), await record_of(healthy_scene())
    with open_journal(config) as journal:
        RunStore(journal).put_mastering_record(record, actor="anna")
    signed, _ = export_record(config, None, tmp_path / "stick")
    return config, signed, record


def signed_by(config: CellConfig, record: MasteringRecord, path: Path) -> Path:
    content = {"cell": "x", "robot": "y", "record": _RECORDS.dump_python(record, mode="json")}
    path.write_text(station_key(config.cell.data_dir).sign_document(FORMAT, content))
    return path


async def test_a_record_goes_to_another_computer_whole(exported_record, tmp_path: Path) -> None:
    config, signed, record = exported_record
    other = cell_config(tmp_path / "second")
    with pytest.raises(RecordFileError, match="no mastering record"):
        in_force(other)
    public = station_key(config.cell.data_dir).public_key
    done = import_record(other, signed, who="bert", expected_key=public)
    assert (done.record, done.was_known, done.public_key) == (record, False, public)
    assert in_force(other).record == record
    assert offline_cell_with_history(other).record == record
    assert offline_cell(other).record is None
    assert import_record(other, signed, who="bert").was_known
    with open_journal(other) as journal:
        assert len(journal.list_events()) == 1
        assert journal.list_events()[0].actor == "bert"


async def test_the_same_record_is_exported_to_the_same_bytes(exported_record, tmp_path: Path) -> None:
    config, signed, _ = exported_record
    again, _ = export_record(config, "fanuc", tmp_path / "again")
    assert (again.name, again.read_bytes()) == (signed.name, signed.read_bytes())


async def test_a_damaged_file_is_refused(exported_record, tmp_path: Path) -> None:
    other, (_, signed, _) = cell_config(tmp_path / "second"), exported_record
    raw = signed.read_bytes()
    place = raw.index(b'"counts_at_zero"') + 20
    for changed in (raw[:place] + bytes([raw[place] ^ 1]) + raw[place + 1 :], raw[:-5], b"", raw + b" "):
        signed.write_bytes(changed)
        with pytest.raises(RecordFileError, match="was not imported"):
            import_record(other, signed, who="bert")
    assert not (other.cell.data_dir / "journal.db").exists()


async def test_another_robot_another_model_another_key_another_document(
    exported_record, tmp_path: Path
) -> None:
    config, signed, record = exported_record
    with pytest.raises(RecordFileError, match="this cell has fanuc F-2"):
        import_record(cell_config(tmp_path / "a", serial="F-2"), signed, who="bert")
    path = write_cell_file(tmp_path / "b", "127.0.0.1", seed=1, time_factor=600.0)
    path.write_text(path.read_text().replace("F-104711", "F-1").replace("fanuc_m6ib", "kuka_kr6_r900"))
    with pytest.raises(RecordFileError, match="the cell file calls fanuc a kuka_kr6_r900"):
        import_record(read_cell_file(path), signed, who="bert")
    other = cell_config(tmp_path / "c")
    with pytest.raises(RecordFileError, match="another key"):
        import_record(other, signed, who="bert", expected_key=station_key(tmp_path / "c" / "data").public_key)
    signed.write_text(
        station_key(config.cell.data_dir).sign_document("cellcal certificate 1", {"record": {}})
    )
    with pytest.raises(RecordFileError, match="no mastering record"):
        import_record(other, signed, who="bert")
    for unsealed in (replace(record, epoch=99), replace(record, sha256="0" * 64)):
        with pytest.raises(RecordFileError, match="its own hash"):
            import_record(other, signed_by(config, unsealed, tmp_path / "x.json"), who="bert")
    signed.write_text(station_key(config.cell.data_dir).sign_document(FORMAT, {"record": {"model": 3}}))
    with pytest.raises(RecordFileError, match="understands"):
        import_record(other, signed, who="bert")


async def test_a_record_in_force_is_not_replaced_by_mistake(exported_record, tmp_path: Path) -> None:
    config, signed, record = exported_record
    older = seal_record(replace(record, counts_at_zero=tuple(c + 7 for c in record.counts_at_zero)))
    path = signed_by(config, older, tmp_path / "older.json")
    with pytest.raises(RecordFileError, match="zero positions differ") as error_info:
        import_record(config, path, who="bert")
    assert "--replace" in error_info.value.remedy
    assert in_force(config).record == record
    for which, file in ((older, path), (record, signed), (older, path)):  # and back, as often as it takes
        import_record(config, file, who="bert", replace=True)
        assert in_force(config).record == which


async def test_the_sheet_fits_the_cabinet_door(exported_record) -> None:
    config, signed, record = exported_record
    text = signed.with_suffix(".txt").read_text()
    assert max(map(len, text.splitlines())) <= 80
    for expected_text in (
        record.sha256,
        "F-1",
        *map(str, record.counts_at_zero),
        station_key(config.cell.data_dir).public_key,
    ):
        assert expected_text in text
    assert check_document(signed.read_bytes()).content["record"]["sha256"] == record.sha256
    assert json.loads(signed.read_text())["format"] == FORMAT


async def test_a_damaged_journal_gives_out_no_record_for_the_one_in_force(exported_record) -> None:
    """A newer one may stand behind the damage."""
    config, _, _ = exported_record
    with open_journal(config) as journal:
        journal.append("later", "started", {})
    with sqlite3.connect(journal_path(config)) as database:
        database.execute("UPDATE event SET hash = zeroblob(32) WHERE seq = 2")
    for each_record in (
        lambda: in_force(config),
        lambda: offline_cell_with_history(config),
        lambda: export_record(config, None, config.cell.data_dir / "again"),
    ):
        with pytest.raises(StoreError, match="damaged after event 1"):
            each_record()
    with open_journal(config) as journal:
        for read in (
            lambda: RunStore(journal).resolve_run_id("last"),
            lambda: RunStore(journal).list_alignments(),
        ):
            with pytest.raises(StoreError, match="damaged after event 1"):
                read()
