"""One file of a controller's backup, as it lies in a folder."""

from pathlib import Path

from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError

_MOST_REPORT_BYTES = 2**20


def read_backup_file(path: Path, most_bytes: int) -> bytes:
    """Return the content; raise ProgramFileError where it cannot be read or is larger."""
    try:
        return read_plain_bytes(path, most_bytes)
    except OSError as error:
        raise ProgramFileError(
            path.name,
            make_message("it cannot be read: {strerror}.", strerror=error.strerror),
            remedy="Copy the backup again.",
        ) from error


def read_report_in(folder: Path, name: str) -> bytes | None:
    """Return the bytes of a report (.DG) in a backup's folder, named in any case; None where there is none.

    Raises
    ------
    ProgramFileError
        It cannot be read, or is larger than any report.
    """
    found = next((path for path in folder.iterdir() if path.name.upper() == name), None)
    return None if found is None else read_backup_file(found, _MOST_REPORT_BYTES)
