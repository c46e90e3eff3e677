"""Everything that can be run."""

from difflib import get_close_matches

from cellcal.calibration.message import make_message
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
    position_cure,
    position_record,
    probed_frame,
    robot_calibration,
    simulation_cell,
    six_point_tcp,
    three_point_frame,
)
from cellcal.procedures.procedure_definition import ProcedureDefinition, missing_needs
from cellcal.procedures.run import ProcedureError

__all__ = ["CATALOGUE", "DEFINITIONS", "UnknownProcedureError", "definition_named", "missing_needs"]

DEFINITIONS: tuple[ProcedureDefinition, ...] = (
    mastering_record.DEFINITION,
    mastering_recovery.DEFINITION,
    mastering_undo.DEFINITION,
    position_record.DEFINITION,
    position_cure.DEFINITION,
    six_point_tcp.DEFINITION,
    three_point_frame.DEFINITION,
    probed_frame.DEFINITION,
    frame_offset.DEFINITION,
    end_effector_points.DEFINITION,
    fixture_alignment.DEFINITION,
    base_to_base.DEFINITION,
    robot_calibration.DEFINITION,
    drift_check.DEFINITION,
    accuracy_check.DEFINITION,
    simulation_cell.DEFINITION,
)
CATALOGUE: dict[str, ProcedureDefinition] = {entry.name: entry for entry in DEFINITIONS}


class UnknownProcedureError(ProcedureError):
    """No procedure has this name."""

    code = "procedure.unknown"


def definition_named(name: str) -> ProcedureDefinition:
    """Return one procedure's card.

    Raises
    ------
    UnknownProcedureError
        There is none of that name; the remedy names the nearest, or all.
    """
    if name not in CATALOGUE:
        raise UnknownProcedureError(
            make_message("there is no procedure {name!r}.", name=name), remedy=_remedy_for(name)
        )
    return CATALOGUE[name]


def _remedy_for(name: str) -> str:
    """Return what was meant by a name that no procedure has, as far as that is plain."""
    if name.endswith(".toml"):
        file = f'"{name}"' if " " in name else name
        return make_message("A cell file is named by an option: `--cell {file}`.", file=file)
    near = get_close_matches(name, CATALOGUE, n=1)
    if near:
        return make_message("Did you mean {near}?", near=near[0])
    return make_message("There are {procedures}.", procedures=", ".join(sorted(CATALOGUE)))
