"""ZIP archives within limits: what is in one is added up before anything is unpacked."""

import io
import zlib
from zipfile import BadZipFile, ZipFile

from cellcal.calibration.documents.errors import DocumentError

_MOST_ENTRIES = 1000
_MOST_BYTES = 200_000_000  # of all that is in it
_CURE = "Save it again with the program that made it."


def open_zip(content: bytes, *, most_bytes: int = _MOST_BYTES) -> io.BytesIO:
    """Return a ZIP archive to be read by a library, after its sizes were found to be within limits.

    The sizes are counted while every entry is unpacked once, since what the archive says of them may be untrue.

    Raises
    ------
    DocumentError
        It is no ZIP archive, is encrypted or damaged, or unpacks to more than ``most_bytes``.
    """
    source = io.BytesIO(content)
    try:
        with ZipFile(source) as archive:
            entries = archive.infolist()
            if len(entries) > _MOST_ENTRIES or sum(entry.file_size for entry in entries) > most_bytes:
                raise _archive_error("it unpacks to more than can be used")
            remaining_bytes = most_bytes
            for entry in entries:
                with archive.open(entry) as file:
                    while part := file.read(1 << 20):
                        remaining_bytes -= len(part)
                        if remaining_bytes < 0:
                            raise _archive_error("it unpacks to more than can be used")
    except (BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError) as error:
        raise _archive_error(str(error)) from error
    except (ValueError, OverflowError) as error:
        raise error if isinstance(error, DocumentError) else _archive_error(str(error)) from error
    source.seek(0)
    return source


def _archive_error(why: str) -> DocumentError:
    return DocumentError(f"it is no archive that can be used: {why}.", remedy=_CURE)
