"""Drives of a backup: $PARAM_GROUP in SYMOTN.VA, and which axes of a group turn or slide by them.

An axis that turns has $ENCSCALES in counts per degree and $GEAR_RATIO in joint turns per motor turn; one that slides
has counts per millimetre and millimetres per motor turn (read in public backups: the rail of an R-2000iC/210L, the
servo gun of an M-900iB/700). Either way their product is the counts of a motor turn, a power of two; with 360 between
them, no axis can be both. A group without the kinematics of an arm has no $INTERACTION: each of its axes moves alone.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile

import numpy as np

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.mastering.shown_joints import JointConvention
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.va_spots import (
    damaged_file_error,
    parse_boolean,
    parse_integer,
    parse_real,
)
from cellcal.drivers.fanuc.program_files.va_text import VaVariable

COUNTS_PER_TURN = 2**19  # of every axis on 27 public backups
_TURN_RANGE = range(2**16, 2**24 + 1)  # encoders of other robots than those 27
_TURN_TOLERANCE = 1.0  # counts: seven digits of a scale and of a ratio
_INTERACTION_TOLERANCE = 2e-6  # relative: seven digits of each of the two
_ARM_AXES = 6
_MOST_AXES = 9
_MOST_OF_POSITIONER = 3  # axes of a group that needs no $INTERACTION
_SCALES = ("ENCSCALES", "GEAR_RATIO", "MASTER_POS")


@dataclass(frozen=True, slots=True)
class GroupDrives:
    """The drives of the n axes of a group in SYMOTN.VA."""

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

    def sliding_axes(self) -> dict[int, float]:
        """Return the counts per mm of each axis, from 1, that slides; negative where it counts the other way."""
        found = {}
        rows = zip(self.counts_per_degree, self.gear_ratio, self.reversed, strict=True)
        for axis, (scale, ratio, away) in enumerate(rows, 1):
            if _is_whole_turn(scale * abs(ratio)):
                found[axis] = -scale if away else scale
        return found

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

    def with_axes_alone(self) -> "GroupDrives":
        """Return them as of axes that each move alone, by their scales."""
        rows = np.diag([math.radians(1 / scale) for scale in self.counts_per_degree])
        return replace(self, radians_per_count=tuple(tuple(map(float, row)) for row in rows))

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
class ReadDrives:
    """A group's drives in SYMOTN.VA: ``axes`` are those of a record, the drives are None where none can be made."""

    axes: int
    drives: GroupDrives | None
    remark: str = ""
    sliding: Mapping[int, float] = field(default_factory=dict)  # axis from 1: counts per mm


def read_drives(data: VaVariable, group: int) -> ReadDrives:
    """Return the axes of a group that turn together, and those that slide.

    Raises
    ------
    ProgramFileError
        The scales have a gap, or a value is missing.
    """
    drives = _read_all_axes(data, group)
    if drives is None:
        return ReadDrives(0, None)
    axes = len(drives.gear_ratio)
    sliding = drives.sliding_axes()
    if len(sliding) == axes:
        return ReadDrives(
            axes,
            None,
            make_message("group {group}: {axes_text}", group=group, axes_text=_name_axes(list(sliding))),
            sliding,
        )
    if axes <= _MOST_OF_POSITIONER and not sliding and not np.any(drives.radians_per_count):
        drives = drives.with_axes_alone()
    arm = max(axis for axis in range(1, axes + 1) if axis not in sliding)
    why = _find_contradiction(drives.first_axes(arm))
    if why and arm > _ARM_AXES and not _find_contradiction(drives.first_axes(_ARM_AXES)):
        remark = make_message(
            "group {group}: what follows axis {last} is left out of the arm ({why})",
            group=group,
            last=_ARM_AXES,
            why=why,
        )
        return ReadDrives(_ARM_AXES, drives.first_axes(_ARM_AXES), remark, sliding)
    if why:
        finding = make_message(
            "group {group}: {why}; a drive of turning axes cannot be made of that", group=group, why=why
        )
        return ReadDrives(axes, None, finding, sliding)
    remark = (
        make_message(
            "group {group}: {axes_text}, and no record of turning axes holds that",
            group=group,
            axes_text=_name_axes(list(sliding)),
        )
        if sliding
        else ""
    )
    return ReadDrives(arm, drives.first_axes(arm), remark, sliding)


def _name_axes(axes: Sequence[int]) -> str:
    listed = ", ".join(map(str, axes))
    if len(axes) == 1:
        return make_message("axis {listed} slides", listed=listed)
    return make_message("axes {listed} slide", listed=listed)


def _read_all_axes(data: VaVariable, group: int) -> GroupDrives | None:
    head, file = f"$PARAM_GROUP[{group}].$", data.file

    def read_number(path: str) -> float:
        spot = data.find_value(head + path)
        return parse_real(file, spot) if spot.is_initialised else 0.0

    scales = [read_number(f"ENCSCALES[{axis}]") for axis in range(1, _MOST_AXES + 1)]
    axes = len(list(takewhile(lambda scale: scale != 0, scales)))
    if any(scales[axes:]):
        raise damaged_file_error(
            file,
            data.line,
            make_message("{head}ENCSCALES has a gap: axis {axes} has no scale.", head=head, axes=axes + 1),
        )
    if axes == 0:
        return None
    numbers = range(1, axes + 1)
    away = tuple(not parse_boolean(file, data.find_value(f"{head}MOSIGN[{axis}]")) for axis in numbers)
    table = {name: tuple(read_number(f"{name}[{axis}]") for axis in numbers) for name in _SCALES}
    rows = tuple(tuple(read_number(f"INTERACTION[{i}].$INTERACTION[{j}]") for j in numbers) for i in numbers)
    return GroupDrives(
        table["ENCSCALES"], table["GEAR_RATIO"], table["MASTER_POS"], away, rows, _read_coupling(data, head)
    )


def _read_coupling(data: VaVariable, head: str) -> bool | None:
    """Return whether the motor of axis 3 follows axis 2, as the variables of this software say."""
    for path in (f"{head}AXS_COUPLE[3]", f"{head}INTRAC_NUM[3].$INTRAC_NUM[2]"):
        spot = data.values.get(path)
        if spot is not None and spot.is_initialised:
            return parse_integer(data.file, spot) != 0
    return None


def _is_whole_turn(counts: float) -> bool:
    """Return whether a motor turn has as many counts as an encoder of this maker: a power of two."""
    power = 2 ** round(math.log2(counts)) if counts > 1 else 0
    return power in _TURN_RANGE and abs(counts - power) <= _TURN_TOLERANCE * max(1.0, power / COUNTS_PER_TURN)


def _find_contradiction(drives: GroupDrives) -> str:
    """Return why scale, ratio and interaction cannot all be right; "" where they agree."""
    for axis, (turn, scale) in enumerate(
        zip(drives.counts_per_turn(), drives.counts_per_degree, strict=True)
    ):
        if not _is_whole_turn(turn):
            return make_message(
                "$ENCSCALES * 360 * $GEAR_RATIO of axis {axis} is {turn:.1f} counts, not {expected}",
                axis=axis + 1,
                turn=turn,
                expected=COUNTS_PER_TURN,
            )
        product = abs(drives.radians_per_count[axis][axis]) * np.degrees(1.0) * scale
        if abs(product - 1) > _INTERACTION_TOLERANCE:
            return make_message(
                "$ENCSCALES and $INTERACTION of axis {axis} differ by {share:.1e} of their size",
                axis=axis + 1,
                share=abs(product - 1),
            )
    try:
        drives.to_drive_train()
    except CalibrationError as refused:
        return refused.message
    return ""
