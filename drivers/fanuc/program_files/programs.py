"""FANUC programs: .LS listings."""

import re
from collections.abc import Sequence

from cellcal.drivers.fanuc.program_files.configuration import FanucConfigurations
from cellcal.drivers.fanuc.program_files.ls_program import (
    change_listings,
    declarations_of,
    read_listings,
    read_ls,
)
from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import PositionChange, ProgramFile

_PROGRAM = re.compile(rb"\s*+/PROG\b", re.IGNORECASE)  # one in small letters is refused by name


def _is_program(data: bytes) -> bool:
    """Tell a program from the other listings that a controller saves as .LS, such as its alarm history."""
    return _PROGRAM.match(data) is not None


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
    says=declarations_of,
    together=_ListingBatch(),
)
