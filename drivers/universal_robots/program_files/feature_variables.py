"""Features that programs of a robot move: PolyScope calls NAME_var what they set, and called programs see it, too."""

import re
from collections.abc import Iterable

from cellcal.drivers.programs.barred import COMPUTED
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.file_declarations import ExternalUses, FileDeclarations
from cellcal.drivers.universal_robots.program_files.urp_archive import unpack_file

FEATURE_VARIABLE = re.compile(r"\b(\w+)_var\b", re.ASCII)
_SET, _SET_ALONE = "SETS", "SETS ALONE"  # the second by a program that calls no other
_SIGNS = (b"_var", b'character="_"', b"character='_'")  # of an expression, which is written sign by sign


def feature_of(name: str) -> str:
    """Return the feature's name as its variable has it, without what is behind it."""
    return re.sub(r"\W", "_", name).removesuffix("_var")


def declare_features(names: Iterable[str], *, calls: bool) -> FileDeclarations:
    """Return what a file says to others of the features whose variables it names."""
    return FileDeclarations(
        "", doubtful={f"{_SET if calls else _SET_ALONE} {name}": COMPUTED for name in names}
    )


def features_set_elsewhere(
    external_uses: ExternalUses, names: Iterable[str], *, calls: bool
) -> frozenset[str]:
    """Return those of the names that other files may set; a program that calls none is called by such that do."""
    words = (_SET, _SET_ALONE) if calls else (_SET,)
    return frozenset(
        name for name in names if any(f"{word} {name}" in external_uses.doubtful for word in words)
    )


def says_nothing(name: str, data: bytes) -> FileDeclarations | None:
    """Return that a file says nothing to others where a look tells; None for one that must be read."""
    try:
        text = unpack_file(name, data)[1] if data.startswith(b"\x1f\x8b") else data
    except ProgramFileError:
        return None
    return None if any(sign in text for sign in _SIGNS) else FileDeclarations("")
