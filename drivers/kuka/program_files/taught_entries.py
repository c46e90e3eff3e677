"""Points of a data list that are taught in an entry of TOOL_DATA or BASE_DATA which its own program sets to numbers.

RoboDK's posts that write a data list set ``BASE_DATA[1] = {FRAME: …}`` in the program, and move by frame data with
``BASE_NO 1``. Where the entry is set before each such move, and by no other program, the point stands in the numbers.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import PurePath

from cellcal.drivers.kuka.program_files.data_list import name_of_data
from cellcal.drivers.kuka.program_files.frame_uses import WRITTEN_OUT, KrlRoutine
from cellcal.drivers.kuka.program_files.table_settings import TableSettings
from cellcal.drivers.programs.barred import COMPUTED
from cellcal.drivers.programs.file_declarations import BatchReasons, ExternalUses
from cellcal.drivers.programs.positions import CARTESIAN, Positions


@dataclass(frozen=True)
class EntryMarks:
    """What a program says of the entries that it sets to the data lists beside it."""

    entries: frozenset[str] = frozenset()  # "BASE 3"
    values: Mapping[str, str] = field(
        default_factory=dict
    )  # by "FP1 BASE 3": what it is at the moves to the point
    taken: Mapping[str, Set[str]] = field(default_factory=dict)  # as `TableSettings` says
    interrupts: bool = False  # it declares handlers, or calls from triggers
    calls: bool = False  # it calls routines

    def of_file(self, folder: str, path: PurePath) -> dict[str, str]:
        """Return it as marks, under the file's name and its controller's folder."""
        names = {f"{_list_of(path)} {data}": value for data, value in self.values.items()}
        names |= {f"{folder} sets {entry} {path}": COMPUTED for entry in self.entries}
        submits = path.suffix.lower() == ".sub" and (self.calls or bool(self.entries))
        beside = self.interrupts or submits
        return names | ({f"{folder} interrupts {path}": COMPUTED} if beside else {})


NO_ENTRIES = EntryMarks()


def marks_of_entries(tables: TableSettings, routines: Sequence[KrlRoutine]) -> EntryMarks:
    """Return what a program says of the entries that it sets."""
    interrupts = any(one.handlers or one.shown_handlers or one.triggers for one in routines)
    return EntryMarks(
        frozenset(tables.entries_set()),
        tables.taught_values(routines),
        tables.taken,
        interrupts,
        calls=any(one.calls for one in routines),
    )


def without_entries_set_beside(
    positions: Positions, taken: Mapping[str, Set[str]], external_uses: ExternalUses, folders: Sequence[str]
) -> Positions:
    """Return positions of which those are left whose entry another file sets that may run at any time.

    That is an interrupt's handler, what a trigger calls, or a submit program; between files it is not followed which
    of them leads there.
    """
    path, marks = PurePath(external_uses.file), external_uses.doubtful
    if not taken or not any(marks.rests_behind(f"{folder} interrupts") for folder in folders):
        return positions
    values = {
        f"${entry.partition(' ')[0]}={value.removeprefix(WRITTEN_OUT)}"
        for entry, some in taken.items()
        if _is_set_by_others(marks, folders, path, entry)
        for value in some
    }
    rows = [
        row
        for row, names in enumerate(zip(positions.tools, positions.user_frames, strict=True))
        if values.intersection(names)
    ]
    return replace(positions, barred={**dict.fromkeys(rows, COMPUTED), **positions.barred})


def with_set_entries(
    positions: Positions,
    keys: Sequence[str],
    rows: Set[int],
    external_uses: ExternalUses,
    folders: Sequence[str],
) -> Positions:
    """Return positions of which those name their tool and base by numbers whose own program alone sets the entries.

    ``rows`` are those that no other program may move to by their frame data.
    """
    path, marks = PurePath(external_uses.file), external_uses.doubtful
    columns = {"TOOL": list(positions.tools), "BASE": list(positions.user_frames)}
    for row in sorted(rows):
        if positions.kinds[row] != CARTESIAN or external_uses.uses_of_name(keys[row]):
            continue
        for which, column in columns.items():
            entry = f"{which} {column[row]}"
            value = marks.get(f"{_list_of(path)} {name_of_data(keys[row])} {entry}")
            if value is not None and not _is_set_by_others(marks, folders, path, entry):
                column[row] = f"${which}={value.removeprefix(WRITTEN_OUT)}"
    return replace(positions, tools=tuple(columns["TOOL"]), user_frames=tuple(columns["BASE"]))


def without_set_data(
    positions: Positions, keys: Sequence[str], taught: Set[int], set_data: Set[str]
) -> Positions:
    """Return positions of which those are left whose frame data a program sets."""
    if not set_data:
        return positions
    rows = [row for row in sorted(taught) if name_of_data(keys[row]) in set_data]
    return replace(positions, barred={**dict.fromkeys(rows, COMPUTED), **positions.barred})


def _is_set_by_others(marks: BatchReasons, folders: Sequence[str], path: PurePath, entry: str) -> bool:
    any_entry = f"{entry.partition(' ')[0]} *"
    files = [
        file
        for folder in folders
        for one in (entry, any_entry)
        for file in marks.rests_behind(f"{folder} sets {one}")
    ]
    return any(_list_of(PurePath(file)) != _list_of(path) for file in files)


def _list_of(path: PurePath) -> str:
    """Return the name that a program and its data list have in common, with their folder."""
    return str(path.with_suffix("")).upper()
