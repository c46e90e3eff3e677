"""FANUC programs: .LS listings."""

import re
from codecs import BOM_UTF8
from collections.abc import Sequence

from cellcal.drivers.fanuc.program_files.configuration import FanucConfigurations
from cellcal.drivers.fanuc.program_files.ls_called import NAMES
from cellcal.drivers.fanuc.program_files.ls_program import (
    change_listings,
    declarations_of,
    read_listings,
    read_ls,
)
from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import PositionChange, ProgramFile

# One in small letters, or whose beginning was lost, is refused by name.
_SECTION = re.compile(rb"^[ \t]*+/(?:PROG|MN|POS)\b", re.IGNORECASE | re.MULTILINE)


def _is_program(data: bytes) -> bool:
    """Tell a program from the other listings that a controller saves as .LS, such as its alarm history."""
    if data.startswith(BOM_UTF8):
        return False  # an editor saved it, which has its own refusal
    return _SECTION.search(data) is not None


class _ListingBatch:
    """`drivers.programs.brands.ProgramBatch`."""

    def read_files(self, files: Sequence[tuple[str, bytes]]) -> Sequence[ProgramFile | ProgramFileError]:
        return read_listings(files)

    def change_files(
        self, programs: Sequence[ProgramFile], changes: Sequence[PositionChange]
    ) -> Sequence[ProgramFile]:
        return change_listings(programs, changes)


BRAND = ProgramBrand(
    brand="fanuc",
    suffixes=(".ls",),
    read=read_ls,
    configurations=FanucConfigurations(),
    writes_program=_is_program,
    tells=True,
    routine_names=NAMES,
    says=declarations_of,
    together=_ListingBatch(),
)
