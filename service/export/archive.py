"""One backup as one file: a plain tar with a signed list of its content first, and a SHA-256 of it all at its end.

``tar -tf`` reads it, too. The list (``manifest.json``) is signed by the cell; it names every file with its size and
hash. The last 65 bytes are the SHA-256 of all bytes before them: one that changed anywhere is noticed before a byte
is unpacked.
"""

import hashlib
import io
import os
import tarfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any

from cellcal.calibration.documents.plain_files import open_plain_file
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.draft_files import draft_beside, remove_left_behind
from cellcal.service.export.archive_headers import find_odd_header
from cellcal.service.export.backup_names import is_backup_name
from cellcal.service.files import PRIVATE_FILE, name_new_file
from cellcal.service.record.signing import CellKey, CheckFinding, check_document

FORMAT = "cellcal backup 1"
MANIFEST = "manifest.json"
_TRAILER_BYTES = 65
_CHUNK = 1 << 20
_MOST_MANIFEST_BYTES = 32_000_000
_MOST_FILES = 200_000
_LONGEST_PATH = 512


class BackupError(CellError):
    """A backup cannot be made, read or put back."""

    code = "store"


@dataclass(frozen=True, slots=True)
class ArchiveEntry:
    """One file of a backup."""

    path: str  # relative, with "/"
    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class BackupManifest:
    """The signed contents list of a backup."""

    content: Mapping[str, Any]
    entries: Mapping[str, ArchiveEntry]
    public_key: str


def damaged_error(path: Path, why: str) -> BackupError:
    """Return the refusal of an archive that cannot be trusted."""
    return BackupError(
        f"{path} is no whole backup: {why}. Nothing of it was put back.",
        remedy="Take another copy of it, or an earlier backup.",
        code="store.damaged",
    )


def write_archive(path: Path, files: Mapping[str, Path], content: Mapping[str, Any], key: CellKey) -> None:
    """Write files, by their paths in the archive, whole or not at all, and never over another file.

    Raises
    ------
    BackupError
        The archive is there already, or cannot be written.
    """
    entries = [_make_entry(name, source) for name, source in sorted(files.items())]
    listed = [{"path": one.path, "bytes": one.size, "sha256": one.sha256} for one in entries]
    manifest = key.sign_document(FORMAT, {**content, "files": listed}).encode()
    try:
        remove_left_behind(path.parent, deep=False)  # as large as a backup
        draft = Path(draft_beside(path))
        descriptor = os.open(draft, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, PRIVATE_FILE)
        try:
            with os.fdopen(descriptor, "w+b") as file:
                _write_tar(file, manifest, entries, files)
                file.write(f"{_hash_content(file, file.tell())}\n".encode())
                file.flush()
                os.fsync(file.fileno())
            name_new_file(draft, path)
        finally:
            draft.unlink(missing_ok=True)
    except FileExistsError as error:
        raise BackupError(
            make_message("{path} is there already.", path=path), remedy="Name another file.", code="usage"
        ) from error
    except OSError as error:
        raise BackupError(
            f"the backup {path} cannot be written: {error.strerror}.",
            remedy="See that the folder is there and may be written, and that its disk has room.",
            code="store.io",
        ) from error


def unpack_archive(path: Path, folder: Path) -> BackupManifest:
    """Unpack a backup into an empty folder after all of it was found whole; each file is checked once more.

    Raises
    ------
    BackupError
        It is damaged, or no backup of ours. The folder then holds nothing that may be used.
    """
    try:
        with open_plain_file(path) as file:
            length = _verified_length(path, file)
            with _open_tar(path, file, length) as tar:
                manifest = _read_manifest(path, tar)
                _unpack_files(path, tar, manifest, folder)
    except OSError as error:
        raise BackupError(
            f"{path} cannot be read or unpacked: {error.strerror}.",
            remedy="See that it is there, and that the disk has room.",
            code="store.io",
        ) from error
    return manifest


def _make_entry(name: str, source: Path) -> ArchiveEntry:
    with open_plain_file(source) as file:
        size = os.fstat(file.fileno()).st_size
        return ArchiveEntry(name, size, _hash_content(file, size))


def _write_tar(
    file: IO[bytes], manifest: bytes, entries: list[ArchiveEntry], files: Mapping[str, Path]
) -> None:
    with tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as tar:
        tar.addfile(_tar_header(MANIFEST, len(manifest)), io.BytesIO(manifest))
        for entry in entries:
            with open_plain_file(files[entry.path]) as source:
                tar.addfile(_tar_header(entry.path, entry.size), source)


def _tar_header(name: str, size: int) -> tarfile.TarInfo:
    header = tarfile.TarInfo(name)
    header.size, header.mode = size, 0o600
    return header


def _verified_length(path: Path, file: IO[bytes]) -> int:
    """Return how long the tar is, once the trailer has proved every byte of it."""
    length = os.fstat(file.fileno()).st_size - _TRAILER_BYTES
    if length <= 0:
        raise damaged_error(path, "it is too short")
    if file.read(len(MANIFEST)) != MANIFEST.encode():  # before hours go by over a file of another kind
        raise damaged_error(path, f"it does not begin with {MANIFEST}")
    found = f"{_hash_content(file, length)}\n".encode()
    if file.read(_TRAILER_BYTES) != found:
        raise damaged_error(path, "a byte was changed, or its end is missing")
    return length


def _hash_content(file: IO[bytes], length: int) -> str:
    file.seek(0)
    hashed, remaining = hashlib.sha256(), length
    while remaining > 0 and (chunk := file.read(min(_CHUNK, remaining))):
        hashed.update(chunk)
        remaining -= len(chunk)
    return hashed.hexdigest()


@contextmanager
def _open_tar(path: Path, file: IO[bytes], length: int) -> Iterator[tarfile.TarFile]:
    try:
        odd = find_odd_header(file, length)
        if odd:
            raise damaged_error(path, odd)
        file.seek(0)
        with tarfile.open(fileobj=file, mode="r:") as tar:
            yield tar
    except (tarfile.TarError, EOFError, ValueError, OverflowError) as error:
        raise damaged_error(path, f"it is no tar: {error}") from error


def _read_manifest(path: Path, tar: tarfile.TarFile) -> BackupManifest:
    first = tar.next()
    if first is None or first.name != MANIFEST or not _is_plain(first) or first.size > _MOST_MANIFEST_BYTES:
        raise damaged_error(path, f"it does not begin with {MANIFEST}")
    reader = tar.extractfile(first)
    checked = check_document(b"" if reader is None else reader.read())
    if checked.finding is not CheckFinding.INTACT or checked.format != FORMAT:
        raise damaged_error(path, f"its {MANIFEST} is not what was signed. {checked.sentence}")
    try:
        listed = [
            ArchiveEntry(str(f["path"]), int(f["bytes"]), str(f["sha256"])) for f in checked.content["files"]
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise damaged_error(path, f"its {MANIFEST} names no files") from error
    wrong = [entry.path for entry in listed if not (_is_safe(entry.path) and is_backup_name(entry.path))]
    if wrong:
        raise damaged_error(
            path, f"its list names files that no backup has: {', '.join(map(repr, wrong[:3]))}"
        )
    if len({entry.path for entry in listed}) != len(listed) or len(listed) > _MOST_FILES:
        raise damaged_error(path, f"its list names a file twice, or more than {_MOST_FILES} files")
    return BackupManifest(checked.content, {entry.path: entry for entry in listed}, checked.public_key)


def _unpack_files(path: Path, tar: tarfile.TarFile, manifest: BackupManifest, folder: Path) -> None:
    missing = dict(manifest.entries)
    while (member := tar.next()) is not None:
        entry = missing.pop(member.name, None)
        if entry is None or not _is_plain(member) or member.size != entry.size:
            raise damaged_error(path, f"it holds {member.name!r} otherwise than its list says")
        reader = tar.extractfile(member)
        if reader is None or _copy_hashed(reader, folder / entry.path) != entry.sha256:
            raise damaged_error(path, f"{entry.path} is not what was put into it")
    if missing:
        raise damaged_error(path, f"{next(iter(missing))} is missing in it")


def _copy_hashed(reader: IO[bytes], target: Path) -> str:
    target.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    hashed = hashlib.sha256()
    descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        while chunk := reader.read(_CHUNK):
            hashed.update(chunk)
            file.write(chunk)
        file.flush()
        os.fsync(file.fileno())
    return hashed.hexdigest()


def _is_plain(member: tarfile.TarInfo) -> bool:
    return member.type == tarfile.REGTYPE


def _is_safe(path: str) -> bool:
    parts = PurePosixPath(path).parts
    plain = path == "/".join(parts) and not path.startswith("/") and ".." not in parts
    readable = path.isprintable() and "\\" not in path
    return plain and readable and 0 < len(path) <= _LONGEST_PATH
