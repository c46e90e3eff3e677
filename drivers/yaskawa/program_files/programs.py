"""Yaskawa programs: jobs (.JBI)."""

import re
from codecs import BOM_UTF8

from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.yaskawa.program_files.configuration import JobConfigurations
from cellcal.drivers.yaskawa.program_files.job_called import NAMES
from cellcal.drivers.yaskawa.program_files.job_calls import declarations_of
from cellcal.drivers.yaskawa.program_files.job_program import JobProgram, read_job

read = read_job  # with pulses_per_rad=… pulse positions become angles


def _read_plain(name: str, data: bytes) -> JobProgram:
    return read_job(name, data)


def _is_job(data: bytes) -> bool:
    """Tell a job, and one whose beginning was lost, which is refused by name when it is read."""
    if data.startswith(BOM_UTF8):
        return False  # an editor saved it, which has its own refusal
    return re.search(rb"^[ \t]*+(?:/JOB|//POS|//INST)\b", data, re.MULTILINE) is not None


BRAND = ProgramBrand(
    brand="yaskawa",
    suffixes=(".jbi",),
    read=_read_plain,
    configurations=JobConfigurations(),
    writes_program=_is_job,
    tells=True,
    routine_names=NAMES,
    says=declarations_of,
)
