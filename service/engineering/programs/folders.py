"""What stands in a folder of programs, at any depth."""

from pathlib import Path

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError

_MOST_PATHS = 100_000  # the whole backup of a line has some ten thousand files


def paths_below(folder: Path) -> list[Path]:
    """Return all files and folders below a folder, sorted.

    Raises
    ------
    ProgramFileError
        There are more than any backup has: it is a disk or a home, and would be read for hours.
    """
    found: list[Path] = []
    for path in folder.rglob("*"):
        found.append(path)
        if len(found) > _MOST_PATHS:
            raise ProgramFileError(
                str(folder),
                make_message("more than {count} files are below this folder.", count=_MOST_PATHS),
                remedy="Name the folder of the programs.",
            )
    return sorted(found)
