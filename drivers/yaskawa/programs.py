"""Yaskawa programs: jobs (.JBI)."""

import re

from drivers.programs.brands import ProgramBrand
from drivers.yaskawa.configuration import JobConfigurations
from drivers.yaskawa.job_calls import said_by
from drivers.yaskawa.job_program import JobProgram, read_job

read = read_job  # with pulses_per_rad=… pulse positions become angles


def _plain(name: str, data: bytes) -> JobProgram:
    return read_job(name, data)


def _is_job(data: bytes) -> bool:
    return re.match(rb"\s*(?:'[^\n]*\n\s*)*/JOB\b", data) is not None


BRAND = ProgramBrand(
    brand="yaskawa",
    suffixes=(".jbi",),
    read=_plain,
    configurations=JobConfigurations(),
    writes_program=_is_job,
    tells=True,
    says=said_by,
)
