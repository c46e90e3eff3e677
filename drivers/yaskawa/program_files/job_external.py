"""Base and station axes of a job: rows of their own beside the robot's.

``BC00003`` and ``BP003`` hold the axes that carry the robot, ``EC00003`` and ``EX003`` those of a station. Where a
robot has a seventh axis of its own, it stands behind the pose.
"""

from collections.abc import Mapping

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.drivers.programs.conditions import AxisUnit, ExternalColumn
from cellcal.drivers.yaskawa.program_files.job_axis_rows import BASE_ROWS, STATION_ROWS, axis_rows_of
from cellcal.drivers.yaskawa.program_files.job_text import ROBOT_ROWS, JobRow, YaskawaJob

ROW_UNITS = {"RECTAN": 1e-3, "ANGLE": np.pi / 180}  # what one unit of a row is counted as; pulses as pulses
_WRITTEN = {"RECTAN": AxisUnit.UNSTATED, "ANGLE": AxisUnit.DEGREES, "PULSE": AxisUnit.PULSES}
_OWN = "R7"
_JobBeside = dict[tuple[int, str, int], JobRow]


def external_columns(jobs: list[YaskawaJob], rows: list[JobRow]) -> tuple[Array, tuple[ExternalColumn, ...]]:
    """Return axes beside each point (N, k), and what the columns are."""
    beside = rows_beside(jobs, rows)
    sevenths = any(row.text.count(",") == 6 for row in rows if row.state.mode == "RECTAN")
    if not beside and not sevenths:
        return np.zeros((len(rows), 0)), ()
    columns: list[ExternalColumn] = []
    values: list[Array] = []
    if sevenths:
        columns.append(ExternalColumn(_OWN, AxisUnit.DEGREES))
        values.append(np.array([[_seventh_axis(row)] for row in rows]))
    for letter, kinds in (("B", BASE_ROWS), ("S", STATION_ROWS)):
        its = {row: other for (row, of), other in beside.items() if of == kinds}
        width = max((other.text.count(",") + 1 for other in its.values()), default=0)
        if not width:
            continue
        units = {_WRITTEN.get(other.state.mode, AxisUnit.MIXED) for other in its.values()}
        unit = units.pop() if len(units) == 1 else AxisUnit.MIXED
        columns += [ExternalColumn(f"{letter}{k + 1}", unit) for k in range(width)]
        table = np.full((len(rows), width), np.nan)
        for row, other in its.items():
            numbers = [float(text) for text in other.text.split(",")]
            table[row, : len(numbers)] = np.array(numbers) * ROW_UNITS.get(other.state.mode, 1.0)
        values.append(table)
    return np.hstack(values), tuple(columns)


def rows_beside(jobs: list[YaskawaJob], rows: list[JobRow]) -> dict[tuple[int, tuple[str, ...]], JobRow]:
    """Return the rows of base and station axes by the robot's row and their kinds."""
    of_jobs: _JobBeside = {}
    for place, job in enumerate(jobs):
        for row in job.rows:
            if row.kind not in ROBOT_ROWS:
                kind = "EX" if row.kind == "EP" else row.kind
                of_jobs[place, kind, int(row.number)] = row
    if not of_jobs:
        return {}
    named_by_job = [axis_rows_of(job).named for job in jobs]
    places = {row.start: place for place, job in enumerate(jobs) for row in job.rows}
    found: dict[tuple[int, tuple[str, ...]], JobRow] = {}
    for number, row in enumerate(rows):
        for kinds in (BASE_ROWS, STATION_ROWS):
            place, key = places[row.start], (row.kind, int(row.number))
            its_own = f"{kinds[0] if row.kind == 'C' else kinds[1]}{key[1]:05d}"
            name = named_by_job[place].get((key, kinds), its_own)
            other = of_jobs.get((place, name[:2], int(name[2:]))) if name[2:].isdigit() else None
            if other is not None:
                found[number, kinds] = other
    return found


def rows_that_share(beside: Mapping[tuple[int, tuple[str, ...]], JobRow]) -> tuple[tuple[int, ...], ...]:
    """Return the robot's rows that have one row of base or station axes, for each such row."""
    found: dict[int, list[int]] = {}
    for (number, _), other in beside.items():
        found.setdefault(other.start, []).append(number)
    return tuple(tuple(numbers) for numbers in found.values() if len(numbers) > 1)


def _seventh_axis(row: JobRow) -> float:
    texts = row.text.split(",")
    return float(np.radians(float(texts[6]))) if row.state.mode == "RECTAN" and len(texts) == 7 else np.nan
