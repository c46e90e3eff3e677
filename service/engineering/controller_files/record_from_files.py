"""``cellcal mastering record``: a mastering record from a FANUC controller's files, once they agree."""

from collections.abc import Sequence
from dataclasses import dataclass

from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.drivers.fanuc.controller_files.controller_files import (
    ALARMS,
    AXES,
    POSITION,
    SAFETY,
    VERSION,
    ControllerFiles,
)
from cellcal.drivers.fanuc.program_files.va_backup import FRAMES, MASTERING
from cellcal.drivers.fanuc.program_files.va_mastering import GroupMastering
from cellcal.procedures.recovery.record_seal import seal_record
from cellcal.service.engineering.controller_files.other_axes import find_other_axes, name_axis
from cellcal.service.engineering.controller_files.record_checks import (
    FLICKER_COUNTS,
    AngleCheck,
    ControllerRecordError,
    check_angles,
    choose_groups,
    describe_low_batteries,
    read_pulses,
    refuse_other_turns,
    refuse_unhealthy,
    require_drives,
    unchecked_angles,
)
from cellcal.service.engineering.controller_files.robot_models import name_model
from cellcal.service.engineering.controller_files.sliding_axes import SlidingAxis, find_sliding_axes

_FEWEST_OF_ARM = 4  # axes
TAKEN_BY = "controller files 1"
_NEVER_CHECKED = (
    "lengths and places: lost turns cannot be found with this record alone",
    "whose arm it is: the files hold the number of the controller, not a plate on the arm",
    "the mastering itself: the record keeps it as it was found",
    "this way of reading on a robot: so far it was confirmed on files of public backups only",
)


@dataclass(frozen=True, slots=True)
class AxisRow:
    """One axis of the table."""

    axis: int
    pulse: int | None  # None where the files hold no present counts
    count_at_zero: int
    mastered: bool
    angle_rad: float | None
    shown_deg: float | None


@dataclass(frozen=True, slots=True)
class FilesRecord:
    """A record, and how far its files were checked; sentences without a full stop."""

    device: str
    group: int
    robot: str  # the maker's name of it, "" where no file tells it
    rows: tuple[AxisRow, ...]
    record: MasteringRecord
    checked: tuple[str, ...]
    not_checked: tuple[str, ...]
    findings: tuple[str, ...]
    sliding: tuple[SlidingAxis, ...] = ()  # of this group, and of groups without a record


@dataclass(frozen=True, slots=True)
class FilesRecords:
    """The records of a controller's groups, and why others have none."""

    records: tuple[FilesRecord, ...]
    refused: tuple[ControllerRecordError, ...]


def make_records(
    files: ControllerFiles, *, group: int | None = None, model: str | None = None, serial: str | None = None
) -> FilesRecords:
    """Make a mastering record of one motion group, or of each whose axes turn; none where the files disagree.

    Raises
    ------
    ControllerRecordError
        No record can be made: a file is missing, the robot is not mastered or moved, or the files disagree.
    """
    chosen = choose_groups(files, group)
    if model is not None and len(chosen) > 1:
        listed = ", ".join(str(each.group) for each in chosen)
        raise ControllerRecordError(
            files.device,
            f"--model names one robot, and groups {listed} get a record each.",
            remedy="Say with --group whose model it is.",
            code="usage",
        )
    records: list[FilesRecord] = []
    refused: list[ControllerRecordError] = []
    own = [each.group for each in chosen]
    for mastering in chosen:
        try:
            records.append(_make_record(files, mastering, RecordNames(model, serial, own)))
        except ControllerRecordError as error:
            refused.append(error)
    if not records:
        raise refused[0]
    return FilesRecords(tuple(records), tuple(refused))


@dataclass(frozen=True, slots=True)
class RecordNames:
    """The caller's names of a robot, and the groups that have records of their own."""

    model: str | None
    serial: str | None
    groups: Sequence[int]


def _make_record(files: ControllerFiles, mastering: GroupMastering, names: RecordNames) -> FilesRecord:
    refuse_unhealthy(files, mastering)
    drives = require_drives(files, mastering)
    is_without_counts = AXES in files.missing and not files.is_live  # as in backups of older software
    pulses = () if is_without_counts else read_pulses(files, mastering)
    refuse_other_turns(files, mastering, drives, pulses)
    angles = (
        unchecked_angles(files, drives)
        if is_without_counts
        else check_angles(files, mastering, drives, pulses)
    )
    differs = _differs_without_motion(files, mastering, pulses)
    if differs and not angles.is_compared:
        raise ControllerRecordError(
            files.device,
            f"{differs}, and {POSITION} shows no joints of this group: the files may be of two moments.",
            remedy="Give the files of one backup, whole.",
        )
    number = names.serial or files.serial
    if not number:
        raise ControllerRecordError(
            files.device,
            "no file tells the number of the robot (F Number).",
            remedy="Give it with --serial, as on the plate of the controller.",
            code="usage",
        )
    robot = _name_robot(files, mastering)
    others = [each for each in names.groups if each != mastering.group]
    record = MasteringRecord(
        robot_serial=number,
        model=names.model or name_model(robot) or robot or "unknown",
        epoch=0,
        drive=drives.to_shown_drive_train(angles.convention),
        counts_at_zero=mastering.counts_at_zero,
        reference_joints_rad=angles.joints_rad,
        reference_counts=pulses,
        captures=(),
        wire=None,
        prior=None,
        taken_by=TAKEN_BY,
        sha256="",
    )
    sliding = find_sliding_axes(files, [each for each in files.variables.mastering if each not in others])
    return FilesRecord(
        device=files.device,
        group=mastering.group,
        robot=robot,
        rows=_table_rows(mastering, pulses, angles),
        record=seal_record(record),
        checked=(*_list_checked(files, mastering, pulses, angles), *_sentences(sliding, agrees=True)),
        not_checked=(
            *_list_not_checked(files, angles),
            *_sentences(sliding, agrees=None),
            *_NEVER_CHECKED,
        ),
        findings=(*_sentences(sliding, agrees=False), *_list_findings(files, mastering, pulses, others)),
        sliding=sliding,
    )


def _name_robot(files: ControllerFiles, mastering: GroupMastering) -> str:
    """Return the maker's name of a group's robot; "" for a positioner, and where it is not told which one it is."""
    names = () if files.version is None else files.version.robots
    if mastering.group != 1 and (len(names) != 1 or len(mastering.counts_at_zero) < _FEWEST_OF_ARM):
        return ""
    return names[0] if names else ""


def _sentences(sliding: Sequence[SlidingAxis], *, agrees: bool | None) -> tuple[str, ...]:
    return tuple(each.sentence for each in sliding if each.agrees is agrees)


def _table_rows(
    mastering: GroupMastering, pulses: tuple[int, ...], angles: AngleCheck
) -> tuple[AxisRow, ...]:
    nothing = (None,) * len(mastering.counts_at_zero)
    columns = (
        pulses or nothing,
        mastering.counts_at_zero,
        angles.joints_rad or nothing,
        angles.shown_deg or nothing,
    )
    return tuple(
        AxisRow(axis, pulse, zero, mastered=True, angle_rad=angle, shown_deg=shown_deg)
        for axis, (pulse, zero, angle, shown_deg) in enumerate(zip(*columns, strict=True), 1)
    )


def _list_checked(
    files: ControllerFiles, mastering: GroupMastering, pulses: tuple[int, ...], angles: AngleCheck
) -> tuple[str, ...]:
    found = [
        "every axis is mastered, and no alarm speaks of a lost position"
        if files.alarms
        else "every axis is mastered"
    ]
    turns = sorted({round(turn) for turn in mastering.drives.counts_per_turn()}) if mastering.drives else []
    counts = " or ".join(map(str, turns))
    found.append(
        f"scale, gear ratio and interaction of each axis agree, and a motor turn has {counts} counts"
    )
    if files.axes_again is not None:
        found.append(f"the robot stood still: {AXES} showed the same counts before and after {POSITION}")
    if angles.is_compared:
        coupled = ", J3 counted from J2" if angles.convention.third_follows_second else ""
        found.append(f"the angles from the counts are those that {POSITION} shows, within 0.01 deg{coupled}")
    if mastering.pulse_counts == pulses:
        found.append(f"{MASTERING} holds the same counts as {AXES} ($SPC_COUNT)")
    elif _is_flicker(mastering, pulses):
        found.append(f"{MASTERING} holds the counts of {AXES} within {FLICKER_COUNTS} ($SPC_COUNT)")
    return tuple(found)


def _is_flicker(mastering: GroupMastering, pulses: tuple[int, ...]) -> bool:
    """Return whether two files hold the same counts but for the last digit of an encoder that stands."""
    pairs = zip(mastering.pulse_counts, pulses, strict=False)
    return bool(mastering.pulse_counts and pulses) and all(abs(a - b) <= FLICKER_COUNTS for a, b in pairs)


def _differs_without_motion(
    files: ControllerFiles, mastering: GroupMastering, pulses: tuple[int, ...]
) -> str:
    """Return that two files hold other counts of a robot that cannot move by itself; "" where they do not."""
    differs = bool(mastering.pulse_counts and pulses) and not _is_flicker(mastering, pulses)
    if differs and files.axes is not None and files.axes.servo_ready is False:
        return f"{MASTERING} holds other counts than {AXES} ($SPC_COUNT), although the drives are off"
    return ""


def _list_not_checked(files: ControllerFiles, angles: AngleCheck) -> tuple[str, ...]:
    has_counts = AXES not in files.missing
    gaps = {
        f"where the robot stood, and the angles from its counts: there is no {AXES}": not has_counts,
        f"the angles: {POSITION} does not show the joints of this group": has_counts
        and not angles.is_compared,
        "whether the robot stood still: a backup holds its counts once": has_counts
        and files.axes_again is None,
        f"the alarms: there is no {ALARMS}": files.alarms is None,
        f"frames and tools: there is no {FRAMES}": FRAMES in files.missing,
        f"the safety settings (DCS): there is no {SAFETY}, or it holds no signature numbers": not files.safety,
        "the programs: there is no listing (.LS) of one": files.programs == {},
        f"robot and software: there is no {VERSION}": VERSION in files.missing,
        "the age of the files: their date cannot be read": files.written is None,
    }
    return tuple(sentence for sentence, is_open in gaps.items() if is_open)


def _list_findings(
    files: ControllerFiles, mastering: GroupMastering, pulses: tuple[int, ...], others: Sequence[int]
) -> tuple[str, ...]:
    found = [*describe_low_batteries(files), *mastering.findings]
    if differs := _differs_without_motion(files, mastering, pulses):
        found.append(differs)
    if other := find_other_axes(files, mastering.group, *others):
        counts = [
            f"{name_axis(name)} ({count}{'' if mastered else ', not mastered'})"
            for name, (count, mastered) in other.items()
        ]
        found.append(f"not in this record, the watch compares their master counts alone: {', '.join(counts)}")
    return tuple(found)
