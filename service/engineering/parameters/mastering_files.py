"""Mastering records on their way between computers: exported signed, imported only whole and for the same robot."""

from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.procedures.recovery.record_seal import seal_of
from cellcal.procedures.run_history import EventKind
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.mastering_sheet import as_sheet
from cellcal.service.files import SHARED_FILE, replace_file
from cellcal.service.record.journal import Journal, JournalEvent
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import RECORD, RunStore
from cellcal.service.record.signing import (
    CheckedDocument,
    CheckFinding,
    check_document,
    read_document,
    station_key,
)

FORMAT = "cellcal mastering record 1"
_RECORDS: TypeAdapter[MasteringRecord] = TypeAdapter(MasteringRecord)


class RecordFileError(CellError):
    """A mastering record cannot be exported or imported."""

    code = "certificate"


@dataclass(frozen=True, slots=True)
class RecordInForce:
    """The record in force, and where it comes from."""

    robot: str
    record: MasteringRecord
    stored_utc: str
    run_id: str

    def as_content(self, cell: str) -> dict[str, object]:
        """Return what is signed."""
        return {
            "cell": cell,
            "robot": self.robot,
            "stored_utc": self.stored_utc,
            "run_id": self.run_id,
            "record": _RECORDS.dump_python(self.record, mode="json"),
        }


@dataclass(frozen=True, slots=True)
class ImportedRecord:
    """The result of an import. ``was_known`` where it was in force already."""

    robot: str
    record: MasteringRecord
    public_key: str
    was_known: bool


def in_force(config: CellConfig, robot: str | None = None) -> RecordInForce:
    """Return the latest mastering record of a robot.

    Raises
    ------
    RecordFileError
        There is none.
    """
    entry = config.robot_named(robot)
    with open_journal(config) as journal:
        record, event = RunStore(journal).mastering_record(entry.serial), _find_stored(journal, entry.serial)
    if record is None or event is None:
        raise RecordFileError(
            f"there is no mastering record of {entry.name} (serial {entry.serial}).",
            remedy=f"Take it while the robot is healthy: `cellcal run mastering_record --cell {config.path}`.",
        )
    return RecordInForce(entry.name, record, event.wall_utc, event.run_id)


def export_record(config: CellConfig, robot: str | None, out: Path) -> tuple[Path, Path]:
    """Write the record in force as a signed file, and the sheet for the robot's door; return both paths."""
    current = in_force(config, robot)
    key = station_key(config.cell.data_dir)
    signed = key.sign_document(FORMAT, current.as_content(config.cell.name))
    name = f"mastering_record_{current.record.robot_serial}_{current.record.sha256[:12]}"
    paths = out / f"{_safe_file_name(name)}.json", out / f"{_safe_file_name(name)}.txt"
    try:
        out.mkdir(parents=True, exist_ok=True)
        replace_file(paths[0], signed, mode=SHARED_FILE)
        replace_file(paths[1], as_sheet(current, config.cell.name, key.public_key), mode=SHARED_FILE)
    except OSError as error:
        raise RecordFileError(
            f"the record cannot be written to {out}: {error.strerror}.",
            remedy="Give another folder with --out.",
        ) from error
    return paths


def import_record(
    config: CellConfig, path: Path, *, who: str, expected_key: str | None = None, replace: bool = False
) -> ImportedRecord:
    """Take in a record that was exported elsewhere, as the one in force.

    Raises
    ------
    RecordFileError
        The file is damaged or no record, another key signed it, it is of another robot or model, or another
        record is in force and ``replace`` was not said.
    """
    checked = _read_checked(path, expected_key)
    record = _record_of(checked)
    robot = _robot_of(config, record)
    return ImportedRecord(
        robot, record, checked.public_key, store_in_force(config, record, who=who, replace=replace)
    )


def store_in_force(config: CellConfig, record: MasteringRecord, *, who: str, replace: bool) -> bool:
    """Keep a record as the one in force; tell whether it was in force already.

    Raises
    ------
    RecordFileError
        Another record of this robot is in force and ``replace`` was not said.
    """
    with open_journal(config) as journal:
        store = RunStore(journal)
        present = store.mastering_record(record.robot_serial)
        if present is not None and present != record and not replace:
            raise _in_the_way(present, record, _find_stored(journal, record.robot_serial))
        if present != record:
            store.put_mastering_record(record, actor=who)
    return present == record


def _read_checked(path: Path, expected_key: str | None) -> CheckedDocument:
    raw = read_document(path)
    checked = raw if isinstance(raw, CheckedDocument) else check_document(raw, expected_key=expected_key)
    if checked.finding is not CheckFinding.INTACT:
        code = "usage" if checked.finding is CheckFinding.UNREADABLE else "signature"
        raise RecordFileError(
            f"{path} was not imported: {checked.sentence}",
            remedy="Export it again with `cellcal mastering export` and carry it over.",
            code="certificate" if checked.finding is CheckFinding.UNKNOWN_KEY else code,
        )
    if checked.format != FORMAT:
        raise RecordFileError(f"{path} holds a {checked.format!r}, no mastering record.", code="usage")
    return checked


def _record_of(checked: CheckedDocument) -> MasteringRecord:
    try:
        record = _RECORDS.validate_python(checked.content["record"])
    except (ValidationError, CellError, KeyError, TypeError) as error:
        raise RecordFileError(
            "the file is signed and yet holds no mastering record that this version understands.",
            remedy="Export it again with this version of cellcal.",
        ) from error
    if record.sha256 != seal_of(record):
        raise RecordFileError(
            "the record does not carry its own hash: it was changed before it was signed.",
            remedy="Do not use it. Take a new record, or import the one that was first exported.",
            code="signature",
        )
    return record


def _robot_of(config: CellConfig, record: MasteringRecord) -> str:
    for robot in config.robots:
        if robot.serial == record.robot_serial:
            if robot.model != record.model:
                raise RecordFileError(
                    f"the record is of a {record.model}, the cell file calls {robot.name} a {robot.model}.",
                    remedy="Correct the model in the cell file, if the robot's plate says so.",
                )
            return robot.name
    there = ", ".join(f"{robot.name} {robot.serial}" for robot in config.robots)
    raise RecordFileError(
        f"the record is of robot {record.robot_serial}; this cell has {there}. It was not imported.",
        remedy="A record serves one robot only: import the one of this robot.",
    )


def _in_the_way(
    present: MasteringRecord, record: MasteringRecord, stored: JournalEvent | None
) -> RecordFileError:
    since = "" if stored is None else f", stored {stored.wall_utc[:19].replace('T', ' ')} UTC"
    other = " Their zero positions differ." if present.counts_at_zero != record.counts_at_zero else ""
    other += (
        " Only the one in force can find lost turns."
        if present.is_measured and not record.is_measured
        else ""
    )
    return RecordFileError(
        f"another record of this robot is in force ({present.sha256[:12]}{since}); the file holds "
        f"{record.sha256[:12]}.{other}",
        remedy="The newer one is right as a rule. If you know that the file's is, import it with --replace.",
    )


def _find_stored(journal: Journal, serial: str) -> JournalEvent | None:
    found = None
    for event in journal.list_events():
        if event.kind == EventKind.STORED:
            body = parse_json(event.body)
            found = event if (body["what"], body["robot_serial"]) == (RECORD, serial) else found
    return found


def _safe_file_name(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)
