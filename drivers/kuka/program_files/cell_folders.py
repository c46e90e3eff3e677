"""Folders of a KUKA controller's files: whose lists count for which programs."""

import re
from collections.abc import Sequence
from pathlib import PurePath

_ROOT = re.compile(r"R\d", re.IGNORECASE)  # KRC/R1: where the programs of a controller stand


def program_folder(path: PurePath) -> str:
    """Return the folder of a controller's programs: all below its R1, or those that lie together."""
    parts = path.parent.parts
    roots = [depth for depth, part in enumerate(parts, 1) if _ROOT.fullmatch(part)]
    return str(PurePath(*parts[: roots[-1]] if roots else parts))


def cells_of(file: str) -> Sequence[str]:
    """Return the folders whose controller's lists count for a file: its own, and those above."""
    cell = PurePath(program_folder(PurePath(file)))
    return tuple(map(str, (cell, *cell.parents)))
