"""FANUC programs: .LS listings."""

import re

from drivers.fanuc.configuration import FanucConfigurations
from drivers.fanuc.ls_program import read_ls
from drivers.programs.brands import ProgramBrand

_PROGRAM = re.compile(rb"\s*+/PROG\b")


def _is_program(data: bytes) -> bool:
    """Tell a program from the other listings that a controller saves as .LS, such as its alarm history."""
    return _PROGRAM.match(data) is not None


BRAND = ProgramBrand(
    brand="fanuc",
    suffixes=(".ls",),
    read=read_ls,
    configurations=FanucConfigurations(),
    writes_program=_is_program,
)
