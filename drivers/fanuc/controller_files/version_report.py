"""VERSION.DG: whose controller it is, its software and its robots."""

import re
from dataclasses import dataclass

from cellcal.drivers.fanuc.controller_files.report_text import ReportHeading, decode_report, read_heading

_FIELD = re.compile(r"\s*([^:]+?)\s*:\s*(.*?)\s*\Z")
_ROBOT = re.compile(r"\s*(\S.*?)\s{2,}(V\d\S*)\s*\Z")
_OPTION = re.compile(r"\s*(\S.*?)\s{2,}([A-Z0-9]{4})\s*\Z")
_CONFIG = re.compile(r"\s*CONFIG\s*::?", re.IGNORECASE)
_SECTION = re.compile(r"\s*[A-Z][A-Z0-9 ]*::\s*\Z", re.IGNORECASE)
_MAKES = re.compile(r"(?:[A-Z]{1,3}-\d|CRX|SR-|DR-|LR\s?MATE|ARC\s?MATE)", re.IGNORECASE)


def is_edition(software: str) -> bool:
    """Whether a text is a software edition (V9.40P/26) and not the version of a report's heading (V9.40526)."""
    return "/" in software


@dataclass(frozen=True, slots=True)
class VersionReport:
    """The identity that the controller reports; texts are empty where it does not."""

    heading: ReportHeading
    robot_number: str  # the F number of the robot
    software: str
    robots: tuple[
        str, ...
    ]  # names of the robots of the software, such as R-2000iC/165F; see read_version_report
    options: tuple[str, ...]  # order numbers

    @property
    def serial(self) -> str:
        """The F number: of the robot, else the controller's."""
        return self.robot_number or self.heading.f_number


def read_version_report(data: bytes, file: str = "version.dg") -> VersionReport:
    """Read it; a report without these fields tells nothing, and is no fault.

    The line of the robot may name another motion group (``Independent Axes  V8.20P/A2``): then the robots are those
    of the list of options (seen in five public backups).
    """
    lines = decode_report(file, data)[:-1]  # a last line without an end may be cut inside a number
    fields: dict[str, str] = {}
    robots: list[str] = []
    options: dict[str, str] = {}  # order number by name
    in_options = False
    for line in lines:
        if _SECTION.match(line):
            in_options = _CONFIG.match(line) is not None
            continue
        option, robot, pair = _OPTION.match(line), _ROBOT.match(line), _FIELD.match(line)
        if in_options and option is not None:
            options[option[1]] = option[2]
        elif robot is not None and _MAKES.match(robot[1]) and ":" not in robot[1]:
            robots.append(robot[1])
        elif pair is not None:
            fields.setdefault(pair[1].upper().rstrip("."), pair[2])
    return VersionReport(
        heading=read_heading(lines),
        robot_number=fields.get("ROBOT NO", ""),
        software=fields.get("SOFTWARE EDITION NO", "") or read_heading(lines).software,
        robots=tuple(dict.fromkeys(robots or filter(_MAKES.match, options))),
        options=tuple(options.values()),
    )
