"""``cellcal mastering import BACKUP``: the mastering record that a FANUC controller's .VA files can tell.

Counts at zero, drives, and the quick-master reference where it belongs to this mastering. What the files cannot tell
is named and left empty, never filled in: wire lengths, places, and the encoder epoch.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.shown_joints import JointConvention
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.backup_file import read_report_in
from cellcal.drivers.fanuc.controller_files.controller_files import VERSION
from cellcal.drivers.fanuc.controller_files.version_report import read_version_report
from cellcal.drivers.fanuc.program_files.va_backup import DRIVES, MASTERING, FanucBackup, read_backup
from cellcal.drivers.fanuc.program_files.va_drives import GroupDrives
from cellcal.drivers.fanuc.program_files.va_edits import count_edits, edit_instructions
from cellcal.drivers.fanuc.program_files.va_mastering import GroupMastering
from cellcal.procedures.recovery.record_seal import seal_record
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.mastering_files import RecordFileError, store_in_force
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import RunStore

_NOT_IN_BACKUP = (
    "wire lengths and places: lost turns cannot be found with this record",
    "the encoder epoch: whether the encoders kept counting since the backup was saved",
)
_NO_NUMBER = "whose robot it is: a .VA file holds no serial number of the arm"
_NO_REFERENCE = "a reference pose: the backup has no quick-master reference of this mastering"
_F_NUMBER = re.compile(r"F\d{4,}")


class ArmChoice(Protocol):
    """Whose backup it is; robot None: the only one of the cell."""

    @property
    def robot(self) -> str | None: ...
    @property
    def group(self) -> int: ...


@dataclass(frozen=True, slots=True)
class BackupImport:
    """The result of an import, and what the backup cannot tell or says against itself."""

    robot: str
    record: MasteringRecord
    was_known: bool
    not_in_backup: tuple[str, ...]
    findings: tuple[str, ...]


def import_backup(
    config: CellConfig, folder: Path, *, who: str, of: ArmChoice, replace: bool = False
) -> BackupImport:
    """Make a mastering record from a folder of .VA files, as the one in force.

    Raises
    ------
    RecordFileError
        The mastering in it is not valid or not whole, it is of another robot or model, or another record is in force
        and ``replace`` was not said.
    ProgramFileError
        A file is damaged.
    """
    if of.robot is None and len(config.robots) > 1:
        raise RecordFileError(
            f"this cell has {len(config.robots)} robots, and a backup does not say whose it is.",
            remedy=f"Say --robot with one of {', '.join(entry.name for entry in config.robots)}.",
            code="usage",
        )
    entry = config.robot_named(of.robot)
    backup = read_backup(folder)
    mastering, drives = _require_valid(backup, of.group)
    names_robot = _is_named(entry.serial, folder)
    _refuse_other_axes(entry.model, mastering)
    record = _build_record(entry.serial, entry.model, mastering, drives)
    was_known = store_in_force(config, record, who=who, replace=replace)
    missing = [*_NOT_IN_BACKUP, *(() if names_robot else (_NO_NUMBER,))]
    missing += () if record.reference_counts else (_NO_REFERENCE,)
    return BackupImport(entry.name, record, was_known, tuple(missing), mastering.findings)


def edits_to(config: CellConfig, folder: Path, of: ArmChoice) -> tuple[str, ...]:
    """Return what an operator types to give the controller the counts of the record in force.

    Raises
    ------
    RecordFileError
        There is no record.
    """
    entry = config.robot_named(of.robot)
    with open_journal(config) as journal:
        record = RunStore(journal).mastering_record(entry.serial)
    if record is None:
        raise RecordFileError(
            f"there is no mastering record of {entry.name} (serial {entry.serial}).",
            remedy="Import one, or take it with `cellcal run mastering_record` while the robot is healthy.",
        )
    return edit_instructions(count_edits(read_backup(folder), of.group, record.counts_at_zero))


def _require_valid(backup: FanucBackup, group: int) -> tuple[GroupMastering, GroupDrives]:
    for name in (MASTERING, DRIVES):
        if name not in backup.files:
            raise RecordFileError(
                f"{name} is not in {backup.folder}; a mastering record needs {MASTERING} and {DRIVES}.",
                remedy="Save the system variables of the controller as ASCII once more, all of them.",
            )
    mastering = backup.mastering.get(group)
    if mastering is None:
        there = ", ".join(map(str, backup.mastering)) or "none"
        raise RecordFileError(
            f"group {group} has no axes in {backup.folder}; there are: {there}.", code="usage"
        )
    if mastering.drives is None or not mastering.is_valid:
        raise RecordFileError(
            f"{backup.folder} was not imported: {'; '.join(mastering.findings)}.",
            remedy="Take a backup from a time when the robot was mastered on every axis."
            if mastering.drives is not None
            else "A record is possible of turning axes only; look at $ENCSCALES, $GEAR_RATIO and $INTERACTION.",
        )
    return mastering, mastering.drives


def _is_named(serial: str, folder: Path) -> bool:
    """Return whether the backup's version report names this robot by its F number; refuse one that names another."""
    robot_number = _plain_number(serial)
    report = read_report_in(folder, VERSION) if _F_NUMBER.fullmatch(robot_number) else None
    if report is None:
        return False
    there = read_version_report(report, VERSION).serial
    if _F_NUMBER.fullmatch(_plain_number(there)) and _plain_number(there) != robot_number:
        raise RecordFileError(
            make_message(
                "the backup in {folder} is of robot {there}, and the cell file says {serial}.",
                folder=folder,
                there=there,
                serial=serial,
            ),
            remedy="Give the backup of this robot, or correct the serial number in the cell file.",
        )
    return _plain_number(there) == robot_number


def _plain_number(serial: str) -> str:
    return re.sub(r"[^A-Z0-9]", "", serial.upper())


def _refuse_other_axes(model: str, mastering: GroupMastering) -> None:
    axes = load_model(model).axis_count
    if axes != len(mastering.counts_at_zero):
        raise RecordFileError(
            f"a {model} has {axes} axes, group {mastering.group} of the backup {len(mastering.counts_at_zero)}.",
            remedy="Say which motion group is this robot's (--group), or correct the model in the cell file.",
            code="usage",
        )


def _third_follows_second(model: str, drives: GroupDrives) -> bool:
    """Return whether J3 is counted from J2: as the controller's variables say, else as the model does."""
    if drives.third_follows_second is not None:
        return drives.third_follows_second
    coupling = load_model(model).joint_coupling
    return len(coupling) > 2 and coupling[2, 1] != 0


def _build_record(serial: str, model: str, mastering: GroupMastering, drives: GroupDrives) -> MasteringRecord:
    holds = mastering.reference_holds
    convention = JointConvention(drives.sign_sets()[0], _third_follows_second(model, drives))
    record = MasteringRecord(
        robot_serial=serial,
        model=model,
        epoch=0,
        drive=drives.to_shown_drive_train(convention),
        counts_at_zero=mastering.counts_at_zero,
        reference_joints_rad=convention.shown_from_links(mastering.reference_rad) if holds else (),
        reference_counts=mastering.reference_counts if holds else (),
        captures=(),
        wire=None,
        prior=None,
        taken_by="controller backup 1",
        sha256="",
    )
    return seal_record(record)
