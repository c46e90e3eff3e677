"""Rows of a job as positions in columns."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, UNREAD, Positions
from cellcal.drivers.yaskawa.program_files.job_external import external_columns
from cellcal.drivers.yaskawa.program_files.job_text import JobRow, YaskawaJob

PULSES, SHIFT = "pulses", "shift"  # kinds of their own: nothing to move until more is known
# as controllers write: XRC and NX100 with two decimals of a degree, later ones with four
USUAL = {
    digits: re.compile(rf"(?:-?\d+\.\d{{3}},){{3}}(?:-?\d+\.\d{{{digits}}},){{2}}-?\d+\.\d{{{digits}}}")
    for digits in (4, 2)
}
_SIGN = re.compile(r"[+-]")
_NO_POSTURE = "its ///RCONF {}, where each number is 0 or 1, says no posture"
_LEAST_MM, _LEAST_DEG = 3, 4  # decimals of numbers that are not all written alike


def kind_of(row: JobRow, ratios: Array | None, shifts: frozenset[int], points: frozenset[int]) -> str:
    """Return what a row is: a variable that no move of this job goes to, or that anything else uses, is no point."""
    if row.broken:
        return UNREAD
    if row.kind == "P" and (int(row.number) in shifts or int(row.number) not in points):
        return SHIFT
    if row.state.mode == "RECTAN":
        return CARTESIAN
    return PULSES if row.state.mode == "PULSE" and ratios is None else JOINTS


def unknown_configurations(rows: Sequence[JobRow]) -> dict[int, str]:
    """Return why poses are left whose RCONF no controller writes."""
    return {
        i: make_message(_NO_POSTURE, row.state.configuration)
        for i, row in enumerate(rows)
        if row.state.mode == "RECTAN" and _SIGN.search(row.state.configuration)
    }


def positions_of(
    name: str,
    jobs: list[YaskawaJob],
    rows: list[JobRow],
    kinds: list[str],
    groups: list[int],
    ratios: Array | None,
) -> Positions:
    """Return the robot's positions, of rows in the order of the file.

    Raises
    ------
    ProgramFileError
        A row holds numbers that are no position, or more axes than there are ratios.
    """
    _refuse_axes(name, rows, ratios)
    decimals = [decimals_of(row) for row in rows]
    held_kinds = np.array(kinds, dtype=object)
    cartesian = held_kinds == CARTESIAN
    count = len(rows)
    external, columns = external_columns(jobs, rows)
    resolution_m = np.array([10.0 ** (-3 - mm) for mm, _ in decimals]).reshape(count)
    resolution_rad = np.array([np.radians(10.0**-deg) for _, deg in decimals]).reshape(count)
    pulsed = np.array([row.state.mode == "PULSE" for row in rows], dtype=bool).reshape(count)
    resolution_rad[pulsed] = np.inf if ratios is None else 1.0 / np.abs(ratios).min()
    return Positions(
        names=_position_names(rows),
        kinds=tuple(kinds),
        lines=np.array([row.line for row in rows], dtype=np.int64),
        groups=np.array(groups, dtype=np.int64),
        frame_tip=_pose_columns(rows, cartesian),
        joints=_joint_columns(rows, held_kinds == JOINTS, ratios),
        external=external,
        user_frames=tuple(_frame_name(row) for row in rows),
        tools=tuple(row.state.tool for row in rows),
        configurations=tuple(row.state.configuration if row.state.mode == "RECTAN" else "" for row in rows),
        resolution_m=resolution_m,
        resolution_rad=resolution_rad,
        external_columns=columns,
    )


def _refuse_axes(name: str, rows: list[JobRow], ratios: Array | None) -> None:
    axes = 8 if ratios is None else len(ratios)
    for row in rows:
        count, mode = row.text.count(",") + 1, row.state.mode
        if count not in (6, 7) if mode == "RECTAN" else count > 8 or (mode == "PULSE" and "." in row.text):
            raise ProgramFileError(
                name,
                make_message(
                    "{row_kind}{row_number} holds {count} numbers that are no ///{mode} position.",
                    row_kind=row.kind,
                    row_number=row.number,
                    count=count,
                    mode=mode,
                ),
                line=row.line,
                column=1,
                remedy="Save the job on the controller again.",
            )
        if mode == "PULSE" and count > axes:
            raise ProgramFileError(
                name,
                make_message(
                    "{row_kind}{row_number} holds {count} axes, and pulses per radian are given for {axes}.",
                    row_kind=row.kind,
                    row_number=row.number,
                    count=count,
                    axes=axes,
                ),
                line=row.line,
                remedy="Give the ratio of every axis of the robot.",
            )


def decimals_of(row: JobRow) -> tuple[int, int]:
    """Return the decimals that lengths and angles of a row are written with."""
    if row.state.mode == "PULSE":
        return _LEAST_MM, _LEAST_DEG
    if row.state.mode == "RECTAN":
        for digits, pattern in USUAL.items():
            if pattern.fullmatch(row.text):
                return 3, digits
    digit_counts = [len(text.rstrip().partition(".")[2]) for text in row.text.split(",")]
    if row.state.mode == "ANGLE":
        return _LEAST_MM, _shared_decimals(digit_counts, _LEAST_DEG)
    return _shared_decimals(digit_counts[:3], _LEAST_MM), _shared_decimals(digit_counts[3:6], _LEAST_DEG)


def _shared_decimals(digit_counts: list[int], least: int) -> int:
    """Return the decimals of numbers that share a format; free numbers get those of the finest, at least some."""
    return (
        digit_counts[0]
        if digit_counts[0] and min(digit_counts) == max(digit_counts)
        else max(least, *digit_counts)
    )


def table_of(rows: Sequence[JobRow], width: int) -> Array:
    """Return (N, width): the numbers as written, NaN where a row has fewer; more than ``width`` are left out."""
    table = np.full((len(rows), width), np.nan)
    counts = np.array([row.text.count(",") + 1 for row in rows], dtype=np.int64)
    for count in np.unique(counts).tolist():
        where = np.flatnonzero(counts == count)
        flat = np.fromstring(",".join([rows[i].text for i in where.tolist()]), sep=",")
        table[where, : min(count, width)] = flat.reshape(len(where), count)[:, :width]
    return table


def _pose_columns(rows: list[JobRow], cartesian: NDArray[np.bool_]) -> Array:
    poses = np.full((len(rows), 4, 4), np.nan)
    where = np.flatnonzero(cartesian)
    if len(where):
        values = table_of([rows[i] for i in where.tolist()], 6)
        rotation = rotation_from("yaskawa_rpy", np.radians(values[:, 3:]))
        poses[where] = homogeneous_matrix(rotation, values[:, :3] / 1e3)
    return poses


def _joint_columns(rows: list[JobRow], is_selected: NDArray[np.bool_], ratios: Array | None) -> Array:
    axes = max((row.text.count(",") + 1 for row in rows if row.state.mode != "RECTAN"), default=0)
    joints = np.full((len(rows), axes), np.nan)
    pulsed = np.array([row.state.mode == "PULSE" for row in rows], dtype=bool).reshape(len(rows))
    for where, turns in ((is_selected & pulsed, True), (is_selected & ~pulsed, False)):
        places = np.flatnonzero(where)
        table = table_of([rows[i] for i in places.tolist()], axes)
        if turns and ratios is not None and len(places):
            table = table / np.pad(ratios, (0, 8))[:axes]
        joints[places] = table if turns else np.radians(table)
    return joints


def _position_names(rows: list[JobRow]) -> tuple[str, ...]:
    """Return C00012; a second one of that name, in a file of several jobs, is C00012@340 after its line."""
    used_names: set[str] = set()
    names = []
    for row in rows:
        name = f"{row.kind}{row.number}"
        name = f"{name}@{row.line}" if name in used_names else name
        used_names.add(name)
        names.append(name)
    return tuple(names)


def _frame_name(row: JobRow) -> str | None:
    if row.state.mode != "RECTAN":
        return None
    return row.state.user if row.state.postype == "USER" else row.state.postype
