"""Tools and frames by the names that programs use: in any case where a language ignores it, and those of files."""

from collections.abc import Mapping
from typing import TypeVar

from cellcal.calibration.geometry import Pose
from cellcal.drivers.programs.positions import ProgramFile

Entry = TypeVar("Entry")
CASELESS = frozenset(("abb", "kuka"))  # brands whose languages take a name in any case


def entry_named(entries: Mapping[str, Entry], name: str, brand: str) -> Entry | None:
    """Return the entry of a name; a language that ignores case finds it in any case."""
    if name in entries or brand not in CASELESS:
        return entries.get(name)
    return next((entry for key, entry in entries.items() if key.lower() == name.lower()), None)


def brought_frames(program: ProgramFile, *, at_home: bool) -> tuple[Mapping[str, Pose], Mapping[str, Pose]]:
    """Return tools and frames that a program brings; ``at_home`` those of its cell's other files, too."""
    frames = program.frames
    if not at_home or not (frames.cell_flange_tip or frames.cell_base_frame):
        return frames.flange_tip, frames.base_frame
    return {**frames.cell_flange_tip, **frames.flange_tip}, {**frames.cell_base_frame, **frames.base_frame}
