"""Programs in a folder of this computer, such as a controller's share that is mounted."""

import os
import re
import tempfile
from contextlib import suppress
from pathlib import Path

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, UnreachableError
from cellcal.drivers.wire.cancellation import run_in_thread_to_end

_CHECK = "Check that the folder is mounted and that its files may be read and written."

_DRAFT, _LEFT_S = (
    re.compile(r"\.cellcal[a-z0-9_]{8}"),
    3600.0,
)  # of a file that is being written; surely no more
_DEEPEST, _MOST_FOLDERS, _NAMED_FOLDERS = 4, 200, 6  # levels and folders of one that are looked into; shown


class FolderStore:
    """Files of a folder; a file is replaced in one step, so that a crash leaves the old one or the new one.

    Names count in any case of letters, as on the share of a controller with Windows; a replaced file keeps its name.
    A call that is cancelled ends when its file is written or read: nothing is written after it.
    """

    tells_running = False

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def device(self) -> str:
        return str(self._folder)

    async def list_names(self) -> tuple[str, ...]:
        return await run_in_thread_to_end(self._list_names)

    async def list_folders(self) -> tuple[str, ...]:
        """Return the nearest folders below this one that hold files, a few of them, as paths from here."""
        return await run_in_thread_to_end(self._list_folders)

    async def read_file(self, name: str) -> bytes | None:
        return await run_in_thread_to_end(self._read_file, name)

    async def write_file(self, name: str, content: bytes) -> None:
        await run_in_thread_to_end(self._write_file, name, content)

    async def delete_file(self, name: str) -> None:
        await run_in_thread_to_end(self._delete_file, name)

    async def refuse_while_running(self) -> None:
        """Do nothing: a folder does not say what its robot does."""

    def is_same(self, sent: bytes, read: bytes) -> bool:
        return sent == read

    def _list_names(self) -> tuple[str, ...]:
        try:
            return _file_names(self._folder)
        except OSError as error:
            raise self._unreachable(error) from error

    def _list_folders(self) -> tuple[str, ...]:
        found: list[str] = []
        level = [self._folder]
        try:
            for _ in range(_DEEPEST):
                entries = [entry for folder in level for entry in sorted(folder.iterdir())]
                level = [
                    entry
                    for entry in entries
                    if entry.is_dir() and not entry.is_symlink() and not entry.name.startswith(".")
                ][:_MOST_FOLDERS]
                found += [
                    folder.relative_to(self._folder).as_posix() for folder in level if _file_names(folder)
                ]
        except OSError as error:
            raise self._unreachable(error) from error
        return tuple(found[:_NAMED_FOLDERS])

    def _read_file(self, name: str) -> bytes | None:
        try:
            found = self._find_name(name)
            return None if found is None else read_plain_bytes(self._folder / found)
        except OSError as error:
            raise self._unreachable(error) from error
        except DocumentError as error:  # too large for a program, a pipe or a device
            raise RefusedError(self.device, error.message, remedy=error.remedy) from error

    def _write_file(self, name: str, content: bytes) -> None:
        try:
            target = self._folder / (self._find_name(name) or name)
            descriptor, draft = tempfile.mkstemp(dir=self._folder, prefix=".cellcal")
            try:
                self._remove_left_behind(os.fstat(descriptor).st_mtime)
                with os.fdopen(descriptor, "wb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
                Path(draft).chmod(0o644)
                Path(draft).replace(target)
            finally:
                Path(draft).unlink(missing_ok=True)
        except OSError as error:
            raise self._unreachable(error) from error

    def _remove_left_behind(self, now_s: float) -> None:
        """Remove drafts that a killed process left; ages by the clock of the folder's own computer."""
        for entry in list(self._folder.iterdir()):
            if _DRAFT.fullmatch(entry.name):
                with suppress(OSError):
                    if now_s - entry.lstat().st_mtime > _LEFT_S:
                        entry.unlink()

    def _delete_file(self, name: str) -> None:
        try:
            found = self._find_name(name)
            if found is not None:
                (self._folder / found).unlink(missing_ok=True)
        except OSError as error:
            raise self._unreachable(error) from error

    def _find_name(self, name: str) -> str | None:
        """Return the name under which the folder holds a program, in whatever case of letters; None without one."""
        found = sorted(entry.name for entry in self._folder.iterdir() if entry.name.lower() == name.lower())
        if len(found) > 1:
            raise RefusedError(
                self.device,
                make_message(
                    "{one} and {other} are one program to a controller.", one=found[0], other=found[1]
                ),
                remedy="Delete or rename the one that is not used, then try again.",
            )
        return found[0] if found else None

    def _unreachable(self, error: OSError) -> UnreachableError:
        return UnreachableError(
            self.device,
            make_message("the folder cannot be used: {reason}.", reason=error.strerror or str(error)),
            remedy=_CHECK,
        )


def _file_names(folder: Path) -> tuple[str, ...]:
    names = [entry.name for entry in folder.iterdir() if entry.is_file()]
    return tuple(sorted(name for name in names if not name.startswith(".")))
