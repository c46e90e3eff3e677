"""Positions in .VA text: frames, tools and position registers.

::

    [1,1] =   'HOME'   Group: 1                       [1,10] =   ''
  J1 =    45.000 deg   J2 =   -45.000 deg  …        Group: 1   Config: N U T, 0, 1, 0
                                                    X:  2894.795   Y:   285.018   Z:  -506.546
    [1,3] =   '' Uninitialized                      W:    90.156   P:     1.465   R:    95.934
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Pose, homogeneous_matrix
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import rotation_from
from cellcal.drivers.fanuc.program_files.va_spots import (
    UNINITIALISED,
    ValueSpot,
    damaged_file_error,
    parse_real,
)

CARTESIAN = ("X", "Y", "Z", "W", "P", "R")
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|\*+|Uninitialized"
_COORDINATE = re.compile(rf"[ \t]*([XYZWPR]):[ \t]*({_NUMBER})(?=[ \t]|\Z)")
_JOINT = re.compile(rf"[ \t]*(J\d)[ \t]*=[ \t]*({_NUMBER})[ \t]+(deg|mm)(?=[ \t]|\Z)")
_EXTERNAL = re.compile(rf"[ \t]*(EXT\d|E\d)[ \t]*[:=][ \t]*({_NUMBER})[ \t]+(deg|mm)(?=[ \t]|\Z)")
_GROUP = re.compile(r"[ \t]*Group:[ \t]*(\d{1,2})(?:[ \t]+Config:[ \t]*(.*?))?[ \t]*\Z")
_HEAD = re.compile(r"(?:'([^']*)')?[ \t]*(?:(Uninitialized)|(Group:.*))?\Z")


@dataclass(frozen=True, slots=True)
class VaPosition:
    """One position as written: Cartesian numbers X … R, or joints J1 …, and external axes."""

    file: str
    path: str
    line: int
    comment: str
    group: int | None
    configuration: str
    numbers: Mapping[str, ValueSpot]
    units: Mapping[str, str]  # of joints and external axes: deg or mm

    @property
    def is_initialised(self) -> bool:
        """Return whether a position was ever stored here, whole."""
        return bool(self.numbers) and all(spot.is_initialised for spot in self.main_numbers.values())

    @property
    def main_numbers(self) -> Mapping[str, ValueSpot]:
        """Return the numbers without external axes."""
        return {name: spot for name, spot in self.numbers.items() if not name.startswith("E")}

    @property
    def is_cartesian(self) -> bool:
        """Return whether it is stored as X, Y, Z, W, P, R."""
        return "X" in self.numbers

    def to_pose(self) -> Pose | None:
        """Return it [m]; None where it holds joints, or nothing."""
        if not (self.is_cartesian and self.is_initialised):
            return None
        x, y, z, *angles = (parse_real(self.file, self.numbers[name]) for name in CARTESIAN)
        rotation = rotation_from("fanuc_wpr", np.radians(angles))
        return Pose.from_matrix(homogeneous_matrix(rotation, np.array([x, y, z]) / 1e3))

    def to_joints(self) -> tuple[float, ...] | None:
        """Return joints [rad or m]; None where it holds a pose, or nothing."""
        return (
            None
            if self.is_cartesian or not self.is_initialised
            else self._si_values(tuple(self.main_numbers))
        )

    def external_axes(self) -> tuple[float, ...]:
        """Return external axes [rad or m]; NaN where the controller shows stars."""
        return self._si_values(tuple(name for name in self.numbers if name.startswith("E")))

    def _si_values(self, names: tuple[str, ...]) -> tuple[float, ...]:
        return tuple(
            float("nan")
            if not self.numbers[name].is_initialised
            else parse_real(self.file, self.numbers[name])
            * (1e-3 if self.units[name] == "mm" else np.pi / 180)
            for name in names
        )


class PositionLines:
    """Takes the lines of one position until the next one begins."""

    def __init__(self, file: str, line: int) -> None:
        self.file, self.line = file, line
        self.comment, self.configuration = "", ""
        self.group: int | None = None
        self.empty = False
        self.numbers: dict[str, ValueSpot] = {}
        self.units: dict[str, str] = {}

    def take_head(self, text: str) -> bool:
        """Take what stands behind ``[1,3] =``; False where it is not understood."""
        found = _HEAD.match(text)
        if found is None:
            return False
        self.comment, self.empty = found[1] or "", found[2] is not None
        return found[3] is None or self._take_group(found[3])

    def take_line(self, offset: int, text: str, line: int) -> bool:
        """Take one line; False where it is not understood."""
        if self.empty:
            return False
        if text.strip() == UNINITIALISED:
            self.empty = not self.numbers and self.group is None
            return self.empty
        if self._take_group(text):
            return True
        for pattern in (_COORDINATE, _JOINT, _EXTERNAL):
            found = _whole_line(pattern, text)
            if found:
                return all(self._take_number(match, offset, line) for match in found)
        return False

    def to_position(self, path: str) -> VaPosition:
        """Return what was taken.

        Raises
        ------
        ProgramFileError
            Lines are missing.
        """
        names = [name for name in self.numbers if not name.startswith("E")]
        joints = [f"J{i}" for i in range(1, len(names) + 1)]
        if (self.numbers or self.group is not None) and names not in (list(CARTESIAN), joints):
            raise damaged_file_error(
                self.file,
                self.line,
                make_message(
                    "{path} is not whole: it holds {names}.", path=path, names=", ".join(names) or "no number"
                ),
            )
        if not (self.empty or self.numbers):
            raise damaged_file_error(
                self.file,
                self.line,
                make_message("{path} holds no position and does not say Uninitialized.", path=path),
            )
        return VaPosition(
            self.file, path, self.line, self.comment, self.group, self.configuration, self.numbers, self.units
        )

    def _take_group(self, text: str) -> bool:
        found = _GROUP.match(text)
        if found is None or self.group is not None or self.numbers:
            return False
        self.group, self.configuration = int(found[1]), found[2] or ""
        return True

    def _take_number(self, found: re.Match[str], offset: int, line: int) -> bool:
        name = found[1]
        if name in self.numbers:
            return False
        self.numbers[name] = ValueSpot(found[2], offset + found.start(2), line)
        if found.re is not _COORDINATE:
            self.units[name] = found[3]
        return True


def _whole_line(pattern: re.Pattern[str], text: str) -> list[re.Match[str]]:
    """Return the matches that fill a line one behind the other; none where something else stands between."""
    found, at, end = [], 0, len(text.rstrip())
    while at < end:
        match = pattern.match(text, at, end)
        if match is None:
            return []
        found.append(match)
        at = match.end()
    return found
