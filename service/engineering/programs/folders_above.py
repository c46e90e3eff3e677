"""Lists of a controller in the folders above its programs, as a backup has them; their names in any case."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath

from cellcal.drivers.program_registry import SUFFIXES, brand_named

_MOST = 6  # RAPID/TASK1/PROGMOD below a backup, and a few folders of people


def lists_above(programs: Sequence[Path]) -> dict[Path, str]:
    """Return for each folder of programs the nearest list of their controller in it or above it, and its brand."""
    above = _FoldersAbove()
    return {
        place: brand
        for suffix, folder in sorted({(path.suffix.lower(), path.parent) for path in programs})
        for brand, suffixes in SUFFIXES.items()
        if suffix in suffixes
        for list_path in brand_named(brand).beside
        if (place := above.find_list(folder, list_path)) is not None
    }


@dataclass
class _FoldersAbove:
    """What stands in the folders above programs, each of which is looked into once."""

    _names: dict[Path, dict[str, Path]] = field(
        default_factory=dict
    )  # by folder: what is there, in small letters

    def find_list(self, folder: Path, list_path: PurePath) -> Path | None:
        above = [folder, *folder.parents]
        above += [] if folder.is_absolute() else [Path(*[".."] * depth) for depth in range(1, _MOST)]
        for each in above[:_MOST]:
            place: Path | None = each
            for part in list_path.parts:
                place = None if place is None else self._names_in(place).get(part.casefold())
            if place is not None:
                return place
        return None

    def _names_in(self, folder: Path) -> dict[str, Path]:
        if folder not in self._names:
            try:
                self._names[folder] = {path.name.casefold(): path for path in sorted(folder.iterdir())}
            except OSError:  # no folder, or one that may not be read
                self._names[folder] = {}
        return self._names[folder]
