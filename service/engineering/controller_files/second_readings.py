"""A controller's files read twice: a digit that a link spoilt still makes a valid count, and no file has a checksum.

Counts at zero are bound to the other files to 0.01 deg only (the angles that are shown): some thousand counts of
either are told by nothing but another reading.
"""

from collections.abc import Collection, Sequence

from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.fanuc.controller_files.controller_files import ControllerFiles
from cellcal.drivers.fanuc.controller_files.file_sources import FileSource
from cellcal.drivers.fanuc.program_files.va_backup import DRIVES, MASTERING, FanucBackup, assemble_backup
from cellcal.drivers.fanuc.program_files.va_text import VaFile
from cellcal.service.engineering.controller_files.record_checks import ControllerRecordError

_READ_AGAIN = (
    "Nothing was recorded. Look at the network between, and read it once more while nobody masters the robot."
)


def confirm_mastering(files: ControllerFiles, source: FileSource) -> None:
    """Read mastering and drives of a controller once more, and refuse where they are others now.

    Raises
    ------
    ControllerRecordError
        Two readings contradict each other; the values are named.
    DeviceError, ProgramFileError
        As for the first reading.
    """
    contents = {name: source.read_file(name) for name in (MASTERING, DRIVES)}
    read = {
        name: VaFile.from_bytes(name, content) for name, content in contents.items() if content is not None
    }
    found = _list_differences(files, assemble_backup(source.device, read), set(contents) - set(read))
    if found:
        raise ControllerRecordError(
            files.device,
            make_message(
                "two readings, one right after the other, contradict each other: {differences}.",
                differences=join_messages("; ", found),
            ),
            remedy=_READ_AGAIN,
        )


def _list_differences(files: ControllerFiles, again: FanucBackup, missing: Collection[str]) -> list[str]:
    found = [f"the second has no {name}" for name in sorted(missing)]
    if missing:
        return found
    for group, first in files.variables.mastering.items():
        second = again.mastering.get(group)
        if second is None:
            found.append(f"the second has no group {group} in {MASTERING}")
            continue
        found += _differing_axes(group, "$MASTER_COUN", first.counts_at_zero, second.counts_at_zero)
        found += _differing_axes(group, "$EACHMST_DON", first.states, second.states)
        if first.mastered != second.mastered:
            found.append(f"$MASTER_DONE of group {group} is {first.mastered} and {second.mastered}")
        if first.drives != second.drives:
            found.append(f"{DRIVES} holds other drives of group {group}")
    return found


def _differing_axes(group: int, name: str, first: Sequence[int], second: Sequence[int]) -> list[str]:
    if len(first) != len(second):
        return [f"{name} of group {group} has {len(first)} axes and {len(second)}"]
    return [
        f"{name} of group {group}, axis {axis} is {one} and {other}"
        for axis, (one, other) in enumerate(zip(first, second, strict=True), 1)
        if one != other
    ]
