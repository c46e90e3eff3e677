"""Axes of a controller that its record leaves out, such as a rail or a servo gun: what happened to them."""

from collections.abc import Collection, Mapping

from cellcal.drivers.fanuc.controller_files.controller_files import ControllerFiles
from cellcal.drivers.fanuc.program_files.va_mastering import MASTERED
from cellcal.service.engineering.controller_files.file_change import ChangeKind, FileChange

OtherAxis = tuple[int, bool]  # count at zero, and whether it was mastered


def find_other_axes(files: ControllerFiles, *groups: int) -> dict[str, OtherAxis]:
    """Return every axis that the records of these groups leave out: their rails, and the axes of other groups."""
    found: dict[str, OtherAxis] = {}
    for number, each in files.variables.mastering.items():
        states = zip(each.counts_at_zero, each.states, strict=True) if number not in groups else ()
        for axis, (count, state) in enumerate(states, 1):
            found[f"{number}.{axis}"] = (count, each.mastered and state == MASTERED)
        for rail in each.further_axes:
            found[f"{number}.{rail.axis}"] = (rail.count_at_zero, each.mastered and rail.state == MASTERED)
    return found


def compare_other_axes(
    before: Mapping[str, OtherAxis] | None,
    now: Mapping[str, OtherAxis] | None,
    recorded_groups: Collection[int],
) -> list[FileChange]:
    """Return which of those axes lost their mastering or were mastered anew; groups with own records are left out.

    An axis that was not mastered when the record was taken, such as a gun that is not mounted, is no loss.
    """
    found = []
    if before is None or now is None:
        return []
    for name in sorted(before.keys() | now.keys()):
        was, present = before.get(name), now.get(name)
        if was != present and int(name.partition(".")[0]) not in recorded_groups:
            found += _describe_change(name_axis(name), was, present)
    return found


def _describe_change(axis: str, was: OtherAxis | None, present: OtherAxis | None) -> list[FileChange]:
    if was is None or present is None:
        word = "is new" if was is None else "is no longer there"
        return [FileChange(ChangeKind.MASTERING, f"{axis} {word}")]
    found = []
    if was[1] and not present[1]:
        found.append(FileChange(ChangeKind.LOSS, f"{axis} is no longer mastered"))
    if present[1] and not was[1]:
        found.append(FileChange(ChangeKind.MASTERING, f"{axis} is mastered now, and was not"))
    if was[0] != present[0]:
        text = f"{axis} has the master count {present[0]}, {present[0] - was[0]:+d} counts from the record's {was[0]}"
        found.append(FileChange(ChangeKind.MASTERING, text))
    return found


def name_axis(name: str) -> str:
    """Write "2.1" as people say it."""
    group, _, axis = name.partition(".")
    return f"axis {axis} of group {group}"
