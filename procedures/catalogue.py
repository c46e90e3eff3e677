"""Everything that can be run."""

from difflib import get_close_matches

from cellcal.procedures import (
    accuracy_check,
    base_to_base,
    drift_check,
    end_effector_points,
    fixture_alignment,
    frame_offset,
    mastering_record,
    mastering_recovery,
    mastering_undo,
    probed_frame,
    robot_calibration,
    simulation_cell,
    six_point_tcp,
    three_point_frame,
)
from cellcal.procedures.entry import Entry, missing
from cellcal.procedures.run import ProcedureError

__all__ = ["CATALOGUE", "ENTRIES", "UnknownProcedureError", "entry_named", "missing"]

ENTRIES: tuple[Entry, ...] = (
    mastering_record.ENTRY,
    mastering_recovery.ENTRY,
    mastering_undo.ENTRY,
    six_point_tcp.ENTRY,
    three_point_frame.ENTRY,
    probed_frame.ENTRY,
    frame_offset.ENTRY,
    end_effector_points.ENTRY,
    fixture_alignment.ENTRY,
    base_to_base.ENTRY,
    robot_calibration.ENTRY,
    drift_check.ENTRY,
    accuracy_check.ENTRY,
    simulation_cell.ENTRY,
)
CATALOGUE: dict[str, Entry] = {entry.name: entry for entry in ENTRIES}


class UnknownProcedureError(ProcedureError):
    """No procedure has this name."""

    code = "procedure.unknown"


def entry_named(name: str) -> Entry:
    """Return one procedure's card.

    Raises
    ------
    UnknownProcedureError
        There is none of that name; the remedy names the nearest.
    """
    if name not in CATALOGUE:
        near = get_close_matches(name, CATALOGUE, n=1) or sorted(CATALOGUE)
        raise UnknownProcedureError(f"there is no procedure {name!r}.", remedy=f"Did you mean {near[0]}?")
    return CATALOGUE[name]
