"""One file of a controller's backup, as it lies in a folder."""

from pathlib import Path

from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError


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
