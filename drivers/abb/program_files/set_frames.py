"""Tools and work objects that one module sets to numbers, and another may set between, too."""

from collections.abc import Set
from dataclasses import replace

from cellcal.drivers.abb.program_files.frame_facts import BARRED_SET, FrameFacts
from cellcal.drivers.abb.program_files.written_frames import NUMBERS
from cellcal.drivers.programs.file_declarations import ExternalUses
from cellcal.drivers.programs.positions import Positions

_SETS = "sets"  # before a name and the file that sets it


def marks_of_set_frames(facts: FrameFacts, file: str) -> dict[str, str]:
    """Return what a file says to others of the tools and work objects that it sets."""
    return {f"{_SETS} {name} {file}": BARRED_SET for name in sorted(facts.set_while_running)}


def without_frames_of_others(positions: Positions, external_uses: ExternalUses, shown: Set[str]) -> Positions:
    """Return positions of which those are left whose tool or work object another file sets, too."""
    others = {
        name
        for name in shown
        if any(file != external_uses.file for file in external_uses.doubtful.rests_behind(f"{_SETS} {name}"))
    }
    if not others:
        return positions
    rows = [
        row
        for row, names in enumerate(zip(positions.tools, positions.user_frames, strict=True))
        if any(name is not None and name.lower().partition(NUMBERS)[0] in others for name in names)
    ]
    return replace(positions, barred={**dict.fromkeys(rows, BARRED_SET), **positions.barred})
