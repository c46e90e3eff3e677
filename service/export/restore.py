"""Put a backup back where nothing is, after all of it was proved: bytes, journal, certificates."""

import errno
import filecmp
import os
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from cellcal.calibration.documents.plain_files import read_plain_bytes, read_plain_text
from cellcal.calibration.message import make_message
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.draft_files import draft_beside, remove_left_behind
from cellcal.service.export.archive import BackupError, BackupManifest, damaged_error, unpack_archive
from cellcal.service.export.backup import (
    CELL_FILE,
    DATA,
    KEYS_FILE,
    SECRET_NAMES,
    SETS,
    journal_flaw,
    refuse_damaged_certificates,
)
from cellcal.service.export.sealed_keys import open_keys
from cellcal.service.files import PRIVATE_FOLDER
from cellcal.service.people.accounts import REGISTER_NAME
from cellcal.service.record.database_setup import find_foreign_rules
from cellcal.service.times import has_time_zone

_DATA_DIR = re.compile(r"^[ \t]*data_dir[ \t]*=.*$", re.MULTILINE)
_JOURNAL, _CERTIFICATES = "journal.db", "certificates"


@dataclass(frozen=True, slots=True)
class ProvedBackup:
    """The proved contents of a backup."""

    cell: str
    made_utc: str
    events: int
    certificates: int
    public_key: str
    has_keys: bool
    keys_opened: bool
    data_dir: Path | None = None  # where it was put; None where it was only looked at


def prove_backup(archive: Path, passphrase: str | None = None) -> ProvedBackup:
    """Prove a backup without putting it anywhere: a drill.

    Raises
    ------
    BackupError
        Anything in it is not as it was put there, or no cell could be put back from it on an empty computer.
    """
    with tempfile.TemporaryDirectory(prefix="cellcal-restore-") as folder:
        found = _unpack_and_prove(archive, Path(folder), passphrase)
        _set_data_dir(Path(folder) / CELL_FILE)
        return found


def restore_backup(
    archive: Path, cell_file: Path, passphrase: str | None = None, *, signed_by: str | None = None
) -> ProvedBackup:
    """Put a backup where a cell file says; where there is no cell file, the one in the backup is put there.

    The cell file of a backup never says where the data go: without one in place, they go to ``data`` beside it.

    Parameters
    ----------
    archive, cell_file, passphrase
        The backup, the cell file, and the passphrase of the keys, which are put back only where it is given.
    signed_by
        The key that a person expects to have signed the backup, in hexadecimal.

    Raises
    ------
    BackupError
        Anything in the backup is not as it was put there, another key signed it, or something is in the way.
        Nothing is changed then.
    """
    with _staging_folder(cell_file.parent) as stage:
        found = _unpack_and_prove(archive, stage, passphrase)
        data_dir = _data_dir(cell_file, stage, found.cell)
        _refuse_unpinned(archive, found.public_key, signed_by)
        # The journal last but for the cell file: without it nothing looks like a cell that was put back whole.
        places = {stage / SETS: cell_file.parent / SETS, stage / DATA: data_dir}
        if not cell_file.exists():
            places[stage / CELL_FILE] = cell_file
        _move_all(places)
    return replace(found, data_dir=data_dir)


def _unpack_and_prove(archive: Path, stage: Path, passphrase: str | None) -> ProvedBackup:
    manifest = unpack_archive(archive, stage)
    data = stage / DATA
    _prove_journal(archive, manifest, data / _JOURNAL)
    _prove_register(archive, data / REGISTER_NAME)
    try:
        certificates = refuse_damaged_certificates(data / _CERTIFICATES)
    except BackupError as error:
        raise damaged_error(archive, error.message) from error
    if passphrase is not None:
        _write_keys(stage, passphrase)
    content = manifest.content
    made_utc = str(content.get("made_utc", ""))
    if not has_time_zone(made_utc):
        raise damaged_error(archive, f"it says {made_utc[:60]!r} as when it was made")
    cell = content.get("cell")
    if not isinstance(cell, str) or not cell.isprintable():
        raise damaged_error(archive, "it does not name its cell")
    return ProvedBackup(
        cell=cell,
        made_utc=made_utc,
        events=int(content["journal"]["events"]),
        certificates=certificates,
        public_key=manifest.public_key,
        has_keys=KEYS_FILE in manifest.entries,
        keys_opened=passphrase is not None,
    )


def _prove_journal(archive: Path, manifest: BackupManifest, path: Path) -> None:
    journal_fields = manifest.content.get("journal")
    if not path.exists() or not isinstance(journal_fields, dict) or CELL_FILE not in manifest.entries:
        raise damaged_error(archive, "its journal or its cell file is missing")
    events, head, flaw = journal_flaw(path)
    if flaw or (events, head) != (journal_fields.get("events"), journal_fields.get("head")):
        raise damaged_error(
            archive, f"its journal does not hold: {flaw or 'it ends otherwise than its list says'}"
        )
    for leftover in path.parent.glob(f"{path.name}-*"):
        leftover.unlink()  # of the look at it


def _prove_register(archive: Path, path: Path) -> None:
    """Refuse a register of people that is no database, or acts by itself when a person is added."""
    if not path.exists():
        return
    try:
        with closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        ) as register:
            flaw = find_foreign_rules(register)
    except sqlite3.Error as error:
        flaw = str(error)
    if flaw:
        raise damaged_error(archive, f"its register of people does not hold: {flaw}")


def _write_keys(stage: Path, passphrase: str) -> None:
    sealed = stage / KEYS_FILE
    if not sealed.exists():
        raise BackupError(
            "there are no keys in this backup.", remedy="Restore it without a passphrase.", code="usage"
        )
    keys = open_keys(read_plain_bytes(sealed), passphrase)
    for name in SECRET_NAMES:
        if name in keys:
            descriptor = os.open(stage / DATA / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(descriptor, "wb") as file:
                file.write(keys[name])
                os.fsync(file.fileno())


def _refuse_unpinned(archive: Path, public_key: str, signed_by: str | None) -> None:
    if signed_by is None:
        raise BackupError(
            f"{archive} is signed by key {public_key}; a signature can be made with any key.",
            remedy="Compare the key with the one on a certificate or a note of this cell, then repeat with "
            f"--signed-by {public_key}.",
            code="signature",
        )
    if public_key != signed_by:
        raise BackupError(
            f"{archive} is signed by key {public_key}, not by {signed_by}.",
            remedy="Take the backup that this cell made; do not use this one.",
            code="signature",
        )


def _data_dir(cell_file: Path, stage: Path, cell: str) -> Path:
    """Return where the data go: where the cell file in place says, or else to a folder beside it."""
    if not cell_file.exists():
        _set_data_dir(stage / CELL_FILE)
        return cell_file.parent / DATA
    config = read_cell_file(cell_file)
    if config.cell.name != cell:
        raise BackupError(
            f"the backup is of {cell!r}, {cell_file} of {config.cell.name!r}.",
            remedy="Name the cell file of that cell, or one that is not there yet.",
            code="usage",
        )
    return config.cell.data_dir


def _set_data_dir(cell_file: Path) -> None:
    """Let the cell file of a backup name the folder beside it, whatever it named before."""
    text = read_plain_text(cell_file)
    cell_file.write_text(_DATA_DIR.sub(f'data_dir = "{DATA}"', text, count=1), encoding="utf-8")
    if read_cell_file(cell_file).cell.data_dir != cell_file.parent / DATA:
        raise BackupError(
            "the cell file of this backup names its data folder in a way that cannot be replaced.",
            remedy="Write a cell file at the place first, with the data_dir of this computer.",
            code="usage",
        )


def _move_all(places: dict[Path, Path]) -> None:
    """Move each to its place, all or none; what a restore that was killed has put there already stays."""
    moves = {source: target for source, target in places.items() if source.exists()}
    missing = {source: target for source, target in moves.items() if not _is_same(source, target)}
    moves = missing or moves
    for target in moves.values():
        if target.exists() and not (target.is_dir() and not any(target.iterdir())):
            raise BackupError(
                f"{target} is in the way: a backup is never put over what is there.",
                remedy="End what uses it, move it away, and try again.",
                code="usage",
            )
    moved: list[Path] = []
    try:
        for source, target in moves.items():
            target.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            if target.is_dir():
                target.rmdir()
            _move_file(source, target)
            moved.append(target)
    except OSError as error:
        for target in moved:
            shutil.rmtree(target) if target.is_dir() else target.unlink()
        raise BackupError(
            make_message(
                "{path} cannot be written: {strerror}. Nothing was put back.",
                path=error.filename or "a folder",
                strerror=error.strerror,
            ),
            remedy="See who may write there, and that the disk has room.",
            code="store.io",
        ) from error
    os.sync()


def _is_same(source: Path, target: Path) -> bool:
    """Whether two files, or all files of two folders, are the same to the last byte."""
    if not source.is_dir():
        return target.is_file() and filecmp.cmp(source, target, shallow=False)
    names = {each.relative_to(source) for each in source.rglob("*") if not each.is_dir()}
    if not target.is_dir() or names != {
        each.relative_to(target) for each in target.rglob("*") if not each.is_dir()
    }:
        return False
    return all(_is_same(source / name, target / name) for name in names)


def _move_file(source: Path, target: Path) -> None:
    """Move, also to another disk, so that the target is whole or not there."""
    try:
        source.rename(target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        with _staging_folder(target.parent) as stage:  # nothing of a copy that failed stays
            draft = stage / target.name
            shutil.copytree(source, draft) if source.is_dir() else shutil.copy(source, draft)
            os.sync()
            draft.rename(target)


@contextmanager
def _staging_folder(folder: Path) -> Iterator[Path]:
    """Yield a folder on the disk of the cell file, for its owner only; whatever is left in it goes."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_left_behind(folder, deep=False)  # of a restore that was killed: it may hold keys
        stage = Path(draft_beside(folder / "stage"))
        stage.mkdir(mode=PRIVATE_FOLDER)
    except OSError as error:
        raise BackupError(
            make_message("{path} cannot be written: {strerror}.", path=folder, strerror=error.strerror),
            remedy="Name another place.",
            code="usage",
        ) from error
    try:
        yield stage
    finally:
        shutil.rmtree(stage, ignore_errors=True)
