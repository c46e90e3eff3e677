"""Bytes and text of plain files within a limit; devices, pipes and folders are refused and never waited for."""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from cellcal.calibration.documents.errors import DocumentError, NotDownloadedError
from cellcal.calibration.message import make_message

MOST_BYTES = 64_000_000
_PART = 1 << 18
# What a clone or a download holds in place of a large file: git-lfs.com, "spec.md"; git-annex, "pointer files".
_POINTER_STARTS = (b"version https://git-lfs.github.com/spec/", b"/annex/objects/")
_MARKS = (
    (b"\xef\xbb\xbf", "utf-8-sig"),
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)


def describe_unreadable(path: Path, broken: Exception) -> str:
    """Return the sentence that a file cannot be read, and why."""
    return make_message("{path} cannot be read: {broken}", path=path, broken=broken)


def read_plain_bytes(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the bytes of a plain file.

    Raises
    ------
    OSError
        It is not there, a folder, or not readable.
    DocumentError
        It is no plain file, larger than ``most_bytes``, or only points to the file.
    """
    try:
        with open_plain_file(path) as file:
            size, parts, count = os.fstat(file.fileno()).st_size, list[bytes](), 0
            while size <= most_bytes >= count and (part := file.read(_PART)):
                parts.append(part)
                count += len(part)
    except OSError as error:  # of the file that is open already: a disk that fails does not name it
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error
    if max(size, count) > most_bytes:
        raise DocumentError(
            f"it is larger than {_size_text(most_bytes)}.", remedy="Name the right file.", path=path
        )
    content = b"".join(parts)
    refuse_pointer(content, path)
    return content


def refuse_pointer(content: bytes, path: Path | None = None) -> None:
    """Refuse the few lines that stand in a clone where a large file was not fetched.

    Raises
    ------
    NotDownloadedError
        The content is a pointer of Git LFS or git-annex.
    """
    if content.startswith(_POINTER_STARTS):
        raise NotDownloadedError(
            "it only points to the file, which was not downloaded (Git LFS or git-annex).",
            remedy="Fetch the file itself, with git lfs pull or git annex get.",
            path=path,
        )


def open_plain_file(path: Path) -> BinaryIO:
    """Open a plain file to read bytes; raises as `read_plain_bytes`."""
    refuse_unusual_path(path)
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # opening a pipe must not wait
    try:
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
        if not stat.S_ISREG(mode):
            raise DocumentError("it is not a plain file.", remedy="Name a file.", path=path)
    except BaseException:
        os.close(descriptor)
        raise
    return os.fdopen(descriptor, "rb")


def refuse_unusual_path(path: Path) -> None:
    """Refuse a path that is there and neither a plain file nor a folder, and a name that no file can have.

    Raises
    ------
    DocumentError
        It is a device, a pipe or a socket, or holds a zero character.
    """
    try:
        mode = path.stat().st_mode
    except ValueError as error:
        raise DocumentError("that is no name of a file.", remedy="Correct it.", path=path) from error
    except OSError:
        return  # whatever it is, opening it says so
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise DocumentError("it is not a plain file.", remedy="Name a file.", path=path)


def read_plain_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """Return the text of a plain file; see `text_of` for encodings.

    Raises
    ------
    OSError
        It is not there, a folder, or not readable.
    DocumentError
        It is no plain file, larger than ``most_bytes``, or no text.
    """
    return text_of(read_plain_bytes(path, most_bytes), path)


def text_of(content: bytes, path: Path | None = None) -> str:
    """Return bytes as text: UTF-8, or UTF-16 and UTF-32 with a byte order mark.

    Raises
    ------
    DocumentError
        They are no text, hold a zero character, or only point to the file.
    """
    refuse_pointer(content, path)
    encoding = next((name for mark, name in _MARKS if content.startswith(mark)), "utf-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        raise DocumentError(
            f"it is not text in UTF-8 (byte {error.start}).", remedy="Save it as UTF-8.", path=path
        ) from error
    if "\0" in text:
        raise DocumentError(
            "it is not text: it holds a zero character.", remedy="Name a text file.", path=path
        )
    return text


def _size_text(count: int) -> str:
    return f"{count // 1_000_000} MB" if count >= 1_000_000 else f"{count // 1000} kB"
