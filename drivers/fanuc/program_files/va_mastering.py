"""Mastering data of a backup: $DMR_GRP in SYSMAST.VA and the drives in SYMOTN.VA, held against each other.

link angle = $INTERACTION . (count - $MASTER_COUN): the counts in $MASTER_COUN are those at joint angle zero. Link
angles are not the joints that the pendant shows: joint 2 is counted the other way, and joint 3 is J3 + J2 where the
motor of axis 3 follows axis 2 (seen in a public backup of an R-1000iA with V9.40). $MOSIGN has the signs of the
shown joints.
"""

import math
import re
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.shown_joints import JointConvention
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.va_further_axes import FurtherAxis, read_further_axes
from cellcal.drivers.fanuc.program_files.va_spots import (
    ValueSpot,
    damaged_file_error,
    parse_boolean,
    parse_integer,
    parse_real,
)
from cellcal.drivers.fanuc.program_files.va_text import VaFile, VaVariable

COUNTS_PER_TURN = 2**19  # of every axis on 27 public backups
_TURN_RANGE = range(2**16, 2**24 + 1)  # encoders of other robots than those 27
_TURN_TOLERANCE = 1.0  # counts: seven digits of a scale and of a ratio
_REFERENCE_TOLERANCE = 2.0  # counts
_SEVENTH_DIGIT = 5e-7  # a REAL is printed with seven digits: half of the last one, at worst
_INTERACTION_TOLERANCE = 2e-6  # relative: seven digits of each of the two
MASTERED = 2  # $EACHMST_DON; 0 and 1 both ask for mastering this axis
_STATES = {0: "lost", 1: "lost, only axes coupled with it were mastered"}
_ARM_AXES = 6
_SCALES = ("ENCSCALES", "GEAR_RATIO", "MASTER_POS")


@dataclass(frozen=True, slots=True)
class GroupDrives:
    """What SYMOTN.VA says of the n axes of a group."""

    counts_per_degree: tuple[float, ...]  # $ENCSCALES
    gear_ratio: tuple[float, ...]  # $GEAR_RATIO: joint turns per motor turn
    fixture_deg: tuple[float, ...]  # $MASTER_POS
    reversed: tuple[bool, ...]  # $MOSIGN is FALSE
    radians_per_count: tuple[tuple[float, ...], ...]  # $INTERACTION: angles of the links
    third_follows_second: bool | None = None  # $AXS_COUPLE, $INTRAC_NUM; None: the software has neither

    def sign_sets(self) -> tuple[tuple[int, ...], ...]:
        """Return the signs of shown joints against link angles: by $MOSIGN, and as $INTERACTION has them."""
        diagonal = [self.radians_per_count[axis][axis] for axis in range(len(self.reversed))]
        by_motor = tuple(
            (-1 if away else 1) * (-1 if link < 0 else 1)
            for away, link in zip(self.reversed, diagonal, strict=True)
        )
        return tuple(dict.fromkeys((by_motor, (1,) * len(by_motor))))

    def first_axes(self, axes: int) -> "GroupDrives":
        """Return the first axes alone."""
        return GroupDrives(
            self.counts_per_degree[:axes],
            self.gear_ratio[:axes],
            self.fixture_deg[:axes],
            self.reversed[:axes],
            tuple(row[:axes] for row in self.radians_per_count[:axes]),
            self.third_follows_second,
        )

    def to_shown_drive_train(self, convention: JointConvention) -> DriveTrain:
        """Return the drive train of the joints that the pendant shows."""
        matrix = convention.to_shown_matrix(np.array(self.radians_per_count))
        rows = tuple(tuple(float(value) for value in row) for row in matrix)
        return DriveTrain(rows, self.to_drive_train().counts_per_turn)

    def to_drive_train(self) -> DriveTrain:
        """Return the drive train of the links' angles; counts per motor turn as scale and ratio say.

        Raises
        ------
        CalibrationError
            The interaction matrix is singular.
        """
        return DriveTrain(self.radians_per_count, tuple(round(turn) for turn in self.counts_per_turn()))

    def counts_per_turn(self) -> tuple[float, ...]:
        """Return the counts of one motor turn, as $ENCSCALES * 360 * $GEAR_RATIO says."""
        pairs = zip(self.counts_per_degree, self.gear_ratio, strict=True)
        return tuple(scale * 360 * abs(ratio) for scale, ratio in pairs)


@dataclass(frozen=True, slots=True)
class GroupMastering:
    """One motion group. Counts are those at joint angle zero; the reference is the one for quick mastering."""

    group: int
    mastered: bool
    states: tuple[int, ...]  # $EACHMST_DON: 0 lost, 2 done
    counts_at_zero: tuple[int, ...]
    spots: tuple[ValueSpot, ...]  # where each count stands in SYSMAST.VA
    reference_done: bool
    reference_rad: tuple[float, ...]
    reference_counts: tuple[int, ...]
    drives: GroupDrives | None  # None without SYMOTN.VA, and for groups of other than turning axes
    findings: tuple[str, ...]  # what does not fit, as sentences; empty where all agrees
    pulse_counts: tuple[int, ...] = ()  # $SPC_COUNT; empty where the file does not hold it
    further_axes: tuple[FurtherAxis, ...] = ()  # what follows the arm and does not turn; no record has them

    @property
    def is_valid(self) -> bool:
        """Tell whether the group and each of its axes is mastered."""
        return self.mastered and all(state == MASTERED for state in self.states)

    @property
    def reference_holds(self) -> bool:
        """Tell whether the reference belongs to this mastering, on every axis."""
        return self.reference_done and self.drives is not None and not self.stale_axes()

    def stale_axes(self) -> tuple[int, ...]:
        """Return the axes, from 1, whose reference count is not where this mastering would have it."""
        drives = self.drives
        if drives is None:
            return ()
        at_zero, there = np.array(self.counts_at_zero), np.array(self.reference_counts)
        coupled = np.linalg.solve(np.array(drives.radians_per_count), np.array(self.reference_rad))
        single = np.array(self.reference_rad) / np.diag(np.array(drives.radians_per_count))
        off = np.minimum(np.abs(at_zero + coupled - there), np.abs(at_zero + single - there))
        digits = _SEVENTH_DIGIT * (np.abs(coupled) + np.abs(single))  # of $REF_POS and of $INTERACTION
        return tuple(int(axis) + 1 for axis in np.flatnonzero(off > _REFERENCE_TOLERANCE + digits))


def read_mastering(master: VaFile, motion: VaFile | None) -> dict[int, GroupMastering]:
    """Read the mastering of every group that has axes.

    Raises
    ------
    ProgramFileError
        A file is damaged.
    """
    data = master.read_variable("$DMR_GRP")
    groups = _group_numbers(data)
    drives = None if motion is None else motion.read_variable("$PARAM_GROUP")
    found = {}
    for group in groups:
        axes, drive, why = _read_drives(drives, group) if drives is not None else (0, None, "")
        mastering = _read_group(data, group, axes or _count_axes(data, group), drive)
        if mastering is not None:
            extra = (why,) if why else ()
            further = read_further_axes(drives, data, group, axes) if drives is not None and drive else ()
            found[group] = _with_findings(replace(mastering, further_axes=further), extra)
    return found


def _group_numbers(data: VaVariable) -> range:
    numbers = {int(found[1]) for path in data.values if (found := re.match(r"\$DMR_GRP\[(\d+)\]\.", path))}
    if not numbers or numbers != set(range(1, len(numbers) + 1)):
        raise damaged_file_error(data.file, data.line, "$DMR_GRP holds no groups, or some are missing.")
    return range(1, len(numbers) + 1)


def _count_axes(data: VaVariable, group: int) -> int:
    """Return how many axes have a mastering state or count, where no drives tell it."""
    spots = [data.find_value(f"$DMR_GRP[{group}].$MASTER_COUN[{axis}]") for axis in range(1, 10)]
    live = [spot.is_initialised and parse_integer(data.file, spot) != 0 for spot in spots]
    return 1 + max((axis for axis, lives in enumerate(live) if lives), default=-1)


def _read_group(data: VaVariable, group: int, axes: int, drives: GroupDrives | None) -> GroupMastering | None:
    if axes == 0:
        return None
    head, file, numbers = f"$DMR_GRP[{group}].$", data.file, range(1, axes + 1)

    def read_spots(name: str) -> tuple[ValueSpot, ...]:
        found = tuple(data.find_value(f"{head}{name}[{axis}]") for axis in numbers)
        if not all(spot.is_initialised for spot in found):
            raise damaged_file_error(
                file,
                found[0].line,
                make_message(
                    "{head}{name} is not initialised on an axis that has a motor.", head=head, name=name
                ),
            )
        return found

    counts = read_spots("MASTER_COUN")
    return GroupMastering(
        group=group,
        mastered=parse_boolean(file, data.find_value(f"{head}MASTER_DONE")),
        states=tuple(parse_integer(file, spot) for spot in read_spots("EACHMST_DON")),
        counts_at_zero=tuple(parse_integer(file, spot) for spot in counts),
        spots=counts,
        reference_done=parse_boolean(file, data.find_value(f"{head}REF_DONE")),
        reference_rad=tuple(parse_real(file, spot) for spot in read_spots("REF_POS")),
        reference_counts=tuple(parse_integer(file, spot) for spot in read_spots("REF_COUNT")),
        drives=drives,
        findings=(),
        pulse_counts=_read_pulses(data, head, axes),
    )


def _read_pulses(data: VaVariable, head: str, axes: int) -> tuple[int, ...]:
    spots = [data.values.get(f"{head}SPC_COUNT[{axis}]") for axis in range(1, axes + 1)]
    present = [spot for spot in spots if spot is not None and spot.is_initialised]
    return tuple(parse_integer(data.file, spot) for spot in present) if len(present) == axes else ()


def _read_drives(data: VaVariable, group: int) -> tuple[int, GroupDrives | None, str]:
    """Return the axes of a group and its drives; none, and why, where its axes do not turn."""
    head, file = f"$PARAM_GROUP[{group}].$", data.file

    def read_number(path: str) -> float:
        spot = data.find_value(head + path)
        return parse_real(file, spot) if spot.is_initialised else 0.0

    scales = [read_number(f"ENCSCALES[{axis}]") for axis in range(1, 10)]
    axes = len(list(takewhile(lambda scale: scale != 0, scales)))
    if any(scales[axes:]):
        raise damaged_file_error(
            file,
            data.line,
            make_message("{head}ENCSCALES has a gap: axis {axes} has no scale.", head=head, axes=axes + 1),
        )
    if axes == 0:
        return 0, None, ""
    signs = tuple(
        not parse_boolean(file, data.find_value(f"{head}MOSIGN[{axis}]")) for axis in range(1, axes + 1)
    )
    table = {name: tuple(read_number(f"{name}[{axis}]") for axis in range(1, axes + 1)) for name in _SCALES}
    rows = tuple(
        tuple(read_number(f"INTERACTION[{i}].$INTERACTION[{j}]") for j in range(1, axes + 1))
        for i in range(1, axes + 1)
    )
    drives = GroupDrives(
        table["ENCSCALES"], table["GEAR_RATIO"], table["MASTER_POS"], signs, rows, _read_coupling(data, head)
    )
    return _consistent_drives(drives, group)


def _read_coupling(data: VaVariable, head: str) -> bool | None:
    """Tell whether the motor of axis 3 follows axis 2, as the variables of this software say."""
    for path in (f"{head}AXS_COUPLE[3]", f"{head}INTRAC_NUM[3].$INTRAC_NUM[2]"):
        spot = data.values.get(path)
        if spot is not None and spot.is_initialised:
            return parse_integer(data.file, spot) != 0
    return None


def _consistent_drives(drives: GroupDrives, group: int) -> tuple[int, GroupDrives | None, str]:
    """Leave out extended axes that do not turn; believe the rest where scale, ratio and interaction agree."""
    axes = len(drives.gear_ratio)
    why = _find_contradiction(drives)
    if why and axes > _ARM_AXES and not _find_contradiction(drives.first_axes(_ARM_AXES)):
        remark = f"group {group}: what follows axis {_ARM_AXES} is left out, it does not turn ({why})"
        return _ARM_AXES, drives.first_axes(_ARM_AXES), remark
    if why:
        return axes, None, f"group {group}: {why}; a drive of turning axes cannot be made of that"
    return axes, drives, ""


def _is_whole_turn(counts: float) -> bool:
    """Tell whether a motor turn has as many counts as an encoder of this maker: a power of two."""
    power = 2 ** round(math.log2(counts)) if counts > 1 else 0
    return power in _TURN_RANGE and abs(counts - power) <= _TURN_TOLERANCE * max(1.0, power / COUNTS_PER_TURN)


def _find_contradiction(drives: GroupDrives) -> str:
    """Return why scale, ratio and interaction cannot all be right; "" where they agree."""
    for axis, (turn, scale) in enumerate(
        zip(drives.counts_per_turn(), drives.counts_per_degree, strict=True)
    ):
        if not _is_whole_turn(turn):
            return f"$ENCSCALES * 360 * $GEAR_RATIO of axis {axis + 1} is {turn:.1f} counts, not {COUNTS_PER_TURN}"
        product = abs(drives.radians_per_count[axis][axis]) * np.degrees(1.0) * scale
        if abs(product - 1) > _INTERACTION_TOLERANCE:
            return f"$ENCSCALES and $INTERACTION of axis {axis + 1} differ by {abs(product - 1):.1e} of their size"
    try:
        drives.to_drive_train()
    except CalibrationError as refused:
        return refused.message
    return ""


def _with_findings(group: GroupMastering, extra: tuple[str, ...]) -> GroupMastering:
    """Add what a person must know before these data are trusted."""
    findings = list(extra)
    if not group.mastered:
        findings.append(
            f"group {group.group} was not mastered when the backup was saved ($MASTER_DONE is FALSE)"
        )
    for axis, state in enumerate(group.states, 1):
        if state != MASTERED:
            word = _STATES.get(state, f"in a state {state} that is not known")
            findings.append(f"group {group.group}, axis {axis} was {word} ($EACHMST_DON is {state})")
    findings += [
        f"group {group.group}, axis {each.axis} was {_STATES.get(each.state, 'in an unknown state')} "
        f"($EACHMST_DON is {each.state})"
        for each in group.further_axes
        if each.state != MASTERED
    ]
    if not group.reference_done:
        findings.append(f"group {group.group} has no quick-master reference ($REF_DONE is FALSE)")
    elif group.drives is not None and group.stale_axes():
        axes = ", ".join(map(str, group.stale_axes()))
        findings.append(
            f"group {group.group}: the quick-master reference of axis {axes} is from before the last mastering"
        )
    return replace(group, findings=tuple(findings))
