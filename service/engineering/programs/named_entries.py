"""Tools and frames by the names that programs use: in any case where a language ignores it, and those of files."""

from collections.abc import Mapping
from typing import TypeVar

from cellcal.calibration.geometry import Pose
from cellcal.drivers.programs.positions import ProgramFile

Entry = TypeVar("Entry")
CASELESS = frozenset(("abb", "kuka"))  # brands whose languages take a name in any case

_NUMBERS = ("={", "=[")  # before the numbers to which a program sets a tool or frame itself


def is_written_out(name: str) -> bool:
    """Return whether a name holds the numbers to which its program sets a tool or frame."""
    return any(sign in name for sign in _NUMBERS)


def name_without_numbers(name: str) -> str:
    """Return the name of a tool or frame as the controller knows it."""
    for sign in _NUMBERS:
        name = name.partition(sign)[0]
    return name


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
