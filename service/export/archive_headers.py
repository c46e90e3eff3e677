"""The headers of a foreign tar, looked at before a byte is unpacked: only what our own writer writes may stand there.

`tarfile` follows extensions that a backup never has. A sparse file of 1 kB unpacks to a terabyte of zeros, and three
thousand extended headers in a row end in its recursion limit.
"""

import re
import tarfile
from typing import IO

_BLOCK_BYTES = tarfile.BLOCKSIZE
_MOST_EXTENSION_BYTES = 8192  # a path of 512 letters, and a size
_RECORD = re.compile(rb"(\d{1,4}) ([A-Za-z.]{1,40})=")
_KNOWN_KEYS = (b"path", b"size")


def find_odd_header(file: IO[bytes], length: int) -> str:
    """Return what stands in a tar that no backup has; nothing where all is plain.

    Raises
    ------
    tarfile.TarError
        A header cannot be read.
    """
    at, extension = 0, b""
    while at + _BLOCK_BYTES <= length:
        file.seek(at)
        block = file.read(_BLOCK_BYTES)
        if not block.strip(b"\0"):
            break
        header = tarfile.TarInfo.frombuf(block, "utf-8", "surrogateescape")
        size = _size_of(extension, header.size)
        at += _BLOCK_BYTES
        if not 0 <= size <= length - at:
            return f"{header.name!r} is longer than the file"
        if header.type == tarfile.REGTYPE:
            extension = b""
        elif header.type == tarfile.XHDTYPE and not extension and size <= _MOST_EXTENSION_BYTES:
            extension = file.read(size)
            if not extension or any(key not in _KNOWN_KEYS for key in _keys_of(extension)):
                return f"{header.name!r} has an extension that no backup has"
        else:
            return f"{header.name!r} is no plain file"
        at += -(-size // _BLOCK_BYTES) * _BLOCK_BYTES
    return ""


def _keys_of(extension: bytes) -> list[bytes]:
    """Return the keys of an extended header; a record of another form counts as an unknown key."""
    keys, at = [], 0
    while at < len(extension):
        record = _RECORD.match(extension, at)
        if record is None or int(record[1]) == 0:
            return [b""]
        keys.append(record[2])
        at += int(record[1])
    return keys


def _size_of(extension: bytes, plain: int) -> int:
    found = re.search(rb"\d{1,4} size=(\d{1,19})\n", extension)
    return plain if found is None else int(found[1])
