"""Which settings of a procedure are files."""

from typing import get_type_hints

from cellcal.calibration.points.tag_points import TagPath
from cellcal.procedures.simulation_cell import Description


def file_settings(kind: type) -> tuple[str, ...]:
    """Return the names of those settings of a procedure that are files."""
    return tuple(name for name, hint in get_type_hints(kind).items() if hint in (TagPath, Description))


def tag_settings(kind: type) -> tuple[str, ...]:
    """Return the names of those settings that are files of tags, whose unit can be told."""
    return tuple(name for name, hint in get_type_hints(kind).items() if hint is TagPath)
