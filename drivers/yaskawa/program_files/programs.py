"""Yaskawa programs: jobs (.JBI)."""

import re

from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.yaskawa.program_files.configuration import JobConfigurations
from cellcal.drivers.yaskawa.program_files.job_calls import declarations_of
from cellcal.drivers.yaskawa.program_files.job_program import JobProgram, read_job

read = read_job  # with pulses_per_rad=… pulse positions become angles


def _read_plain(name: str, data: bytes) -> JobProgram:
    return read_job(name, data)


def _is_job(data: bytes) -> bool:
    return re.match(rb"\s*(?:'[^\n]*\n\s*)*/JOB\b", data) is not None


BRAND = ProgramBrand(
    brand="yaskawa",
    suffixes=(".jbi",),
    read=_read_plain,
    configurations=JobConfigurations(),
    writes_program=_is_job,
    tells=True,
    says=declarations_of,
)
