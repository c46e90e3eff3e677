"""What a controller's files say together at one moment: identity, counts, mastering, frames, alarms, programs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import TypeVar

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.controller_files.alarm_report import AlarmReport, read_alarm_report
from cellcal.drivers.fanuc.controller_files.axis_report import AxisReport, read_axis_report
from cellcal.drivers.fanuc.controller_files.dcs_report import read_dcs_signatures
from cellcal.drivers.fanuc.controller_files.file_sources import FileSource
from cellcal.drivers.fanuc.controller_files.ftp_replies import FileNotGivenError
from cellcal.drivers.fanuc.controller_files.position_report import PositionReport, read_position_report
from cellcal.drivers.fanuc.controller_files.program_digests import read_program_digests
from cellcal.drivers.fanuc.controller_files.version_report import VersionReport, read_version_report
from cellcal.drivers.fanuc.program_files.va_backup import (
    DRIVES,
    FRAMES,
    MASTERING,
    FanucBackup,
    assemble_backup,
)
from cellcal.drivers.fanuc.program_files.va_text import VaFile

AXES, POSITION, ALARMS, VERSION, SAFETY = "AXIS.DG", "CURPOS.DG", "ERRACT.LS", "VERSION.DG", "DCSVRFY.DG"
MOST_APART = timedelta(minutes=30)
_MORE_LOOKS = 2
_VARIABLES = (MASTERING, DRIVES, FRAMES)
_EVERY_FILE = (AXES, POSITION, ALARMS, VERSION, SAFETY, *_VARIABLES)
_Report = TypeVar("_Report")


@dataclass(frozen=True, slots=True)
class ControllerFiles:
    """Every file that was read. One that the controller does not have is None, and named in ``missing``."""

    device: str
    is_live: bool
    axes: AxisReport | None
    axes_again: AxisReport | None  # read after the position; None in a backup, which holds it once
    position: PositionReport | None
    alarms: AlarmReport | None
    version: VersionReport | None
    variables: FanucBackup
    safety: Mapping[str, int] | None  # signature numbers of DCS by name
    programs: Mapping[str, str] | None  # hash by name; None where they were not read, or nothing is listed
    missing: tuple[str, ...]
    not_given: Mapping[str, str] = field(
        default_factory=dict
    )  # why, of those that it has and refuses for now
    lists_nothing: bool = False  # although its programs were asked for

    @property
    def read_names(self) -> tuple[str, ...]:
        """Return the names of the files that were read."""
        return tuple(name for name in _EVERY_FILE if name not in self.missing)

    @property
    def serial(self) -> str:
        """The F number; "" where no file tells it."""
        named = self.version.serial if self.version is not None else ""
        headings = [report.heading.f_number for report in (self.axes, self.position) if report is not None]
        return next((text for text in (named, *headings) if text), "")

    @property
    def written(self) -> datetime | None:
        """When the counts were written, by the controller's clock; of a backup without them, the other reports."""
        reports = (self.axes, self.position, self.version)
        dates = (report.heading.written for report in reports if report is not None)
        return next((date for date in dates if date is not None), None)

    def list_contradictions(self) -> tuple[str, ...]:
        """Return why the files are not of one controller at one time, as sentences."""
        dates = {
            name: report.heading.written
            for name, report in ((AXES, self.axes), (POSITION, self.position), (VERSION, self.version))
            if report is not None and report.heading.written is not None
        }
        if self.alarms is not None and self.alarms.written is not None:
            dates[ALARMS] = self.alarms.written
        found = []
        if dates and max(dates.values()) - min(dates.values()) > MOST_APART:
            listed = ", ".join(f"{name} {date:%Y-%m-%d %H:%M}" for name, date in dates.items())
            found.append(make_message("the files were not written together: {listed}", listed=listed))
        reports = (self.axes, self.position, self.version)
        numbers = {report.heading.f_number for report in reports if report is not None} - {""}
        if len(numbers) > 1:
            found.append(
                make_message(
                    "the files are of different controllers: {numbers}", numbers=", ".join(sorted(numbers))
                )
            )
        return tuple(found)


def read_controller_files(source: FileSource, *, with_programs: bool = True) -> ControllerFiles:
    """Read everything once; from a live controller the counts are read before and after the shown position.

    Raises
    ------
    DeviceError
        The controller does not answer, or the link was lost.
    ProgramFileError
        A file is damaged.
    """
    missing: list[str] = []
    not_given: dict[str, str] = {}

    def read_file(name: str) -> bytes | None:
        try:
            return source.read_file(name)
        except FileNotGivenError as error:
            not_given[name] = error.vendor_text
            return None

    def read_report(name: str, parse: Callable[[bytes], _Report]) -> _Report | None:
        content = read_file(name)
        if content is None:
            missing.append(name)
            return None
        return parse(content)

    axes = read_report(AXES, read_axis_report)
    position = read_report(POSITION, read_position_report)
    again = read_report(AXES, read_axis_report) if source.is_live and axes is not None else None
    for _ in range(_MORE_LOOKS):  # a motor under power may flicker by a count
        if axes is None or again is None or axes.pulses == again.pulses:
            break
        axes, position = again, read_report(POSITION, read_position_report)
        again = read_report(AXES, read_axis_report)
    alarms = read_report(ALARMS, read_alarm_report)
    version = read_report(VERSION, read_version_report)
    safety = read_report(SAFETY, read_dcs_signatures)
    contents = {name: read_file(name) for name in _VARIABLES}
    files = {
        name: VaFile.from_bytes(name, content) for name, content in contents.items() if content is not None
    }
    missing += [name for name in _VARIABLES if name not in files]
    is_listed = with_programs and bool(source.list_names())
    return ControllerFiles(
        device=source.device,
        is_live=source.is_live,
        axes=axes,
        axes_again=again,
        position=position,
        alarms=alarms,
        version=version,
        variables=assemble_backup(source.device, files),
        safety=safety,
        programs=read_program_digests(source) if is_listed else None,
        missing=tuple(dict.fromkeys(missing)),
        not_given=not_given,
        lists_nothing=with_programs and not is_listed,
    )
