"""Readings of several devices, targets or robots, which a layout names: identified together for a page."""

from pathlib import Path

from cellcal.calibration.cells.levels import CellOptions
from cellcal.calibration.errors import CellError
from cellcal.service.engineering.identification.cell_findings import identified_numbers
from cellcal.service.engineering.identification.cell_identify import IdentifiedCellReport, identify_cell_file
from cellcal.service.engineering.identification.cell_outputs import save_cell
from cellcal.service.engineering.identification.jobs.descriptions import NOT_SAVABLE
from cellcal.service.engineering.identification.jobs.findings_document import findings_document
from cellcal.service.engineering.identification.jobs.shapes import (
    DRAFTS,
    LAYOUT,
    SOURCES,
    IdentifyWishes,
    JobRequest,
)
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.parameters.parameter_files import SetOrigin

_NO_ROWS: dict[str, object] = {
    "rows": [],
    "before_m": [],
    "held_out_m": [],
    "rejected": [],
    "rows_per_point": 1,
}


def identify_uploaded_cell(folder: Path, request: JobRequest) -> dict[str, object]:
    """Identify as a layout of several readings says; return what a page is shown, and write a draft of the set.

    Raises
    ------
    CellError
        File or layout cannot be understood, or something was asked for that several readings do not know.
    """
    wishes = request.wishes
    file, layout = folder / SOURCES / request.file, folder / LAYOUT / request.layout
    if request.check or wishes != IdentifyWishes(level=wishes.level):
        raise MeasurementError(
            "a layout of several readings says itself what its columns are, and has no check file.",
            remedy="Bring the measurements and the layout along, and nothing else; the level may be chosen.",
        )
    report = identify_cell_file(file, layout, request.model, CellOptions(level=wishes.level))
    return cell_result_document(report) | {"not_savable": _write_draft(report, file, folder, request)}


def cell_result_document(report: IdentifiedCellReport) -> dict[str, object]:
    """Return what a page is shown of a report, without what is said of saving it."""
    return {
        "report": report.as_document(),
        **findings_document(*identified_numbers(report), report.identification.not_identified),
        "row_errors": _NO_ROWS,
        "understood": {},
        "series": [
            {
                "name": series.name,
                "rows": series.rows,
                "rejected": series.rejected,
                "is_held_out": series.held_out.n > 0,
                "before_m": series.before.rmse_m,
                "held_out_m": series.held_out.rmse_m,
                "fit_m": series.fit.rmse_m,
            }
            for series in report.series
        ],
    }


def _write_draft(
    report: IdentifiedCellReport, file: Path, folder: Path, request: JobRequest
) -> dict[str, str] | None:
    """Write the arm's parameters as a set that only this job has; return why there is nothing to save, if so."""
    if request.described:
        return NOT_SAVABLE
    if len(report.arms) > 1:
        return {
            "message": "several robots were identified, and each has its own parameters.",
            "remedy": "Save them with `cellcal identify --layout --save --serial` at the service's computer.",
        }
    origin = SetOrigin(request.serial, request.who, request.at_utc)
    try:
        save_cell(report, file, folder / DRAFTS, {report.arms[0].name: request.serial}, origin)
    except CellError as error:
        return {"message": error.message, "remedy": error.remedy}
    return None
