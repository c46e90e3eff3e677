"""Whether a controller's files agree with each other well enough to make a mastering record of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import CellError
from cellcal.calibration.mastering.shown_joints import JointConvention, find_conventions
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.fanuc.controller_files.alarm_report import ControllerAlarm
from cellcal.drivers.fanuc.controller_files.axis_report import AxisReport
from cellcal.drivers.fanuc.controller_files.controller_files import AXES, POSITION, ControllerFiles
from cellcal.drivers.fanuc.program_files.va_backup import DRIVES, MASTERING
from cellcal.drivers.fanuc.program_files.va_drives import GroupDrives
from cellcal.drivers.fanuc.program_files.va_mastering import GroupMastering
from cellcal.drivers.wire.tables import CodeEntry, code_table
from cellcal.service.engineering.controller_files.robot_models import name_model
from cellcal.service.engineering.controller_files.sliding_axes import pulses_by_group

TOLERANCE_DEG = 0.01  # the controller shows hundredths, rounded or cut off
_DIGITS_DEG = 5e-4  # seven printed digits of a scale, over a whole turn
_SRVO = 11_000
_POSITION_KINDS = frozenset(("lost", "index", "encoder"))
_SIX_AXES = 6
_SAGGING, _MOST_SAG_DEG = (2, 3), 0.3
_DISAGREE = (
    "Nothing was recorded. Let the robot stand still and read again; if it stays so, the mastering data were changed "
    "without CALIBRATE, or the files are of different times."
)
_DISAGREE_WITH_POWER = (  # seen in a public backup of an R-2000iC/210L under power: J2 by -0.086, J3 by +0.112 deg
    "Nothing was recorded. Switch the drives off at standstill and read again: under power some controllers hold J2 "
    "and J3 beside the angles that they show. If it stays so, the mastering data were changed without CALIBRATE, or "
    "the files are of different times."
)
_READ_AGAIN = "Let the robot stand still, then read it once more."


FLICKER_COUNTS = 2  # one was seen, in the files of a robot that stood


class ControllerRecordError(CellError):
    """No mastering record can be made of a controller's files."""

    code = "certificate"

    def __init__(self, device: str, message: str, *, remedy: str = "", code: str | None = None) -> None:
        super().__init__(
            make_message("{device}: {message}", device=device, message=message), remedy=remedy, code=code
        )


class HeldBesideAnglesError(ControllerRecordError):
    """Under power J2 and J3 stand beside the angles that are shown, by as little as compensated gravity explains."""


@dataclass(frozen=True, slots=True)
class AngleCheck:
    """Joints from counts beside those that the controller shows."""

    convention: JointConvention
    joints_rad: tuple[float, ...]
    shown_deg: tuple[float, ...]  # empty where no file shows them
    is_compared: bool


def alarm_meaning(alarm: ControllerAlarm) -> CodeEntry | None:
    """Return what an alarm means for the position; None where it means nothing for it."""
    family, _, number = alarm.code.partition("-")
    if family != "SRVO" or not number.isdigit():
        return None
    return code_table("cellcal.drivers.modbus_robot", "alarms.tsv").get(_SRVO + int(number))


def position_alarms(files: ControllerFiles) -> tuple[tuple[ControllerAlarm, CodeEntry], ...]:
    """Return the active alarms that report a lost position or a failing encoder."""
    return tuple(pair for pair in _known_alarms(files) if pair[1].kind in _POSITION_KINDS)


def describe_low_batteries(files: ControllerFiles) -> tuple[str, ...]:
    """Say of each active alarm of a low encoder battery what it means and what to do, without a full stop."""
    low = [pair for pair in _known_alarms(files) if pair[1].kind == "battery_low"]
    return tuple(f"{describe_alarm(*pair)}. {pair[1].remedy}".rstrip(".") for pair in low)


def _known_alarms(files: ControllerFiles) -> list[tuple[ControllerAlarm, CodeEntry]]:
    alarms = () if files.alarms is None else files.alarms.alarms
    return [(alarm, entry) for alarm in alarms if (entry := alarm_meaning(alarm)) is not None]


def describe_alarm(alarm: ControllerAlarm, entry: CodeEntry) -> str:
    """Say an alarm with its axis and its meaning."""
    axis = (
        ""
        if alarm.axis is None
        else f" on J{alarm.axis}" + (f" of group {alarm.group}" if alarm.group != 1 else "")
    )
    return f"{alarm.code}{axis}: {entry.text}"


def choose_groups(files: ControllerFiles, group: int | None) -> tuple[GroupMastering, ...]:
    """Return the mastering of the group that is meant, else of every group that turns.

    Raises
    ------
    ControllerRecordError
        A file is missing, or there is no such group.
    """
    refuse_missing(files, MASTERING, DRIVES)
    groups = files.variables.mastering
    listed = ", ".join(
        f"group {number} with {len(each.counts_at_zero)} axes" for number, each in groups.items()
    )
    if group is None and groups:
        turning = tuple(each for each in groups.values() if len(each.sliding) < len(each.counts_at_zero))
        return turning or tuple(groups.values())
    if group is None or group not in groups:
        raise ControllerRecordError(
            files.device,
            f"group {group or 1} has no axes; there is {listed or 'none'}.",
            remedy="Give the number of a group that has axes with --group.",
            code="usage",
        )
    return (groups[group],)


def refuse_missing(files: ControllerFiles, *names: str) -> None:
    """Refuse where a file without which nothing can be said is not there."""
    absent = [name for name in names if name in files.missing]
    if not absent:
        return
    remedy = (
        "Look on the pendant whether MD: lists it, and whether reading it needs a password."
        if files.is_live
        else "Save a backup with all files (FILE > BACKUP > All of above), or read the controller by its address."
    )
    refused = [f"{name} ({files.not_given[name]})" for name in absent if name in files.not_given]
    if refused:
        raise ControllerRecordError(
            files.device,
            make_message(
                "the controller refuses {refused_files} for now.", refused_files=" and ".join(refused)
            ),
            remedy="Wait until the controller has done with it (a backup, an open editor), then read once more.",
        )
    raise ControllerRecordError(
        files.device, make_message("there is no {unknown}.", unknown=" and no ".join(absent)), remedy=remedy
    )


def refuse_unhealthy(files: ControllerFiles, mastering: GroupMastering) -> None:
    """Refuse files of two times or controllers, a robot that is not mastered, and one with a position alarm."""
    contradictions = files.list_contradictions()
    if contradictions:
        raise ControllerRecordError(
            files.device,
            make_message("{contradictions}.", contradictions=join_messages("; ", contradictions)),
            remedy="Give the files of one backup, whole.",
        )
    if not mastering.is_valid:
        wrong = [text for text in mastering.findings if "reference" not in text]
        raise ControllerRecordError(
            files.device,
            f"the robot is not mastered: {'; '.join(wrong)}.",
            remedy="Master it first; a record must be taken of a healthy robot.",
        )
    alarms = [
        (alarm, entry) for alarm, entry in position_alarms(files) if alarm.group in (None, mastering.group)
    ]
    if alarms:
        raise ControllerRecordError(
            files.device,
            f"its position cannot be trusted: {'; '.join(describe_alarm(*pair) for pair in alarms)}.",
            remedy=alarms[0][1].remedy,
        )


def require_drives(files: ControllerFiles, mastering: GroupMastering) -> GroupDrives:
    """Return the drives of a group; refuse where its variables contradict each other."""
    if mastering.drives is None:
        raise ControllerRecordError(
            files.device,
            f"the drives of group {mastering.group} cannot be read: {'; '.join(mastering.findings)}.",
            remedy="A record is possible of turning axes only; look at $ENCSCALES, $GEAR_RATIO and $INTERACTION.",
        )
    return mastering.drives


def read_pulses(files: ControllerFiles, mastering: GroupMastering) -> tuple[int, ...]:
    """Return the present count of each axis.

    Raises
    ------
    ControllerRecordError
        There are none, or the robot moved while they were read.
    """
    refuse_missing(files, AXES)
    assert files.axes is not None
    pulses = _pulses_of_group(files, files.axes, mastering)
    if files.axes_again is not None:
        again = _pulses_of_group(files, files.axes_again, mastering)
        moved = [
            f"J{axis} by {after - before} counts"
            for axis, (before, after) in enumerate(zip(pulses, again, strict=True), 1)
            if before != after
        ]
        if moved:
            raise ControllerRecordError(
                files.device,
                f"the robot moved while its files were read: {', '.join(moved)}.",
                remedy=_READ_AGAIN,
                code="certificate.moved",
            )
    return pulses


def refuse_other_turns(
    files: ControllerFiles, mastering: GroupMastering, drives: GroupDrives, pulses: Sequence[int]
) -> None:
    """Refuse counts that differ by whole motor turns from those that the controller has noted ($SPC_COUNT).

    The angles that the controller shows come from the same counts: they agree, and are off by these turns, too.
    """
    pairs = zip(mastering.pulse_counts, pulses, drives.counts_per_turn(), strict=False)
    turned = [(axis, _turns_between(*pair)) for axis, pair in enumerate(pairs, 1)]
    if lost := [f"J{axis} by {turns:+d}" for axis, turns in turned if turns]:
        raise ControllerRecordError(
            files.device,
            f"{AXES} counts other motor turns than {MASTERING} has noted ($SPC_COUNT): {', '.join(lost)}. A pulse "
            "coder may have lost turns since.",
            remedy="Compare these axes with their witness marks, and master those that are off. Where none is, save "
            "all files anew and read them again.",
        )


def _turns_between(noted: int, pulse: int, counts_per_turn: float) -> int:
    """Return by how many whole turns counts differ; 0 where it is none, or more than a part of a turn."""
    turns = round((pulse - noted) / counts_per_turn)
    return turns if abs(pulse - noted - turns * counts_per_turn) <= FLICKER_COUNTS else 0


def check_angles(
    files: ControllerFiles, mastering: GroupMastering, drives: GroupDrives, pulses: Sequence[int]
) -> AngleCheck:
    """Compare joints from counts with those that the controller shows, and learn its convention from that.

    Raises
    ------
    ControllerRecordError
        They disagree.
    """
    moved = np.subtract(pulses, mastering.counts_at_zero)
    shown_deg = _read_shown_joints(files, mastering)
    if not shown_deg:
        convention = _convention_by_variables(files, drives)
        joints = convention.to_shown_matrix(np.array(drives.radians_per_count)) @ moved
        return AngleCheck(convention, tuple(map(float, joints)), (), is_compared=False)
    search = find_conventions(
        np.array(drives.radians_per_count),
        drives.sign_sets(),
        [int(count) for count in moved],
        [float(angle) for angle in np.radians(shown_deg)],
        float(np.radians(TOLERANCE_DEG + _DIGITS_DEG)),
    )
    if not search.matching:
        misses = np.degrees(search.misses_rad)
        listed = ", ".join(
            f"J{axis} by {miss:+.3f} deg" for axis, miss in enumerate(misses, 1) if abs(miss) > TOLERANCE_DEG
        )
        has_power = files.axes is not None and bool(files.axes.servo_ready)
        is_sag = has_power and _is_sag([float(miss) for miss in misses])
        kind = HeldBesideAnglesError if is_sag else ControllerRecordError
        raise kind(
            files.device,
            f"the angles from the counts are not those that {POSITION} shows: {listed}.",
            remedy=_DISAGREE_WITH_POWER if has_power else _DISAGREE,
        )
    expected = _expected_coupling(files, drives)
    convention = next(
        (each for each in search.matching if each.third_follows_second == expected), search.matching[0]
    )
    if _is_undecided(search.matching) and expected is None:
        raise ControllerRecordError(
            files.device,
            "whether J3 is counted from J2 cannot be seen while J2 stands at zero.",
            remedy="Jog J2 away from zero by a degree or more, and read again.",
        )
    joints = convention.to_shown_matrix(np.array(drives.radians_per_count)) @ moved
    return AngleCheck(convention, tuple(map(float, joints)), shown_deg, is_compared=True)


def unchecked_angles(files: ControllerFiles, drives: GroupDrives) -> AngleCheck:
    """Return the convention alone, of a backup that does not hold the present counts; as its variables state it."""
    return AngleCheck(_convention_by_variables(files, drives), (), (), is_compared=False)


def _is_sag(misses_deg: Sequence[float]) -> bool:
    """Return whether J2 and J3 alone are off, and by little."""
    return all(
        abs(miss) <= (_MOST_SAG_DEG if axis in _SAGGING else TOLERANCE_DEG)
        for axis, miss in enumerate(misses_deg, 1)
    )


def _expected_coupling(files: ControllerFiles, drives: GroupDrives) -> bool | None:
    """Return whether J3 is counted from J2 by the variables, else by the named model; None: neither tells."""
    if drives.third_follows_second is not None or len(drives.reversed) < _SIX_AXES:
        return drives.third_follows_second
    robots = () if files.version is None else files.version.robots
    model = name_model(robots[0]) if len(robots) == 1 else ""
    return bool(load_model(model).joint_coupling[2, 1]) if model else None


def _is_undecided(matching: Sequence[JointConvention]) -> bool:
    return len({each.third_follows_second for each in matching}) > 1


def _pulses_of_group(
    files: ControllerFiles, report: AxisReport, mastering: GroupMastering
) -> tuple[int, ...]:
    rows = pulses_by_group(files, report)
    if not rows:
        found = " and ".join(str(len(row)) for row in report.pulses)
        raise ControllerRecordError(
            files.device,
            f"{AXES} shows {found} axes, which do not fit the motion groups of {MASTERING}.",
            remedy="Give the files of one backup, whole. Where they are, send both to us: this form is not known.",
        )
    row = rows[mastering.group][: len(mastering.counts_at_zero)]
    pulses = [pulse for pulse in row if pulse is not None]
    if len(pulses) != len(row):
        axes = ", ".join(f"J{axis}" for axis, pulse in enumerate(row, 1) if pulse is None)
        raise ControllerRecordError(
            files.device,
            f"{AXES} shows no count of {axes}.",
            remedy="Look at the encoder's cable and at the alarms on the pendant.",
        )
    return tuple(pulses)


def _read_shown_joints(files: ControllerFiles, mastering: GroupMastering) -> tuple[float, ...]:
    """Return the shown joints; empty where there is no file that tells them."""
    if files.position is None:
        return ()
    found = files.position.find_group(mastering.group)
    axes, shown = len(mastering.counts_at_zero), 0 if found is None else len(found.joints_deg)
    if found is None or shown < axes:
        raise ControllerRecordError(
            files.device,
            f"{POSITION} shows {shown} joints of group {mastering.group}, and {axes} axes are mastered.",
            remedy="Read it from the controller again, whole.",
        )
    angles = [angle for angle in found.joints_deg[:axes] if angle is not None]
    if len(angles) != axes:
        raise ControllerRecordError(
            files.device,
            f"{POSITION} shows stars in place of angles: the controller does not know its position.",
            remedy="Master and calibrate the robot first; a record must be taken of a healthy robot.",
        )
    return tuple(angles)


def _convention_by_variables(files: ControllerFiles, drives: GroupDrives) -> JointConvention:
    """Return the convention that the variables state; refuse where they do not say how J3 is counted."""
    coupled = _expected_coupling(files, drives)
    if coupled is None and len(drives.reversed) > 2:
        raise ControllerRecordError(
            files.device,
            f"{POSITION} is missing, and this software does not say otherwise whether J3 is counted from J2.",
            remedy=f"Add {POSITION} to the backup, or read the controller by its address.",
        )
    return JointConvention(drives.sign_sets()[0], bool(coupled))
