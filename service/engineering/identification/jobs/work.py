"""The process that identifies a robot from an uploaded file: one job, in a folder of its own, progress line by line.

The file is read here and nowhere else, within limits of memory and processor time.
"""

import contextlib
import json
import logging
import os
import sys
import threading
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.errors import CellError
from cellcal.calibration.identification.work_parts import PartRunner
from cellcal.calibration.message_table import with_messages
from cellcal.service.engineering.identification.forked_parts import share_parts
from cellcal.service.engineering.identification.identify import IdentifyReport, identify_file
from cellcal.service.engineering.identification.identify_check import prepare_measurements
from cellcal.service.engineering.identification.identify_findings import (
    identified_rows,
    unknown_of,
)
from cellcal.service.engineering.identification.identify_outputs import save_identification
from cellcal.service.engineering.identification.jobs.cell_work import identify_uploaded_cell
from cellcal.service.engineering.identification.jobs.descriptions import NOT_SAVABLE
from cellcal.service.engineering.identification.jobs.findings_document import findings_document
from cellcal.service.engineering.identification.jobs.limits import IdentifyProcessLimits
from cellcal.service.engineering.identification.jobs.shapes import (
    CHECK,
    DESCRIBED,
    DRAFTS,
    JOINTS,
    LAYOUT,
    REQUEST_FILE,
    RESULT_FILE,
    SOURCES,
    JobRequest,
)
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from cellcal.service.engineering.job_processes import finish_job, leave_with_the_service, write_message
from cellcal.service.engineering.measured.cells import describes_a_cell
from cellcal.service.engineering.measured.layouts import layout_document, overlay_options, read_layout
from cellcal.service.engineering.measured.measurements import ReadOptions
from cellcal.service.engineering.measured.table import read_table
from cellcal.service.engineering.measured.usable_rows import OUTLIER
from cellcal.service.engineering.parameters.parameter_files import SetOrigin
from cellcal.service.unexpected_errors import log_in_lines, run_guarded

_MOST_POINTS = 1500  # of the plot
_MOST_HEADINGS, _LONGEST_HEADING = 200, 200
_NICENESS = 10  # the cell's own processes come first
_log = logging.getLogger(__name__)


class _MessageDisplay:
    """Writes progress to the service."""

    def __init__(self) -> None:
        self._written: tuple[int, int] | None = None

    def show_stage(self, text: str) -> None:
        """Write what is being done from now on."""
        write_message(stage=text)

    def show_parts(self, done: int, begun: int) -> None:
        """Write how many parts are done, where that has changed."""
        if (done, begun) != self._written:
            self._written = (done, begun)
            write_message(done=done, total=begun)


def identify_upload(folder: Path) -> None:
    """Identify as the request in a folder says, and write the result and a draft of the parameter set beside it.

    Raises
    ------
    CellError
        The file cannot be read, or does not fit the robot.
    """
    folder = folder.absolute()
    request = JobRequest.model_validate_json(read_plain_text(folder / REQUEST_FILE))
    display = _MessageDisplay()
    display.show_stage("reading the measurements")
    with share_parts(display) as runner:  # before any thread begins: it forks
        threading.Thread(target=leave_with_the_service, daemon=True).start()
        # A description is named by its file alone, so that no sentence names folders of this computer.
        with contextlib.chdir(folder / DESCRIBED if request.described else Path.cwd()):
            result = (
                identify_uploaded_cell(folder, request)
                if request.layout and describes_a_cell(folder / LAYOUT / request.layout)
                else _identify_one_device(folder, request, runner)
            )
    text = json.dumps(with_messages(result), allow_nan=False)
    (folder / RESULT_FILE).write_text(text, encoding="utf-8")


def _identify_one_device(folder: Path, request: JobRequest, runner: PartRunner) -> dict[str, object]:
    file = folder / SOURCES / request.file
    options = _options_of(folder, request)
    headings = _headings_of(file, options.read.sheet)
    if options.read.joints_file is not None:
        headings += _headings_of(options.read.joints_file, None)
    write_message(headings=list(dict.fromkeys(headings))[:_MOST_HEADINGS])
    try:
        report = identify_file(file, request.model, options, runner)
    except CellError:
        _write_understood(file, request.model, options.read)
        raise
    return result_document(report) | {
        "understood": layout_document(report.measurements, options.read),
        "not_savable": _write_draft(report, file, folder, request),
    }


def _write_understood(file: Path, model: str, read: ReadOptions) -> None:
    """Write how a file was read whose measurements do not fit, so that a page can ask what was read wrongly."""
    with contextlib.suppress(CellError):  # it could not be read: that is the fault that is reported
        prepared = prepare_measurements(file, load_model(model), read)
        write_message(understood=layout_document(prepared.measurements, read))


def _options_of(folder: Path, request: JobRequest) -> IdentifyOptions:
    """Return what was asked for: what the page says stands above what a layout file says."""
    wishes = request.wishes
    joints = folder / JOINTS / request.joints if request.joints else None
    columns = {str(meaning): names for meaning, names in wishes.columns.items()}
    units = {str(meaning): unit for meaning, unit in wishes.units.items()}
    read = ReadOptions(columns, units, wishes.convention, wishes.sheet or None, wishes.joint_coupling, joints)
    if request.layout:
        read = overlay_options(read_layout(folder / LAYOUT / request.layout), read)
    check = folder / CHECK / request.check if request.check else None
    return IdentifyOptions(level=wishes.level, check=check, read=read)


def _headings_of(file: Path, sheet: str | None) -> list[str]:
    """Return the names of a file's columns, so that a page can ask which is which."""
    return [name[:_LONGEST_HEADING] for name in read_table(file, sheet=sheet).names[:_MOST_HEADINGS]]


def result_document(report: IdentifyReport) -> dict[str, object]:
    """Return what a page is shown of a report, without what is said of saving it."""
    return {
        "report": report.as_document(),
        **findings_document(*identified_rows(report), unknown_of(report)),
        "row_errors": _row_errors(report),
        "series": [],
    }


def _row_errors(report: IdentifyReport) -> dict[str, object]:
    """Return the errors of rows in their order; of many rows, in each few the row with the largest."""
    order = np.argsort(report.held_out_rows, kind="stable")
    per_point = -(-len(order) // _MOST_POINTS)
    chosen = [
        max(some, key=lambda row: float(report.held_out_m[row]))
        for some in (order[at : at + per_point] for at in range(0, len(order), per_point))
    ]
    outliers = {row.row for row in report.rejected if row.kind == OUTLIER}
    rows = [int(report.held_out_rows[row]) for row in chosen]
    return {
        "rows": rows,
        "before_m": [float(report.before_m[row]) for row in chosen],
        "held_out_m": [float(report.held_out_m[row]) for row in chosen],
        "rejected": [row in outliers for row in rows],
        "rows_per_point": per_point,
    }


def _write_draft(
    report: IdentifyReport, file: Path, folder: Path, request: JobRequest
) -> dict[str, str] | None:
    """Write the parameters as a set that only this job has; return why there is nothing to save, if so."""
    if request.described:
        return NOT_SAVABLE
    origin = SetOrigin(request.serial, request.who, request.at_utc)
    try:
        save_identification(report, file, folder / DRAFTS, origin)
    except CellError as error:
        return {"message": error.message, "remedy": error.remedy}
    return None


def main() -> None:
    """Carry out one job: its folder is named, and the limits of this process."""
    log_in_lines()
    limits = IdentifyProcessLimits(*map(int, sys.argv[2:4]))
    limits.impose()
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    finish_job(lambda: identify_upload(Path(sys.argv[1])), limits, _log, "an identification")


if __name__ == "__main__":
    sys.exit(run_guarded(main))
