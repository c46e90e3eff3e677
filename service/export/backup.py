"""Backup of a cell's data while it runs, and the way back.

What is in it: the cell file, the journal and the register of people (copied by SQLite's own backup), certificates,
programs, the last healthy counts, parameter sets. What is not: whatever belongs to a moment or is made anew, such as
leases, the run under way and the site's outbox; secret keys, unless a passphrase was given; the cell's link folder
of a site, whose key is made by enrolling again.
"""

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version as installed_version
from pathlib import Path

from cellcal.calibration.documents.plain_files import open_plain_file, read_plain_bytes
from cellcal.calibration.message import make_message
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.export.archive import BackupError, write_archive
from cellcal.service.export.backup_names import is_backup_name
from cellcal.service.export.sealed_keys import seal_keys
from cellcal.service.people.pin_hashing import PEPPER_NAME
from cellcal.service.record.journal import Journal
from cellcal.service.record.journal_files import certificates_folder, journal_path
from cellcal.service.record.signing import KEY_NAME, CheckFinding, check_document, read_document, station_key
from cellcal.service.site.keys import key_part
from cellcal.service.site.outbox import OUTBOX_NAME

SUFFIX = ".cellcal-backup"
CELL_FILE, KEYS_FILE, DATA, SETS = "cell.toml", "keys.sealed", "data", "parameter_sets"
SECRET_NAMES = (KEY_NAME, PEPPER_NAME)
_OF_A_MOMENT = {"under_way.json", OUTBOX_NAME, "webhook_outbox.sqlite", *SECRET_NAMES}
_OF_SQLITE = ("-wal", "-shm", "-journal")
_MAGIC = b"SQLite format 3\x00"
_SQLITE_NAMES = (".db", ".sqlite")


@dataclass(frozen=True, slots=True)
class BackupResult:
    """A backup that was made."""

    path: Path
    files: int
    events: int
    certificates: int
    size: int
    has_keys: bool
    left_out: tuple[str, ...]  # links, which are not followed, and files that no cell writes


def back_up(config: CellConfig, target: Path, passphrase: str | None = None) -> BackupResult:
    """Write a backup of a cell; ``target`` is a new file, or a folder in which it gets a name.

    Raises
    ------
    BackupError
        There is nothing to keep, a part of it is damaged, or the archive cannot be written.
    """
    made_utc = datetime.now(UTC)
    path = target / _backup_name(config, made_utc) if target.is_dir() else target
    data_dir = config.cell.data_dir
    if not journal_path(config).exists():
        raise BackupError(
            make_message("{data_dir} holds no journal: there is nothing to keep.", data_dir=data_dir),
            remedy="See data_dir of the cell file.",
            code="usage",
        )
    certificates = refuse_damaged_certificates(certificates_folder(config))
    with _scratch_folder(path.parent) as scratch:
        odd: list[str] = []
        files = _copy_files(config, scratch, odd)
        head = _head_of(files[f"{DATA}/{journal_path(config).name}"])
        if passphrase is not None:
            files[KEYS_FILE] = _write_file(
                scratch / KEYS_FILE, seal_keys(_secret_files(data_dir), passphrase)
            )
        content = {
            "cell": config.cell.name,
            "made_utc": made_utc.isoformat(timespec="seconds"),
            "software": installed_version("cellcal"),
            "journal": {"events": head[0], "head": head[1]},
            "certificates": certificates,
            "has_keys": passphrase is not None,
        }
        write_archive(path, files, content, station_key(data_dir))
    size = path.stat().st_size
    return BackupResult(path, len(files), head[0], certificates, size, passphrase is not None, tuple(odd))


def forget_older(config: CellConfig, folder: Path, keep: int) -> list[Path]:
    """Remove all but the newest backups of this cell that got their names here; return what was removed."""
    mine = sorted(folder.glob(f"{key_part(config.cell.name)}-????????T??????Z{SUFFIX}"))
    gone = mine[: max(len(mine) - keep, 0)]
    for path in gone:
        path.unlink()
    return gone


def refuse_damaged_certificates(folder: Path) -> int:
    """Check every certificate of a folder, and return how many there are.

    Raises
    ------
    BackupError
        One is not what was signed.
    """
    found = sorted(folder.glob("*.json")) if folder.is_dir() else []
    for path in found:
        raw = read_document(path)
        checked = check_document(raw) if isinstance(raw, bytes) else raw
        if checked.finding is not CheckFinding.INTACT:
            raise BackupError(
                make_message(
                    "{file} is no certificate as it was signed: {finding}",
                    file=path.name,
                    finding=checked.sentence,
                ),
                remedy="Find out who changed it. Move it away: `cellcal certificate` makes it anew from the journal.",
                code="store.damaged",
            )
    return len(found)


def journal_flaw(path: Path) -> tuple[int, str, str]:
    """Return number and hash of the last event, and what is wrong with the chain; nothing where it holds."""
    with closing(Journal(path)) as journal:
        damage = journal.damage
        events = journal.list_events()
        last = events[-1].seq if events else 0
        return (
            last,
            journal.head_hash().hex() if damage is None else "",
            "" if damage is None else damage.reason,
        )


@contextmanager
def _scratch_folder(folder: Path) -> Iterator[Path]:
    """Yield a folder on the disk of the backup, for its owner only."""
    try:
        with tempfile.TemporaryDirectory(prefix=".cellcal-backup-", dir=folder) as name:
            yield Path(name)
    except OSError as error:
        raise BackupError(
            make_message("{path} cannot be written: {strerror}.", path=folder, strerror=error.strerror),
            remedy="Name a folder that is there and may be written, on a disk with room.",
            code="store.io",
        ) from error


def _copy_files(config: CellConfig, scratch: Path, odd: list[str]) -> dict[str, Path]:
    """Copy what is kept, so that nothing of it changes any more; return the copies by their paths in the backup."""
    files: dict[str, Path] = {}
    for name, source in (*_parameter_files(config), *_data_files(config.cell.data_dir, odd)):
        copy = scratch / f"{len(files)}-{source.name}"
        try:
            _copy_database(source, copy) if _is_database(source) else shutil.copyfile(source, copy)
        except FileNotFoundError:
            continue  # it went meanwhile
        files[name] = copy
    journal = scratch / journal_path(config).name  # last: certificates are of runs that are in it
    _copy_database(journal_path(config), journal)
    files[f"{DATA}/{journal.name}"] = journal
    files[CELL_FILE] = _write_file(scratch / CELL_FILE, config.text.encode())
    return files


def _head_of(copy: Path) -> tuple[int, str]:
    events, head, flaw = journal_flaw(copy)
    if flaw:
        raise BackupError(
            make_message(
                "the journal is damaged after event {events}: {flaw}. It is not backed up, or a good backup might "
                "make room for it.",
                events=events,
                flaw=flaw,
            ),
            remedy="Copy the whole data_dir by hand, then restore the last backup.",
            code="store.damaged",
        )
    return events, head


def _backup_name(config: CellConfig, made_utc: datetime) -> str:
    return f"{key_part(config.cell.name)}-{made_utc:%Y%m%dT%H%M%SZ}{SUFFIX}"


def _parameter_files(config: CellConfig) -> Iterator[tuple[str, Path]]:
    folder = config.path.parent / SETS
    for path in sorted(folder.rglob("*.toml")) if folder.is_dir() else []:
        name = f"{SETS}/{path.relative_to(folder).as_posix()}"
        if path.is_file() and not path.is_symlink() and is_backup_name(name):
            yield name, path


def _data_files(data_dir: Path, odd: list[str]) -> Iterator[tuple[str, Path]]:
    """Yield the files of data_dir but those of a moment; names of links go to ``odd``."""
    for here, folders, names in os.walk(data_dir):
        folders[:] = sorted(
            name for name in folders if name != "leases" and not (Path(here) / name).is_symlink()
        )
        for name in sorted(names):
            path = Path(here) / name
            inside = path.relative_to(data_dir).as_posix()
            if _is_passing(path, top=Path(here) == data_dir):
                continue
            if path.is_symlink() or not path.is_file() or not is_backup_name(f"{DATA}/{inside}"):
                odd.append(inside)
            else:
                yield f"{DATA}/{inside}", path


def _is_passing(path: Path, *, top: bool) -> bool:
    name = path.name
    draft = name.startswith(".") or name.endswith((".lock", ".draft", *_OF_SQLITE))
    return draft or (top and (name in _OF_A_MOMENT or name == "journal.db"))


def _is_database(path: Path) -> bool:
    if path.suffix not in _SQLITE_NAMES:
        return False
    with open_plain_file(path) as file:
        return file.read(len(_MAGIC)) == _MAGIC


def _copy_database(source: Path, copy: Path) -> None:
    """Copy a database as of one moment, also while it is written."""
    try:
        with (
            closing(sqlite3.connect(f"{source.absolute().as_uri()}?mode=ro", uri=True)) as database,
            closing(sqlite3.connect(copy, isolation_level=None)) as target,
        ):
            database.backup(target)
            target.execute("PRAGMA journal_mode=DELETE")  # one file, whole in itself
    except sqlite3.Error as error:
        raise BackupError(
            make_message("{source} cannot be copied: {error}.", source=source, error=error),
            remedy="Look at its disk.",
            code="store.io",
        ) from error


def _secret_files(data_dir: Path) -> dict[str, bytes]:
    station_key(data_dir)
    found = [data_dir / name for name in SECRET_NAMES]
    return {path.name: read_plain_bytes(path) for path in found if path.exists()}


def _write_file(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path
