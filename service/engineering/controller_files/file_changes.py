"""What differs between a controller's files and its newest record: a loss, mastering, frames, programs."""

from collections.abc import Collection, Mapping, Sequence
from datetime import datetime

import numpy as np

from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.shown_joints import list_conventions
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.controller_files.controller_files import ControllerFiles
from cellcal.drivers.fanuc.controller_files.program_digests import UNREAD_DIGEST
from cellcal.drivers.fanuc.controller_files.version_report import is_edition
from cellcal.drivers.fanuc.program_files.va_backup import DRIVES, FRAMES, MASTERING
from cellcal.drivers.fanuc.program_files.va_mastering import GroupMastering
from cellcal.service.engineering.controller_files.file_change import ChangeKind, FileChange, list_some
from cellcal.service.engineering.controller_files.other_axes import compare_other_axes
from cellcal.service.engineering.controller_files.record_checks import (
    ControllerRecordError,
    HeldBesideAnglesError,
    check_angles,
    describe_alarm,
    describe_low_batteries,
    position_alarms,
    read_pulses,
    require_drives,
)
from cellcal.service.engineering.controller_files.stored_records import (
    ControllerContent,
    Numbers,
    StoredRecord,
    controller_content,
)

_SAME_DRIVE = 2e-6  # relative: seven printed digits
_PARTS_OF_BASE = frozenset(("Mastering", "Robot", "Other"))  # not in older software
_COVERED_BY_SIGNATURE = {"Pos./Speed": " (zones, models, tools and frames of the position and speed check)"}


def compare_files(
    files: ControllerFiles,
    last: StoredRecord,
    earlier: Sequence[StoredRecord] = (),
    recorded_groups: Collection[int] = (),
) -> tuple[FileChange, ...]:
    """Return what differs from the newest record; ``earlier`` are older records of the same robot.

    Groups in ``recorded_groups`` have records of their own: their axes are compared with those.
    """
    if files.serial and files.serial != last.record.robot_serial:
        present = _in_brackets(controller_content(files, last.controller.group))
        recorded = f"{last.record.robot_serial}{_in_brackets(last.controller)}"
        text = (
            f"controller {files.serial} answers{present}, the record is of {recorded}; see whether the address is "
            "another controller's now, or take a new record"
        )
        return (FileChange(ChangeKind.OTHER_ROBOT, text),)
    mastering = files.variables.mastering.get(last.controller.group)
    if mastering is None:
        absent = f"{MASTERING} holds no mastering of group {last.controller.group}"
        return (*_find_losses(files, None), FileChange(ChangeKind.CONTRADICTION, absent))
    now = controller_content(files, last.controller.group)
    found = [
        *_find_losses(files, mastering),
        *_compare_counts(mastering, last, earlier),
        *_compare_drives(mastering, last.record),
        *compare_other_axes(
            last.controller.other_axes,
            now.other_axes,
            set(recorded_groups) - {last.controller.group},
        ),
        *_find_contradiction(files, mastering, last),
        *(FileChange(ChangeKind.BATTERY, text) for text in describe_low_batteries(files)),
        *_compare_frames(ChangeKind.FRAME, last.controller.frames, now.frames, files),
        *_compare_frames(ChangeKind.TOOL, last.controller.tools, now.tools, files),
        *compare_safety(last.controller.safety, now.safety),
        *_compare_programs(last.controller.programs, now.programs),
        *_compare_rest(last.controller, now),
    ]
    return tuple(sorted(found, key=lambda change: list(ChangeKind).index(change.kind)))


def _in_brackets(content: ControllerContent) -> str:
    return f" ({content.robot})" if content.robot else ""


def describe_shift(record: MasteringRecord, counts: Sequence[int]) -> str:
    """Say by how much counts at zero differ, axis by axis, in counts, motor turns and degrees."""
    if len(counts) != len(record.counts_at_zero):
        return f"{len(counts)} axes are mastered, the record has {len(record.counts_at_zero)}"
    moved = np.subtract(counts, record.counts_at_zero)
    joints_deg = np.degrees(record.drive.to_joints(np.zeros(len(moved)), moved))
    parts = []
    for axis in np.flatnonzero(moved):
        turns = moved[axis] / record.drive.counts_per_turn[axis]
        whole = f", {round(turns):+d} turns of the motor" if float(turns).is_integer() else ""
        parts.append(f"J{axis + 1} by {int(moved[axis]):+d} counts ({joints_deg[axis]:+.3f} deg{whole})")
    return ", ".join(parts)


def _find_losses(files: ControllerFiles, mastering: GroupMastering | None) -> list[FileChange]:
    pairs = position_alarms(files)
    texts = [describe_alarm(*pair) for pair in pairs]
    if mastering is not None and not mastering.mastered:
        texts.append("the controller holds no mastering ($MASTER_DONE is FALSE)")
    if mastering is not None and not mastering.is_valid:
        texts += [text for text in mastering.findings if "$EACHMST_DON" in text]
    return [FileChange(ChangeKind.LOSS, text) for text in dict.fromkeys(texts)]


def _compare_counts(
    mastering: GroupMastering, last: StoredRecord, earlier: Sequence[StoredRecord]
) -> list[FileChange]:
    counts = mastering.counts_at_zero
    if counts == last.record.counts_at_zero:
        return []
    shift = describe_shift(last.record, counts)
    old = next((each for each in reversed(earlier) if each.record.counts_at_zero == counts), None)
    if old is not None:
        text = f"the mastering is that of {old.day} again, not the newest one of {last.day}: {shift}"
        return [FileChange(ChangeKind.OLD_BACKUP, text)]
    return [FileChange(ChangeKind.MASTERING, f"the mastering differs from the record of {last.day}: {shift}")]


def _compare_drives(mastering: GroupMastering, record: MasteringRecord) -> list[FileChange]:
    """Say where joints turn by another angle a count than in the record: the same counts are other places then."""
    drives = mastering.drives
    if drives is None or len(drives.reversed) != len(record.counts_at_zero):
        return []  # told as a contradiction, or by the counts
    before = np.array(record.drive.radians_per_count)
    trains = [drives.to_shown_drive_train(each) for each in list_conventions(drives.sign_sets())]
    scale = np.abs(before).max(axis=1, keepdims=True)
    off = [np.abs(np.array(each.radians_per_count) - before) / scale > _SAME_DRIVE for each in trains]
    turns = trains[0].counts_per_turn != record.drive.counts_per_turn
    nearest = min(off, key=np.count_nonzero).any(axis=1)
    axes = ", ".join(f"J{axis + 1}" for axis in np.flatnonzero(nearest))
    text = (
        f"scale, gear ratio, sign or interaction of {axes or 'a motor'} differ from the record: "
        "the same counts are other angles"
    )
    return [FileChange(ChangeKind.DRIVES, text)] if axes or turns else []


def describe_uncompared_angles(files: ControllerFiles, last: StoredRecord) -> str:
    """Say why shown angles cannot be compared with counts although the mastering is unchanged; "" if they can.

    Under power some controllers hold J2 and J3 beside the angles that they show.
    """
    mastering = files.variables.mastering.get(last.controller.group)
    if mastering is None or not _is_held_beside(_angle_error(files, mastering), mastering, last):
        return ""
    return "the shown angles of J2 and J3, which are held beside their counts under power"


def _find_contradiction(
    files: ControllerFiles, mastering: GroupMastering, last: StoredRecord
) -> list[FileChange]:
    """Say where files of a mastered robot disagree.

    A robot that moves in production is no contradiction, nor is one that is held beside the shown angles under power
    while its mastering is that of the record.
    """
    texts = list(files.list_contradictions())
    error = None if texts else _angle_error(files, mastering)
    is_beside = _is_held_beside(error, mastering, last)
    if error is not None and not is_beside and not error.code.endswith("moved"):
        texts.append(error.message.removeprefix(f"{files.device}: ").rstrip("."))
    return [FileChange(ChangeKind.CONTRADICTION, text) for text in texts]


def _is_held_beside(
    error: ControllerRecordError | None, mastering: GroupMastering, last: StoredRecord
) -> bool:
    return isinstance(error, HeldBesideAnglesError) and mastering.counts_at_zero == last.record.counts_at_zero


def _angle_error(files: ControllerFiles, mastering: GroupMastering) -> ControllerRecordError | None:
    if not mastering.is_valid or files.axes is None or DRIVES in files.missing:
        return None
    try:
        drives = require_drives(files, mastering)
        check_angles(files, mastering, drives, read_pulses(files, mastering))
    except ControllerRecordError as error:
        return error
    return None


def _compare_frames(
    kind: ChangeKind, before: Mapping[str, Numbers], now: Mapping[str, Numbers], files: ControllerFiles
) -> list[FileChange]:
    found: list[FileChange] = []
    if FRAMES in files.missing:
        return found
    for number in sorted({*before, *now}, key=int):
        old, new = before.get(number), now.get(number)
        if old == new:
            continue
        if old is None or new is None:
            text = make_message(
                "{kind} {number} {detail}",
                kind=kind,
                number=number,
                detail="was set" if old is None else "is no longer there",
            )
        else:
            parts = [f"{n} {a:.3f} to {b:.3f}" for n, a, b in zip("XYZWPR", old, new, strict=True) if a != b]
            text = f"{kind} {number}: {', '.join(parts)} (mm, deg)"
        found.append(FileChange(kind, text))
    return found


def compare_safety(before: Mapping[str, int] | None, now: Mapping[str, int] | None) -> list[FileChange]:
    """Name what changed of the safety settings; a sum of others says nothing that they do not."""
    if not before or not now:
        return []
    sums = {"Total", "Base"} if _PARTS_OF_BASE & before.keys() & now.keys() else {"Total"}
    changed = [name for name in before if name not in sums and now.get(name, before[name]) != before[name]]
    return [
        FileChange(
            ChangeKind.SAFETY,
            f"signature of {name} {before[name]} is {now[name]} now{_COVERED_BY_SIGNATURE.get(name, '')}",
        )
        for name in changed
    ]


def _compare_programs(before: Mapping[str, str] | None, now: Mapping[str, str] | None) -> list[FileChange]:
    if before is None or now is None:
        return []
    unread = {
        name for programs in (before, now) for name, digest in programs.items() if digest == UNREAD_DIGEST
    }
    before, now = (
        {name: digest for name, digest in programs.items() if name not in unread}
        for programs in (before, now)
    )
    groups = {
        "changed": sorted(name for name in before.keys() & now.keys() if before[name] != now[name]),
        "new": sorted(now.keys() - before.keys()),
        "gone": sorted(before.keys() - now.keys()),
    }
    return [
        FileChange(ChangeKind.PROGRAM, f"{word}: {list_some(names)}")
        for word, names in groups.items()
        if names
    ]


def _compare_rest(before: ControllerContent, now: ControllerContent) -> list[FileChange]:
    found = []
    comparable = is_edition(before.software) == is_edition(now.software)  # a cut report tells no edition
    if comparable and before.software and now.software and before.software != now.software:
        found.append(FileChange(ChangeKind.SOFTWARE, f"software {before.software} is {now.software} now"))
    if before.written and now.written:
        earlier = datetime.fromisoformat(now.written) < datetime.fromisoformat(before.written)
        if earlier:
            text = (
                f"its files are of {now.written[:16]}, older than those of the record ({before.written[:16]})"
            )
            found.append(FileChange(ChangeKind.CLOCK, text))
    return found
