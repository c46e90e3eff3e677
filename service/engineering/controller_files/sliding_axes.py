"""Axes that slide, such as a rail or a servo gun: where their counts put them, and where the controller shows."""

from collections.abc import Collection
from dataclasses import dataclass

from cellcal.drivers.fanuc.controller_files.axis_report import AxisReport
from cellcal.drivers.fanuc.controller_files.controller_files import POSITION, ControllerFiles
from cellcal.drivers.fanuc.program_files.va_mastering import GroupMastering

_TOLERANCE_MM = 0.01  # the controller shows hundredths, rounded or cut off
_DIGITS = 1e-6  # seven printed digits of a scale


@dataclass(frozen=True, slots=True)
class SlidingAxis:
    """One axis; what no file tells is None."""

    group: int
    axis: int
    count_at_zero: int
    pulse: int | None
    counted_mm: float | None
    shown_mm: float | None

    @property
    def agrees(self) -> bool | None:
        """Return whether counts and display agree; None where one of them is missing."""
        if self.counted_mm is None or self.shown_mm is None:
            return None
        return abs(self.counted_mm - self.shown_mm) <= _TOLERANCE_MM + _DIGITS * abs(self.counted_mm)

    @property
    def sentence(self) -> str:
        """Say what was found, without a full stop."""
        name = f"axis {self.axis} of group {self.group}"
        if self.counted_mm is None:
            return f"where {name} stands: no file holds its count"
        if self.shown_mm is None:
            return f"where {name} stands ({self.counted_mm:.2f} mm by its count): {POSITION} does not show it"
        shown = f"{POSITION} shows {self.shown_mm:.2f} mm"
        return f"{name} stands at {self.counted_mm:.2f} mm by its count, and {shown}"


def find_sliding_axes(files: ControllerFiles, groups: Collection[int]) -> tuple[SlidingAxis, ...]:
    """Return the sliding axes of these groups."""
    rows = {} if files.axes is None else pulses_by_group(files, files.axes)
    return tuple(
        _find_axis(files, mastering, axis, rows.get(group, ()))
        for group, mastering in files.variables.mastering.items()
        if group in groups
        for axis in mastering.sliding
    )


def pulses_by_group(files: ControllerFiles, report: AxisReport) -> dict[int, tuple[int | None, ...]]:
    """Return the pulses of every axis of each group; empty where the report does not fit the groups."""
    groups = files.variables.mastering
    axes = tuple(len(each.counts_at_zero) + len(each.further_axes) for each in groups.values())
    rows = report.split_by_groups(axes)
    return dict(zip(groups, rows, strict=True)) if rows else {}


def _find_axis(
    files: ControllerFiles, mastering: GroupMastering, axis: int, pulses: tuple[int | None, ...]
) -> SlidingAxis:
    counts = dict(enumerate(mastering.counts_at_zero, 1))
    counts |= {each.axis: each.count_at_zero for each in mastering.further_axes}
    zero = counts[axis]
    pulse = pulses[axis - 1] if axis <= len(pulses) else None
    shown = None if files.position is None else files.position.find_group(mastering.group)
    joints = () if shown is None else shown.joints_deg
    return SlidingAxis(
        mastering.group,
        axis,
        zero,
        pulse,
        None if pulse is None else (pulse - zero) / mastering.sliding[axis],
        joints[axis - 1] if axis <= len(joints) else None,
    )
