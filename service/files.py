"""Files that are whole or not there, and folders and files that only their owner reads."""

import errno
import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.draft_files import draft_beside, remove_drafts_once

PRIVATE_FILE, PRIVATE_FOLDER, SHARED_FILE = 0o600, 0o700, 0o644


def replace_file(path: Path, content: str | bytes, *, mode: int = PRIVATE_FILE) -> None:
    """Put a text, or bytes, in place of what is there, so that a crash leaves the old file or the new one.

    Raises
    ------
    OSError
        It cannot be written, or a device, a pipe or a socket is there, which is never replaced.
    """
    _refuse_device(path)
    with _written_draft(path, content.encode() if isinstance(content, str) else content, mode) as draft:
        draft.replace(path)


def create_file(path: Path, content: bytes, *, mode: int = PRIVATE_FILE) -> None:
    """Put a new file where none is: a crash leaves none or a whole one, and of two processes one succeeds.

    Raises
    ------
    FileExistsError
        One is there already.
    OSError
        It cannot be written.
    """
    with _written_draft(path, content, mode) as draft:
        name_new_file(draft, path)


@contextmanager
def _written_draft(path: Path, content: bytes, mode: int) -> Iterator[Path]:
    """Give a whole file beside ``path``, which is gone afterwards; after a kill the next start removes it."""
    remove_drafts_once(path.parent, deep=False)
    draft = Path(draft_beside(path))
    try:
        descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, PRIVATE_FILE)
    except OSError as error:
        error.filename = os.fspath(path)  # the name that a person gave
        raise
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        draft.chmod(mode)
        yield draft
    finally:
        draft.unlink(missing_ok=True)


def name_new_file(draft: Path, path: Path) -> None:
    """Give a whole file beside ``path`` that name, where no file has it; the draft's name may go or stay.

    A stick (exFAT, FAT) or a network drive may know no hard links. There the file is renamed while the folder is
    locked, so that two processes of this computer cannot both find the name free.

    Raises
    ------
    FileExistsError
        A file of that name is there already.
    OSError
        The folder cannot be written.
    """
    try:
        os.link(draft, path)
    except FileExistsError:
        raise
    except OSError:
        _rename_in_locked_folder(draft, path)


def _rename_in_locked_folder(draft: Path, path: Path) -> None:
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with suppress(OSError):  # some network drives know no locks: then the look below is all there is
            fcntl.flock(folder, fcntl.LOCK_EX)
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, "it is there already", os.fspath(path))
        draft.rename(path)
    finally:
        os.close(folder)


def make_private_folder(path: Path) -> None:
    """Make a folder and those above it that are missing, for their owner only, whatever the umask says."""
    missing = []
    while not path.exists():
        missing.append(path)
        path = path.parent
    for folder in reversed(missing):
        with suppress(FileExistsError):  # another process was quicker
            folder.mkdir(mode=PRIVATE_FOLDER)
            folder.chmod(PRIVATE_FOLDER)
    if not path.is_dir():
        path.mkdir()  # says what is in the way


def create_private_file(path: Path) -> None:
    """Make an empty file for its owner only, whatever the umask says; one that is there stays as it is."""
    with suppress(FileExistsError):
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, PRIVATE_FILE)
        try:
            os.fchmod(descriptor, PRIVATE_FILE)
        finally:
            os.close(descriptor)


def _refuse_device(path: Path) -> None:
    try:
        mode = path.stat().st_mode
    except OSError:
        return  # nothing is there, or what is done next says why not
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EEXIST, "it is a device, a pipe or a socket, not a file", os.fspath(path))


def refuse_existing(path: Path) -> None:
    """Refuse, before the work, to write over a file.

    Raises
    ------
    CellError
        Something of that name is there already.
    """
    if os.path.lexists(path):
        raise CellError(
            make_message("{path} is there already.", path=path),
            remedy="Name a file that does not exist.",
            code="usage",
        )


def missing_file_words(path: Path) -> tuple[str, str]:
    """Return why a path is no file that can be read, and what to do."""
    if path.is_dir():
        return make_message("{path} is a folder, not a file.", path=path), "Name the file in it."
    if path.exists():
        return make_message("{path} is not a plain file.", path=path), "Name a file."
    return make_message("there is no file {path}.", path=path), "Check the name."
