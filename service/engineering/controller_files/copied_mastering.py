"""A mastering that another controller has as well: it came with a copied backup, and is not this arm's own."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cellcal.service.engineering.controller_files.record_from_files import FilesRecord, FilesRecords
from cellcal.service.engineering.controller_files.stored_records import StoredRecord, list_records
from cellcal.service.engineering.parameters.mastering_files import RecordFileError

# Counts of two arms agree by chance once in some 10**6 on one axis; zeros and small numbers mark
# an arm that was never mastered.
_FEWEST_AXES = 3
_SMALLEST_COUNT = 1000


def describe_copied_mastering(
    counts_at_zero: Sequence[int], serial: str, address: str, stored: Sequence[StoredRecord]
) -> tuple[str, ...]:
    """Name each other controller whose newest record has the same counts at zero on three axes or more.

    Controllers are others where number and address both differ: one arm may have a new address, and numbers that were
    never set are shared.
    """
    newest = {(each.controller.address, each.controller.group): each for each in stored}
    others = [
        each
        for (where, _), each in sorted(newest.items())
        if where != address and serial and each.record.robot_serial not in ("", serial)
    ]
    named = ((each, _same_axes(counts_at_zero, each.record.counts_at_zero)) for each in others)
    return tuple(
        f"{', '.join(f'J{axis}' for axis in axes)} have the counts at zero of {each.record.robot_serial} at "
        f"{each.controller.address} (record of {each.day}): a copied backup, unless it is the same arm at another "
        "controller. Move each axis to its zero mark and compare before anything runs"
        for each, axes in named
        if len(axes) >= _FEWEST_AXES
    )


def with_copies_named(made: FilesRecords, folder: Path) -> FilesRecords:
    """Return new records whose findings name the robots of a folder's records that have the same mastering."""
    try:
        stored = list_records(folder)
    except RecordFileError as error:
        reason = f"whether another robot has the same mastering: {str(error).rstrip('.')}"
        unread = tuple(replace(each, not_checked=(*each.not_checked, reason)) for each in made.records)
        return replace(made, records=unread)
    return replace(made, records=tuple(_with_copies(each, stored) for each in made.records))


def _with_copies(done: FilesRecord, stored: Sequence[StoredRecord]) -> FilesRecord:
    counts, serial = done.record.counts_at_zero, done.record.robot_serial
    copies = describe_copied_mastering(counts, serial, done.device, stored)
    return replace(done, findings=(*copies, *done.findings))


def _same_axes(ours: Sequence[int], theirs: Sequence[int]) -> list[int]:
    pairs = enumerate(zip(ours, theirs, strict=False), 1)
    return [axis for axis, (own, other) in pairs if own == other and abs(own) >= _SMALLEST_COUNT]
