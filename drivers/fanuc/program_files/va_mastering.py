"""Mastering data of a backup: $DMR_GRP in SYSMAST.VA and the drives in SYMOTN.VA, held against each other.

link angle = $INTERACTION . (count - $MASTER_COUN): the counts in $MASTER_COUN are those at joint angle zero. Link
angles are not the joints that the pendant shows: joint 2 is counted the other way, and joint 3 is J3 + J2 where the
motor of axis 3 follows axis 2 (seen in a public backup of an R-1000iA with V9.40). $MOSIGN has the signs of the
shown joints.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.va_drives import GroupDrives, ReadDrives, read_drives
from cellcal.drivers.fanuc.program_files.va_further_axes import FurtherAxis, read_further_axes
from cellcal.drivers.fanuc.program_files.va_spots import (
    ValueSpot,
    damaged_file_error,
    parse_boolean,
    parse_integer,
    parse_real,
)
from cellcal.drivers.fanuc.program_files.va_text import VaFile, VaVariable

_REFERENCE_TOLERANCE = 2.0  # counts
_SEVENTH_DIGIT = 5e-7  # a REAL is printed with seven digits: half of the last one, at worst
MASTERED = 2  # $EACHMST_DON; 0 and 1 both ask for mastering this axis
_UNMASTERED = {  # what a state says of an axis
    0: "group {group}, axis {axis} was lost ($EACHMST_DON is {state})",
    1: "group {group}, axis {axis} was lost, only axes coupled with it were mastered ($EACHMST_DON is {state})",
}
_UNKNOWN_STATE = "group {group}, axis {axis} was in an unknown state ($EACHMST_DON is {state})"


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
    further_axes: tuple[FurtherAxis, ...] = ()  # what follows those of a record; no record has them
    sliding: Mapping[int, float] = field(default_factory=dict)  # counts per mm of axes, from 1, that slide

    @property
    def is_valid(self) -> bool:
        """Return whether the group and each of its axes is mastered."""
        return self.mastered and all(state == MASTERED for state in self.states)

    @property
    def reference_holds(self) -> bool:
        """Return whether the reference belongs to this mastering, on every axis."""
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
        read = ReadDrives(0, None) if drives is None else read_drives(drives, group)
        mastering = _read_group(data, group, read.axes or _count_axes(data, group), read.drives)
        if mastering is not None:
            extra = (read.remark,) if read.remark else ()
            further = read_further_axes(drives, data, group, read.axes) if drives and read.drives else ()
            found[group] = _with_findings(
                replace(mastering, further_axes=further, sliding=read.sliding), extra
            )
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


def _with_findings(group: GroupMastering, extra: tuple[str, ...]) -> GroupMastering:
    """Add what a person must know before these data are trusted."""
    findings = list(extra)
    if not group.mastered:
        findings.append(
            make_message(
                "group {group} was not mastered when the backup was saved ($MASTER_DONE is FALSE)",
                group=group.group,
            )
        )
    states = [*enumerate(group.states, 1), *((each.axis, each.state) for each in group.further_axes)]
    findings += [
        make_message(_UNMASTERED.get(state, _UNKNOWN_STATE), group=group.group, axis=axis, state=state)
        for axis, state in states
        if state != MASTERED
    ]
    if not group.reference_done:
        findings.append(
            make_message(
                "group {group} has no quick-master reference ($REF_DONE is FALSE)", group=group.group
            )
        )
    elif group.drives is not None and group.stale_axes():
        axes = ", ".join(map(str, group.stale_axes()))
        findings.append(
            make_message(
                "group {group}: the quick-master reference of axis {axes} is from before the last mastering",
                group=group.group,
                axes=axes,
            )
        )
    return replace(group, findings=tuple(findings))
