"""Mastering records from controller files: signed documents in a folder; a watch compares with the newest.

Each is the product's own record file (``cellcal mastering import`` takes it into a cell), with what else the
controller held at that time: frames, tools, programs, software.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from cellcal.calibration.errors import CellError
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.controller_files.controller_files import ControllerFiles
from cellcal.drivers.fanuc.program_files.va_positions import CARTESIAN, VaPosition
from cellcal.drivers.fanuc.program_files.va_spots import parse_real
from cellcal.procedures.recovery.record_seal import seal_of
from cellcal.service.engineering.controller_files.other_axes import OtherAxis, find_other_axes
from cellcal.service.engineering.controller_files.record_from_files import FilesRecord
from cellcal.service.engineering.parameters.mastering_files import FORMAT, RecordFileError
from cellcal.service.files import SHARED_FILE, make_private_folder, replace_file
from cellcal.service.record.signing import (
    KEY_NAME,
    CheckedDocument,
    CheckFinding,
    check_document,
    read_document,
    station_key,
)

_RECORDS: TypeAdapter[MasteringRecord] = TypeAdapter(MasteringRecord)
_PREFIX = "fanuc_"

Numbers = tuple[float, ...]


class ControllerContent(BaseModel):
    """The contents of a controller beside its mastering. Frames and tools as their six numbers, mm and deg."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    address: str
    group: int
    robot: str = ""
    software: str = ""
    written: str = ""  # by the controller's clock
    frames: dict[str, Numbers] = {}
    tools: dict[str, Numbers] = {}
    programs: dict[str, str] | None = None
    files: tuple[str, ...] | None = None  # that were read; None: from before they were kept
    safety: dict[str, int] | None = None  # signature numbers of DCS by name
    other_axes: dict[str, OtherAxis] | None = (
        None  # of no record, by "group.axis"; None: from before they were kept
    )


@dataclass(frozen=True, slots=True)
class StoredRecord:
    """One signed document."""

    path: Path
    stored_utc: str
    record: MasteringRecord
    controller: ControllerContent
    public_key: str

    @property
    def day(self) -> str:
        """Date and time as people read them."""
        return f"{self.stored_utc[:16].replace('T', ' ')} UTC"


def controller_content(files: ControllerFiles, group: int) -> ControllerContent:
    """Return what is kept beside a record, and compared by the watch."""
    version = files.version
    return ControllerContent(
        address=files.device,
        group=group,
        robot=", ".join(version.robots) if version is not None else "",
        software=version.software if version is not None else "",
        written=files.written.isoformat() if files.written is not None else "",
        frames=_numbers_of(files.variables.frame_positions, group),
        tools=_numbers_of(files.variables.tool_positions, group),
        programs=None if files.programs is None else dict(files.programs),
        files=files.read_names,
        safety=None if files.safety is None else dict(files.safety),
        other_axes=find_other_axes(files, group),
    )


def store_record(folder: Path, done: FilesRecord, files: ControllerFiles) -> StoredRecord:
    """Write a record as a signed document into a folder.

    Raises
    ------
    RecordFileError
        The folder cannot be written, or holds a record of this robot from after this computer's time.
    """
    stored_utc = datetime.now(UTC).isoformat()
    _refuse_earlier(stored_utc, folder, done)
    controller = controller_content(files, done.group)
    content = {
        "cell": "",
        "robot": done.device,
        "stored_utc": stored_utc,
        "run_id": "controller files",
        "record": _RECORDS.dump_python(done.record, mode="json"),
        "controller": controller.model_dump(mode="json"),
    }
    try:
        make_private_folder(folder)
        key = station_key(folder)
        stamp = stored_utc[:26].translate(str.maketrans("", "", "-:.+"))
        name = f"{_PREFIX}{_plain_name(done.record.robot_serial)}_g{done.group}_{stamp}.json"
        replace_file(folder / name, key.sign_document(FORMAT, content), mode=SHARED_FILE)
    except OSError as error:
        raise RecordFileError(
            f"the record cannot be written to {folder}: {error.strerror}.",
            remedy="Give another folder with --records.",
        ) from error
    return StoredRecord(folder / name, stored_utc, done.record, controller, key.public_key)


def _refuse_earlier(stored_utc: str, folder: Path, done: FilesRecord) -> None:
    """Refuse a record that would not count as the newest: the clock was set back, or stood too late before."""
    of_robot = (done.record.robot_serial, done.group)
    for each in list_records(folder):
        if (each.record.robot_serial, each.controller.group) == of_robot and each.stored_utc > stored_utc:
            raise RecordFileError(
                make_message(
                    "the clock of this computer stands before the newest record ({day}), which would go on to count.",
                    day=each.day,
                ),
                remedy="Set the clock. If the date of that record is wrong, move it away.",
                code="usage",
            )


def list_records(folder: Path) -> tuple[StoredRecord, ...]:
    """Return every record of a folder, oldest first.

    Raises
    ------
    RecordFileError
        One was changed since it was signed, another key signed it, or it cannot be read.
    """
    try:
        paths = sorted(folder.glob(f"{_PREFIX}*.json"))
        if paths and not (folder / KEY_NAME).exists():
            raise RecordFileError(
                f"{folder} holds records, and not the key that signed them ({KEY_NAME}).",
                remedy="Copy the key from where the records were taken, or take new ones into another folder.",
                code="signature",
            )
        expected = station_key(folder).public_key if paths else None
    except OSError as error:
        raise RecordFileError(
            f"the records in {folder} cannot be read: {error.strerror}.", code="usage"
        ) from error
    return tuple(sorted((_read_record(path, expected) for path in paths), key=lambda each: each.stored_utc))


def _read_record(path: Path, expected_key: str | None) -> StoredRecord:
    raw = read_document(path)
    checked = raw if isinstance(raw, CheckedDocument) else check_document(raw, expected_key=expected_key)
    if checked.finding is not CheckFinding.INTACT:
        raise RecordFileError(
            f"{path} is not used: {checked.sentence}",
            remedy="Restore it from a copy, or move it away and take a new record.",
            code="signature",
        )
    try:
        record = _RECORDS.validate_python(checked.content["record"])
        controller = ControllerContent.model_validate(checked.content["controller"])
        stored_utc = str(checked.content["stored_utc"])
    except (ValidationError, CellError, KeyError, TypeError) as error:
        raise RecordFileError(f"{path} holds no record of a controller's files.", code="usage") from error
    if record.sha256 != seal_of(record):
        raise RecordFileError(f"{path}: the record does not carry its own hash.", code="signature")
    return StoredRecord(path, stored_utc, record, controller, checked.public_key)


def _numbers_of(positions: Mapping[tuple[int, int], VaPosition], group: int) -> dict[str, Numbers]:
    found = {}
    for (of_group, number), position in positions.items():
        if of_group == group and position.is_initialised and position.is_cartesian:
            found[str(number)] = _six_numbers(position)
    return found


def _six_numbers(position: VaPosition) -> Numbers:
    return tuple(parse_real(position.file, position.numbers[name]) for name in CARTESIAN)


def _plain_name(text: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in text)[:64]
