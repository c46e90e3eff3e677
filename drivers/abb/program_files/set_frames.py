"""Tools and work objects that one module sets to numbers, and another may set between, too."""

import re
from collections.abc import Set
from dataclasses import replace

from cellcal.drivers.abb.program_files.frame_facts import BARRED_SET, FrameFacts
from cellcal.drivers.abb.program_files.literals import NAME
from cellcal.drivers.abb.program_files.written_frames import NUMBERS
from cellcal.drivers.programs.file_declarations import ExternalUses
from cellcal.drivers.programs.positions import Positions

_SETS = "sets"  # before a name and the file that sets it
_SETS_ANY = "sets-any"  # before a file that sets data by a name which is computed
_TRAP_NAMES = "trap names"  # before a word in a trap, which may call it at any time, and the file
_BY_NAME = re.compile(r"\bSetAllDataVal\b|\bSetDataVal\b(?!\s*+\"\w)", re.ASCII | re.IGNORECASE)
_TRAP = re.compile(r"\bTRAP\s(.*?)\bENDTRAP\b", re.ASCII | re.IGNORECASE | re.DOTALL)
_WORD = re.compile(NAME, re.ASCII)


def marks_of_set_frames(facts: FrameFacts, file: str, text: str) -> dict[str, str]:
    """Return what a file says to others of the tools and work objects that it sets, or lets be set at any time."""
    in_traps = {word.lower() for trap in _TRAP.findall(text) for word in _WORD.findall(trap)}
    return {
        **{f"{_SETS} {name} {file}": BARRED_SET for name in sorted(facts.set_while_running)},
        **{f"{_TRAP_NAMES} {name} {file}": BARRED_SET for name in sorted(in_traps)},
        **({f"{_SETS_ANY} {file}": BARRED_SET} if _BY_NAME.search(text) else {}),
    }


def without_frames_of_others(
    positions: Positions, external_uses: ExternalUses, shown: Set[str], routines: Set[str]
) -> Positions:
    """Return positions of which those are left whose tool or work object another file sets, or lets be set, too.

    ``shown`` are those that other files see, ``routines`` those of this file that may set any.
    """

    def of_others(words: str) -> bool:
        return any(file != external_uses.file for file in external_uses.doubtful.rests_behind(words))

    others = {name for name in shown if of_others(f"{_SETS} {name}")}
    any_ = of_others(_SETS_ANY) or any(of_others(f"{_TRAP_NAMES} {name}") for name in routines)
    if not others and not any_:
        return positions
    rows = [
        row
        for row, names in enumerate(zip(positions.tools, positions.user_frames, strict=True))
        for parts in [[name.lower().partition(NUMBERS) for name in names if name is not None]]
        if any((any_ and numbers) or name in others for name, numbers, _ in parts)
    ]
    return replace(positions, barred={**dict.fromkeys(rows, BARRED_SET), **positions.barred})
