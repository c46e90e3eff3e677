"""Folders of a KUKA controller's files: whose lists count for which programs."""

import re
from collections.abc import Sequence
from pathlib import PurePath

_ROOT = re.compile(r"R\d", re.IGNORECASE)  # KRC/R1: where the programs of a controller stand
_NO_ROOT = "no R1"


def program_folder(path: PurePath) -> str:
    """Return the folder of a controller's programs: all below its R1; one name for all that lie in no R1.

    Nothing says of these that they are not one robot's, wherever they lie.
    """
    parts = path.parent.parts
    roots = [depth for depth, part in enumerate(parts, 1) if _ROOT.fullmatch(part)]
    return str(PurePath(*parts[: roots[-1]])) if roots else _NO_ROOT


def cells_of(file: str) -> Sequence[str]:
    """Return the folders whose files count for one: its controller's, and what lies in no R1."""
    return tuple(dict.fromkeys((program_folder(PurePath(file)), _NO_ROOT)))
