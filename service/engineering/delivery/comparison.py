"""Programs of a controller against those of a folder, and copies of all of them."""

import logging
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces.program_store import ProgramStore, StoreOfFolders
from cellcal.service.engineering.delivery.deliveries import check_each_once, is_same_program
from cellcal.service.files import make_private_folder, replace_file

_LOG = logging.getLogger(__name__)
_MOST_NAMED, _LONGEST_SHOWN = 12, 80
_LONGEST_NAME = 200  # octets; a draft beside the file has a longer one, and 255 are the most
_LEADS_AWAY = re.compile(r"[/\\:\x00-\x1f\x7f]")


class Difference(StrEnum):
    """The difference between a program here and its namesake on the controller."""

    SAME = "same"
    DIFFERS = "differs"
    ONLY_HERE = "only here"
    ONLY_THERE = "only on the controller"


@dataclass(frozen=True, slots=True)
class ComparedProgram:
    """One program."""

    name: str
    difference: Difference


def read_programs(paths: tuple[Path, ...]) -> dict[str, bytes]:
    """Read program files; the programs of a folder are all its files.

    Raises
    ------
    CellError
        One cannot be read, or two have one name.
    """
    files = [
        file
        for path in paths
        for file in (
            sorted(entry for entry in path.iterdir() if entry.is_file() and not entry.name.startswith("."))
            if path.is_dir()
            else [path]
        )
    ]
    check_each_once([file.name for file in files])
    return {file.name: _read_whole(file) for file in files}


def folders_inside(paths: tuple[Path, ...]) -> tuple[str, ...]:
    """Return the folders in which `read_programs` does not look."""
    found = (
        entry.name
        for path in paths
        if path.is_dir()
        for entry in path.iterdir()
        if entry.is_dir() and not entry.name.startswith(".")
    )
    return tuple(sorted(found))


async def fetch_programs(store: ProgramStore, folder: Path) -> dict[str, bytes]:
    """Copy every program of a controller into a folder, and read each back.

    Raises
    ------
    CellError
        There is no program, or a copy cannot be written or reads back as another. Programs are named that the
        controller does not give, or whose names can be none of files in the folder: the others are copied then.
    """
    found: dict[str, bytes] = {}
    not_given: list[str] = []
    listed = await store.list_names()
    if not listed:
        raise await _no_program(store)
    names = _file_names(listed)
    try:
        make_private_folder(folder)
    except OSError as error:
        raise _unwritable(folder, error) from error
    for name in names:
        content = await _read_given(store, name)
        if content is None:
            not_given.append(name)
            continue
        try:
            replace_file(folder / name, content)
        except OSError as error:
            raise _unwritable(folder, error) from error
        if _read_whole(folder / name) != content:
            raise CellError(make_message("{path} is not what was written.", path=folder / name), code="store")
        found[name] = content
    unread = (
        sorted(set(not_given) & set(await store.list_names())) if not_given else []
    )  # the others were deleted
    unnameable = sorted(set(listed) - set(names))
    if unread or unnameable:
        raise _not_copied(store.device, unread, unnameable, len(listed), folder)
    return found


async def compare_programs(store: ProgramStore, here: Mapping[str, bytes]) -> tuple[ComparedProgram, ...]:
    """Compare by content; names count in any case of letters, as controllers take them."""
    names = await store.list_names()
    there = {name.lower(): name for name in names}
    found = []
    for name, content in here.items():
        if name.lower() not in there:
            found.append(ComparedProgram(name, Difference.ONLY_HERE))
            continue
        other = await store.read_file(there[name.lower()])
        same = is_same_program(store, content, other)
        found.append(ComparedProgram(name, Difference.SAME if same else Difference.DIFFERS))
    names_here = {name.lower() for name in here}
    found += [
        ComparedProgram(name, Difference.ONLY_THERE) for name in names if name.lower() not in names_here
    ]
    return tuple(sorted(found, key=lambda each: each.name.lower()))


async def folders_below(store: ProgramStore) -> tuple[str, ...]:
    """Return some folders of a store that ``fetch_programs`` does not copy."""
    return await store.list_folders() if isinstance(store, StoreOfFolders) else ()


async def _read_given(store: ProgramStore, name: str) -> bytes | None:
    try:
        return await store.read_file(name)
    except RefusedError as error:
        _LOG.warning("%s", error)
        return None


def _not_copied(
    device: str, unread: Sequence[str], unnameable: Sequence[str], count: int, folder: Path
) -> CellError:
    names = [
        *(name[:_LONGEST_SHOWN] for name in unread),
        *(repr(name[:_LONGEST_SHOWN]) for name in unnameable),
    ]
    listed = ", ".join(names[:_MOST_NAMED]) + (", …" if len(names) > _MOST_NAMED else "")
    remedies = []
    if unread:
        remedies.append(
            "Look at the pendant whether they are protected or open in the editor, then fetch again."
        )
    if unnameable:
        remedies.append(
            "What stands in quotation marks is no name of a file here, or is one name twice: rename it on the "
            "controller."
        )
    return CellError(
        make_message(
            "{device}: {left} of {count} programs cannot be read and were not copied: {names}. The others are in "
            "{folder}.",
            device=device,
            left=len(names),
            count=count,
            names=listed,
            folder=folder,
        ),
        remedy=join_messages(" ", remedies),
        code="store",
    )


async def _no_program(store: ProgramStore) -> CellError:
    below = await folders_below(store)
    remedy = "Name the folder in which the programs lie, or look at the pendant whether there are any."
    if below:
        remedy = make_message("Files lie below it: {folders}. Name one of these.", folders=", ".join(below))
    return CellError(
        make_message("{device} holds no program.", device=store.device), remedy=remedy, code="store"
    )


def _file_names(names: Sequence[str]) -> list[str]:
    """Return the names without those that lead out of a folder, and those that are one where case does not count."""
    counts = Counter(name.lower() for name in names)
    return [name for name in names if counts[name.lower()] == 1 and _is_file_name(name)]


def _is_file_name(name: str) -> bool:
    try:
        length = len(name.encode())
    except UnicodeEncodeError:  # half a character
        return False
    return name not in ("", ".", "..") and length <= _LONGEST_NAME and not _LEADS_AWAY.search(name)


def _read_whole(path: Path) -> bytes:
    try:
        return read_plain_bytes(path)
    except OSError as error:
        raise CellError(
            make_message("{path} cannot be read: {reason}.", path=path, reason=error.strerror or str(error)),
            remedy="Check the name.",
            code="usage",
        ) from error


def _unwritable(folder: Path, error: OSError) -> CellError:
    return CellError(
        make_message(
            "{path} cannot be written: {strerror}.", path=folder, strerror=error.strerror or str(error)
        ),
        remedy="Give another folder.",
        code="store",
    )
