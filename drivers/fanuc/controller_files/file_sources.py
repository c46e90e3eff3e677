"""Where a controller's files are read from: the controller itself by FTP, or a folder with a backup of it."""

from pathlib import Path
from typing import Protocol

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.backup_file import read_backup_file
from cellcal.drivers.programs.errors import ProgramFileError

MAX_FILE_BYTES = 64 * 2**20
MAX_NAMES = 20_000
PROGRAM_SUFFIX = ".ls"


class FileSource(Protocol):
    """Files of one controller by name, in any case of letters."""

    @property
    def device(self) -> str:
        """Name of the controller in messages."""
        ...

    @property
    def is_live(self) -> bool:
        """Whether each reading asks the controller anew."""
        ...

    def read_file(self, name: str) -> bytes | None:
        """Return the bytes of a file; None where the controller has no such file.

        Raises
        ------
        FileNotGivenError
            It refuses this one for now; others may be read.
        """
        ...

    def list_names(self) -> tuple[str, ...]:
        """Return the names of all files, in lower case."""
        ...


class FolderSource:
    """A backup that was copied into a folder."""

    def __init__(self, folder: str | Path) -> None:
        self._folder = Path(folder)
        self._paths = self._index_folder()

    @property
    def device(self) -> str:
        return str(self._folder)

    @property
    def is_live(self) -> bool:
        return False

    def read_file(self, name: str) -> bytes | None:
        path = self._paths.get(name.lower())
        return None if path is None else read_backup_file(path, MAX_FILE_BYTES)

    def list_names(self) -> tuple[str, ...]:
        return tuple(sorted(self._paths))

    def _index_folder(self) -> dict[str, Path]:
        try:
            entries = sorted(entry for entry in self._folder.iterdir() if not entry.is_dir())
        except OSError as error:
            raise ProgramFileError(
                str(self._folder),
                make_message("the folder cannot be read: {strerror}.", strerror=error.strerror),
                remedy="Give the folder that holds the controller's .VA files, unpacked.",
            ) from error
        found: dict[str, Path] = {}
        for entry in entries:
            if entry.name.lower() in found:
                raise ProgramFileError(
                    str(self._folder),
                    make_message(
                        "{found_name} and {entry_name} are the same file to a controller.",
                        found_name=found[entry.name.lower()].name,
                        entry_name=entry.name,
                    ),
                    remedy="Leave one backup in the folder.",
                )
            found[entry.name.lower()] = entry
        return found
