"""CURPOS.DG: the joints that the controller shows, to a hundredth of a degree, and where it has the tool's tip.

::

    CURRENT ROBOT POSITION::
    Group #:  1

    CURRENT JOINT POSITION:
    Joint   1:    -35.00
    EXTAXS: 1:  -1444.07

    Frame #:   3  Tool #:   1
    CURRENT USER FRAME POSITION:

    Tool #:   1
    CURRENT WORLD POSITION:
    X:   1505.56
"""

import re
from dataclasses import dataclass, field

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.controller_files.report_text import (
    ReportHeading,
    damaged_report_error,
    decode_report,
    read_heading,
)

_GROUP = re.compile(r"\s*GROUP\s*#?\s*:?\s*(\d+)", re.IGNORECASE)
_JOINTS = re.compile(r"\s*CURRENT\s+JOINT\s+POSITION", re.IGNORECASE)
_OTHER_SECTION = re.compile(r"\s*(?:CURRENT\s+(?!JOINT)|FRAME\s*#|TOOL\s*#)", re.IGNORECASE)
_WORLD = re.compile(r"\s*CURRENT\s+WORLD\s+POSITION", re.IGNORECASE)
_PLACE = re.compile(r"\s*([XYZ])\s*[:=]\s*(\S+)", re.IGNORECASE)
_JOINT = re.compile(r"\s*(?:JOINT|J)\s*(\d+)\s*[:=]\s*(\S+)", re.IGNORECASE)
_SELECTED = re.compile(r"\s*FRAME\s*#\s*:\s*(\d+)\s+TOOL\s*#\s*:\s*(\d+)", re.IGNORECASE)
_EXTENDED = re.compile(r"\s*EXTAXS\s*:(.*)", re.IGNORECASE)
_EXTENDED_AXIS = re.compile(r"\s*(\d)\s*:\s*(\S+)")
_ANGLE = re.compile(r"[+-]?(?:\d{1,6}(?:\.\d{0,6})?|\.\d{1,6})\Z")


@dataclass(frozen=True, slots=True)
class GroupPosition:
    """The position of one motion group; a joint is None where the controller shows no number.

    Extended axes follow the joints of the arm; one that slides is in millimetres.
    """

    group: int
    joints_deg: tuple[float | None, ...]
    frame: int | None = None
    tool: int | None = None
    world_tip_mm: tuple[float, float, float] | None = None  # of that tool; None where the file does not tell
    is_extended: bool = False  # it holds extended axes, which may carry the arm


@dataclass(frozen=True, slots=True)
class PositionReport:
    """The positions that the controller reports of its robots."""

    heading: ReportHeading
    groups: tuple[GroupPosition, ...]

    def find_group(self, group: int) -> GroupPosition | None:
        """Return a motion group; None where the report has none."""
        return next((each for each in self.groups if each.group == group), None)


@dataclass(slots=True)
class _OpenGroup:
    group: int
    joints: dict[int, float | None] = field(default_factory=dict)
    extended: dict[int, float | None] = field(default_factory=dict)
    frame: int | None = None
    tool: int | None = None
    world: dict[str, float] = field(default_factory=dict)


def read_position_report(data: bytes, file: str = "curpos.dg") -> PositionReport:
    """Read the shown joints of every group.

    Raises
    ------
    ProgramFileError
        There are none, or a joint is missing or no number.
    """
    lines = decode_report(file, data)
    groups: list[_OpenGroup] = []
    inside = in_world = False
    for number, line in enumerate(lines, 1):
        group, selected = _GROUP.match(line), _SELECTED.match(line)
        if group is not None:
            groups.append(_OpenGroup(int(group[1])))
            inside = in_world = False
        elif _JOINTS.match(line):
            inside = True
            groups = groups or [_OpenGroup(1)]
        elif selected is not None and groups:
            groups[-1].frame, groups[-1].tool = int(selected[1]), int(selected[2])
        inside = inside and not _OTHER_SECTION.match(line)
        in_world = (in_world or _WORLD.match(line) is not None) and bool(groups)
        if inside:
            _take_joint(groups[-1], line, file, number)
        elif in_world:
            _take_place(groups[-1], line)
    if not any(group.joints for group in groups):
        raise damaged_report_error(file, "it holds no joints (CURRENT JOINT POSITION).")
    return PositionReport(read_heading(lines), tuple(_close_group(group, file) for group in groups))


def _take_joint(group: _OpenGroup, line: str, file: str, number: int) -> None:
    extended = _EXTENDED.match(line)
    for axis, text in _EXTENDED_AXIS.findall(extended[1]) if extended else ():
        _take_value(group.extended, int(axis), text, file, number)
    found = _JOINT.match(line)
    if found is not None:
        _take_value(group.joints, int(found[1]), found[2], file, number)


def _take_place(group: _OpenGroup, line: str) -> None:
    """Take up a coordinate of the tip in the world; what is no number there is not told."""
    found = _PLACE.match(line)
    if found is not None and _ANGLE.match(found[2]):
        group.world.setdefault(found[1].upper(), float(found[2]))


def _take_value(values: dict[int, float | None], axis: int, text: str, file: str, number: int) -> None:
    if axis in values:
        raise damaged_report_error(
            file, make_message("joint {axis} is there a second time.", axis=axis), number
        )
    unknown = set(text) == {"*"}
    if not unknown and not _ANGLE.match(text):
        raise damaged_report_error(file, make_message("{text!r} is no angle.", text=text[:40]), number)
    values[axis] = None if unknown else float(text)


def _close_group(group: _OpenGroup, file: str) -> GroupPosition:
    last = max(group.joints, default=0)
    values = {**group.joints, **{last + axis: value for axis, value in group.extended.items()}}
    if sorted(values) != list(range(1, len(values) + 1)):
        axes = ", ".join(map(str, sorted(values)))
        raise damaged_report_error(
            file, make_message("joints {axes} are there; one between is missing.", axes=axes)
        )
    joints = tuple(values[axis] for axis in sorted(values))
    world = group.world
    tip = (world["X"], world["Y"], world["Z"]) if len(world) == len("XYZ") else None
    return GroupPosition(group.group, joints, group.frame, group.tool, tip, bool(group.extended))
