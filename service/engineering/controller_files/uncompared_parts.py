"""What a record holds and one reading of the controller does not: it is named, and such a look is not "unchanged"."""

from cellcal.drivers.fanuc.controller_files.controller_files import (
    ALARMS,
    AXES,
    POSITION,
    SAFETY,
    VERSION,
    ControllerFiles,
)
from cellcal.drivers.fanuc.controller_files.program_digests import UNREAD_DIGEST
from cellcal.drivers.fanuc.controller_files.version_report import is_edition
from cellcal.drivers.fanuc.program_files.va_backup import DRIVES, FRAMES
from cellcal.service.engineering.controller_files.file_change import list_some
from cellcal.service.engineering.controller_files.stored_records import StoredRecord

_CONTENTS = {
    DRIVES: "gears and scales",
    AXES: "present counts",
    POSITION: "shown angles",
    ALARMS: "alarms",
    VERSION: "software",
    SAFETY: "safety settings (DCS)",
    FRAMES: "frames and tools",
}


def list_absent_parts(files: ControllerFiles, last: StoredRecord) -> tuple[str, ...]:
    """Return what the record was made with and this reading does not give, as parts of a sentence."""
    names = _files_of(last)
    parts = [
        f"{content} (no {name})"
        for name, content in _CONTENTS.items()
        if name in names and name in files.missing and name not in files.not_given
    ]
    parts += [f"{name} (refused: {reason})" for name, reason in files.not_given.items() if name in _CONTENTS]
    unsigned = (last.controller.safety or {}).keys() - (files.safety or {}).keys()
    if unsigned and SAFETY not in files.missing:
        parts.append(f"DCS signatures of {list_some(sorted(unsigned))}")
    if last.controller.programs and files.lists_nothing:
        parts.append("programs (no list of files)")
    edition = files.version.software if files.version is not None else ""
    if files.version is not None and is_edition(last.controller.software) and not is_edition(edition):
        parts.append(f"software edition (not in {VERSION}: it is not whole)")
    if not files.serial:
        parts.append("which controller it is (no F number)")
    return tuple(parts)


def list_unread_programs(files: ControllerFiles) -> tuple[str, ...]:
    """Return the programs that the controller names and does not give, as one part of a sentence; often none."""
    programs = [name for name, digest in (files.programs or {}).items() if digest == UNREAD_DIGEST]
    return (f"programs that were not given: {list_some(sorted(programs))}",) if programs else ()


def _files_of(last: StoredRecord) -> frozenset[str]:
    """Return the files that the record was made with; of an older record those that its content shows."""
    if last.controller.files is not None:
        return frozenset(last.controller.files)
    signs = {
        DRIVES: True,
        ALARMS: True,
        AXES: bool(last.record.reference_counts),
        VERSION: bool(last.controller.software),
        SAFETY: bool(last.controller.safety),
        FRAMES: bool(last.controller.frames),
    }
    return frozenset(name for name, is_shown in signs.items() if is_shown)
