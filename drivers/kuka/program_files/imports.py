"""Positions of another data list that a program or list takes under a name of its own (IMPORT)."""

import re
from collections.abc import Iterable

from cellcal.calibration.message import make_message
from cellcal.drivers.kuka.program_files.collected_positions import KrlPositions
from cellcal.drivers.programs.file_declarations import Imports

_IMPORT = re.compile(
    r"^[ \t]*+IMPORT[ \t]++(?:E6POS|POS|E6AXIS|AXIS|FRAME)[ \t]++(?P<own>[A-Za-z_]\w*+)(?:[ \t]*+\[[^\[\]\n]*+\])?+"
    r"[ \t]++IS[ \t]++/(?:[^/.;\n]*+/)++(?P<list>[\w$]++)[ \t]*+\.\.[ \t]*+(?P<there>[A-Za-z_]\w*+)",
    re.ASCII | re.IGNORECASE | re.MULTILINE,
)
_TEXT = "{} stands in the data list {}: it is changed there, with what all moves to it say."


def imports_of(text: str) -> Imports:
    """Return by its name here the data list that a position stands in, and its name there; all in capitals."""
    return _by_name(_IMPORT.finditer(text))


def remark_imports(found: KrlPositions) -> Imports:
    """Return the same of a file that is read, and remark where each position stands."""
    imports = list(_IMPORT.finditer(found.source.text))
    for one in imports:
        found.add_remark(one.start("own"), "indirect", make_message(_TEXT, one["own"], one["list"]))
    return _by_name(imports)


def _by_name(imports: Iterable[re.Match[str]]) -> Imports:
    return {one["own"].upper(): (one["list"].upper(), one["there"].upper()) for one in imports}
