"""Put a backup back where nothing is, after all of it was proved: bytes, journal, certificates."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from calibration.documents.plain_files import read_plain_bytes
from service.configuration.cell_file import read_cell_file
from service.export.archive import BackupError, Manifest, damaged, unpack
from service.export.backup import (
    CELL_FILE,
    DATA,
    KEYS_FILE,
    SECRET_NAMES,
    SETS,
    journal_flaw,
    refuse_spoilt_certificates,
)
from service.export.sealed_keys import open_keys

_JOURNAL, _CERTIFICATES = "journal.db", "certificates"


@dataclass(frozen=True, slots=True)
class Proved:
    """What a backup was found to hold."""

    cell: str
    made_utc: str
    events: int
    certificates: int
    public_key: str
    has_keys: bool
    keys_opened: bool
    data_dir: Path | None = None  # where it was put; None where it was only looked at


def prove(archive: Path, passphrase: str | None = None) -> Proved:
    """Prove a backup without putting it anywhere: a drill.

    Raises
    ------
    BackupError
        Anything in it is not as it was put there.
    """
    with tempfile.TemporaryDirectory(prefix="cellcal-restore-") as folder:
        return _unpacked(archive, Path(folder), passphrase)


def restore(archive: Path, cell_file: Path, passphrase: str | None = None) -> Proved:
    """Put a backup where a cell file says; where there is no cell file, the one in the backup is put there.

    Raises
    ------
    BackupError
        Anything in the backup is not as it was put there, or something is in the way. Nothing is changed then.
    """
    with _beside(cell_file.parent) as stage:
        found = _unpacked(archive, stage, passphrase)
        data_dir = _data_dir(cell_file, stage, found.cell)
        places = {stage / DATA: data_dir, stage / SETS: cell_file.parent / SETS}
        if not cell_file.exists():
            places[stage / CELL_FILE] = cell_file
        _put(places)
    return replace(found, data_dir=data_dir)


def _unpacked(archive: Path, stage: Path, passphrase: str | None) -> Proved:
    manifest = unpack(archive, stage)
    data = stage / DATA
    _prove_journal(archive, manifest, data / _JOURNAL)
    try:
        certificates = refuse_spoilt_certificates(data / _CERTIFICATES)
    except BackupError as error:
        raise damaged(archive, error.message) from error
    if passphrase is not None:
        _put_keys(stage, passphrase)
    content = manifest.content
    return Proved(
        cell=str(content.get("cell", "")),
        made_utc=str(content.get("made_utc", "")),
        events=int(content["journal"]["events"]),
        certificates=certificates,
        public_key=manifest.public_key,
        has_keys=KEYS_FILE in manifest.entries,
        keys_opened=passphrase is not None,
    )


def _prove_journal(archive: Path, manifest: Manifest, path: Path) -> None:
    told = manifest.content.get("journal")
    if not path.exists() or not isinstance(told, dict) or CELL_FILE not in manifest.entries:
        raise damaged(archive, "its journal or its cell file is missing")
    events, head, flaw = journal_flaw(path)
    if flaw or (events, head) != (told.get("events"), told.get("head")):
        raise damaged(archive, f"its journal does not hold: {flaw or 'it ends otherwise than its list says'}")
    for leftover in path.parent.glob(f"{path.name}-*"):
        leftover.unlink()  # of the look at it


def _put_keys(stage: Path, passphrase: str) -> None:
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


def _data_dir(cell_file: Path, stage: Path, cell: str) -> Path:
    """Return where the cell file that counts wants the data; what is relative, from where that file will be."""
    if not cell_file.exists():
        draft = stage / "read" / cell_file.name
        draft.parent.mkdir()
        shutil.copy(stage / CELL_FILE, draft)
        wanted = read_cell_file(draft).cell.data_dir
        inside = wanted.is_relative_to(draft.parent)
        return cell_file.parent / wanted.relative_to(draft.parent) if inside else wanted
    config = read_cell_file(cell_file)
    if config.cell.name != cell:
        raise BackupError(
            f"the backup is of {cell!r}, {cell_file} of {config.cell.name!r}.",
            remedy="Name the cell file of that cell, or one that is not there yet.",
            code="usage",
        )
    return config.cell.data_dir


def _put(places: dict[Path, Path]) -> None:
    """Move each to its place, all or none."""
    wanted = {source: target for source, target in places.items() if source.exists()}
    for target in wanted.values():
        if target.exists() and not (target.is_dir() and not any(target.iterdir())):
            raise BackupError(
                f"{target} is in the way: a backup is never put over what is there.",
                remedy="End what uses it, move it away, and try again.",
                code="usage",
            )
    moved: list[Path] = []
    try:
        for source, target in wanted.items():
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.is_dir():
                target.rmdir()
            _move(source, target)
            moved.append(target)
    except OSError as error:
        for target in moved:
            shutil.rmtree(target) if target.is_dir() else target.unlink()
        raise BackupError(
            f"{error.filename or 'a folder'} cannot be written: {error.strerror}. Nothing was put back.",
            remedy="See who may write there, and that the disk has room.",
            code="store.io",
        ) from error
    os.sync()


def _move(source: Path, target: Path) -> None:
    """Move, also to another disk, so that the target is whole or not there."""
    try:
        source.rename(target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        draft = target.with_name(f".{target.name}.restoring")
        shutil.copytree(source, draft) if source.is_dir() else shutil.copy(source, draft)
        os.sync()
        draft.rename(target)


@contextmanager
def _beside(folder: Path) -> Iterator[Path]:
    """Lend a folder on the disk of the cell file, for its owner only; whatever is left in it goes."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stage = Path(tempfile.mkdtemp(dir=folder, prefix=".cellcal-restore-"))
    except OSError as error:
        raise BackupError(
            f"{folder} cannot be written: {error.strerror}.", remedy="Name another place.", code="usage"
        ) from error
    try:
        yield stage
    finally:
        shutil.rmtree(stage, ignore_errors=True)
