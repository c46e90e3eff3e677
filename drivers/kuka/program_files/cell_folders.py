"""Folders of a KUKA controller's files: whose lists and programs count for which programs."""

import re
from collections.abc import Sequence
from pathlib import PurePath

_ROOT = re.compile(r"R\d", re.IGNORECASE)  # KRC/R1: where the programs of a controller stand
_PARTS_OF_ROOT = frozenset(("program", "system", "mada", "tp"))  # what R1 holds, side by side
_BELOW = "below "  # before a folder: what programs in folders inside it do


def program_folder(path: PurePath) -> str:
    """Return the folder of a controller's programs: all below its R1, or those that lie together."""
    parts = path.parent.parts
    roots = [depth for depth, part in enumerate(parts, 1) if _ROOT.fullmatch(part)]
    if not roots and parts and parts[-1].lower() in _PARTS_OF_ROOT:
        return str(PurePath(*parts[:-1]))
    return str(PurePath(*parts[: roots[-1]] if roots else parts))


def cells_of(file: str) -> Sequence[str]:
    """Return the folders whose controller's lists count for a file: its own, and those above."""
    cell = PurePath(program_folder(PurePath(file)))
    return tuple(map(str, (cell, *cell.parents)))


def folders_around(file: str) -> Sequence[str]:
    """Return under which folders a file finds what programs do that count for it: also those below its own."""
    own, *above = cells_of(file)
    return (own, *above, f"{_BELOW}{own}")


def folders_of_program(path: PurePath) -> Sequence[str]:
    """Return the folders under which other files find what a program does.

    Without an R1 nothing tells where its controller's folders begin, so programs above it count it as their own.
    """
    own = program_folder(path)
    if any(_ROOT.fullmatch(part) for part in path.parent.parts):
        return (own,)
    return (own, *(f"{_BELOW}{above}" for above in PurePath(own).parents))
