"""The use case behind ``cellcal identify --layout`` for a cell: read, fit all series at once. Prints nothing."""

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.cells.cell import CellRobot
from cellcal.calibration.cells.identify import CellIdentification, SeriesErrors, fit_cell
from cellcal.calibration.cells.levels import CellOptions
from cellcal.calibration.cells.prediction import FoundFrame, frame_between, tool_in_flange
from cellcal.calibration.cells.robot_fit import fit_of_robot
from cellcal.calibration.geometry import quaternion_from_rotation
from cellcal.calibration.identification.cross_validation import ErrorSummary, rmse_uncertainty
from cellcal.calibration.identification.estimator import ArmFit
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.identification.offset_acceptance import (
    OffsetAcceptance,
    OffsetEvidence,
    judge_offsets,
)
from cellcal.calibration.identification.parameters import LEVEL_NAMES
from cellcal.calibration.identification.tip_uncertainty import HayatiTable, hayati_table
from cellcal.calibration.uncertainty import Decision, Verdict, coverage_factor, decide_conformity
from cellcal.service.engineering.identification.cell_gate import (
    refuse_gross_misfit_of_series,
    refuse_misfit_of_series,
)
from cellcal.service.engineering.identification.identify_verdicts import IdentificationLimits
from cellcal.service.engineering.measured.cell_rows import CellMeasurements, read_cell
from cellcal.service.engineering.measured.cells import read_cell_layout

_PLACES = ("base", "tool", "target", "device")


@dataclass(frozen=True, slots=True)
class RejectedLine:
    """A row of the file that was not fitted, and why."""

    series: str
    line: int
    reason: str


@dataclass(frozen=True, slots=True)
class SeriesReport:
    """One series of the cell, in SI."""

    name: str
    kind: str
    device: str
    target: str
    rows: int
    rejected: int
    before: ErrorSummary
    fit: ErrorSummary
    held_out: ErrorSummary
    scale: tuple[float, ...]  # found deviation / stated sigma: lengths, attitudes
    redundant: float
    verdict: Decision | None  # of the held-out RMSE against the limit, if there is one


@dataclass(frozen=True, slots=True)
class FrameReport:
    """A frame that was found, with standard deviations along and about its own axes."""

    name: str
    seen_from: str
    position_m: tuple[float, ...]
    quaternion: tuple[float, ...]
    sigma: tuple[float, ...]  # x y z [m], rx ry rz [rad]


@dataclass(frozen=True, eq=False)
class ArmReport:
    """One robot of the cell as if it had been fitted alone."""

    name: str
    fit: ArmFit
    dh: HayatiTable | None  # of an arm that has a table
    offsets: OffsetAcceptance | None  # if a limit was set


@dataclass(frozen=True, slots=True)
class CellParameter:
    """One number of an arm or device in SI, with its standard deviation and what its prior allowed."""

    name: str
    unit: str
    value: float
    sigma: float
    prior: float


@dataclass(frozen=True, eq=False)
class IdentifiedCellReport:
    """Everything there is to say about one file of a cell."""

    level: int
    seconds: float
    identification: CellIdentification
    measurements: CellMeasurements
    series: tuple[SeriesReport, ...]
    rejected: tuple[RejectedLine, ...]
    frames: tuple[FrameReport, ...]
    parameters: tuple[CellParameter, ...]
    arms: tuple[ArmReport, ...]

    @property
    def is_proved(self) -> bool:
        """Whether every limit that was set is proved to be kept."""
        verdicts = [series.verdict.verdict for series in self.series if series.verdict is not None]
        verdicts += [arm.offsets.verdict for arm in self.arms if arm.offsets is not None]
        return all(verdict is Verdict.PASS for verdict in verdicts)

    @property
    def coverage_factor(self) -> float:
        """The factor from a standard deviation to 95 %: Student's, if few independent rows determine it."""
        return coverage_factor(max(self.identification.robust.degrees_of_freedom, 1.0))

    def as_document(self) -> dict[str, object]:
        """Return the object that ``--json`` prints."""
        found = self.identification
        return {
            "level": self.level,
            "level_name": LEVEL_NAMES[self.level],
            "level_reasons": list(found.level_reasons),
            "rows": self.measurements.read,
            "series": [asdict(series) for series in self.series],
            "rejected": [asdict(line) for line in self.rejected],
            "group_effects": list(found.group_effects),
            "left_out": dict(self.measurements.left_out),
            "frames": [asdict(frame) for frame in self.frames],
            "parameters": [asdict(parameter) for parameter in self.parameters],
            "not_identified": [
                {"parameter": item.parameter, "partner": item.partner, "cure": item.cure}
                for item in found.not_identified
            ],
            "correlated": [asdict(pair) for pair in found.correlated],
            "coverage_factor": self.coverage_factor,
            "offsets": {arm.name: asdict(arm.offsets) for arm in self.arms if arm.offsets is not None},
            "seconds": self.seconds,
        }


def identify_cell_file(
    path: Path, layout: Path, robot: str, options: CellOptions, limits: IdentificationLimits | None = None
) -> IdentifiedCellReport:
    """Identify all that a file and its layout say about a cell.

    A limit of errors is judged series by series, by rows that were held out; one of offsets robot by robot.

    Raises
    ------
    MeasurementError
        File or layout cannot be understood.
    CalibrationError
        No such robot model, or rows that cannot place what they are about.
    """
    started = time.perf_counter()
    described = read_cell_layout(layout)
    measurements = read_cell(path, described, robot)
    limits = limits or IdentificationLimits()
    refuse_misfit_of_series(measurements.cell, described)
    found = fit_cell(measurements.cell, options)
    refuse_gross_misfit_of_series(measurements.cell, found)
    return IdentifiedCellReport(
        found.level,
        time.perf_counter() - started,
        found,
        measurements,
        _series_reports(found, measurements, limits),
        tuple(
            RejectedLine(row.series, int(measurements.lines[row.series][row.row]), row.reason)
            for row in found.rejected
        ),
        _frame_reports(found, measurements),
        _cell_parameters(found),
        _arm_reports(found, limits),
    )


def _series_reports(
    found: CellIdentification, measurements: CellMeasurements, limits: IdentificationLimits
) -> tuple[SeriesReport, ...]:
    return tuple(
        SeriesReport(
            series.name,
            series.observations.kind,
            series.device,
            series.target,
            len(series.observations),
            len(result.rejected),
            errors.before_errors,
            errors.fit_errors,
            errors.after_errors,
            tuple(float(scale) for scale in result.scale),
            result.degrees_of_freedom,
            _judge_series(errors, groups, limits.error_m),
        )
        for series, errors, result, groups in zip(
            measurements.cell.series, found.series, found.robust.series, found.groups, strict=True
        )
    )


def _judge_series(errors: SeriesErrors, groups: Rows, limit_m: float | None) -> Decision | None:
    held_out_groups = groups[errors.held_out]
    if (
        limit_m is None or len(np.unique(held_out_groups)) < 2
    ):  # a short series is never held out: nothing to judge by
        return None
    value, sigma, freedom = rmse_uncertainty(errors.held_out_m, held_out_groups)
    return decide_conformity(value, sigma, limit_m, degrees_of_freedom=freedom)


def _arm_reports(found: CellIdentification, limits: IdentificationLimits) -> tuple[ArmReport, ...]:
    return tuple(_arm_report(found, robot, limits) for robot in found.robust.fit.layout.frames.cell.robots)


def _arm_report(found: CellIdentification, robot: CellRobot, limits: IdentificationLimits) -> ArmReport:
    cell = found.robust.fit.layout.frames.cell
    fit = fit_of_robot(found.robust.fit, robot.name)
    table = None if robot.model.dh is None or not len(fit.layout) else hayati_table(fit)
    if limits.offset_sigma_rad is None:
        return ArmReport(robot.name, fit, table, None)
    mark = f"{robot.name} " if len(cell.robots) > 1 else ""
    hidden = tuple(
        replace(item, parameter=item.parameter.removeprefix(mark))
        for item in found.not_identified
        if item.parameter.startswith(mark)
    )
    mine = [s.name for s in cell.series if cell.robot_of(s.target) is robot]
    rows = sum(len(r.deviations) - len(r.rejected) for r in found.robust.series if r.name in mine)
    evidence = OffsetEvidence(fit, rows, found.robust.degrees_of_freedom, hidden)
    return ArmReport(robot.name, fit, table, judge_offsets(evidence, limits.offset_sigma_rad, limits.offsets))


def _frame_reports(found: CellIdentification, measurements: CellMeasurements) -> tuple[FrameReport, ...]:
    """Return bases and devices as the first robot sees them, and tools in their flanges."""
    cell, fit = measurements.cell, found.robust.fit
    first = cell.robots[0].name
    located = {s.device for s in cell.series if s.observations.place_axes}
    placed = [
        *((robot.name, robot.name, 0) for robot in cell.robots[1:]),
        *(
            (called, device, mounting)
            for device, names in measurements.standings.items()
            for mounting, called in enumerate(names)
            if device in located
        ),
    ]
    return (
        *(
            _frame_report(called, first, frame_between(fit, first, name, mounting=mounting))
            for called, name, mounting in placed
        ),
        *(
            _frame_report(tool.name, f"flange of {tool.robot}", tool_in_flange(fit, tool.name))
            for tool in cell.tools
        ),
    )


def _frame_report(name: str, outer: str, frame: FoundFrame) -> FrameReport:
    quaternion = quaternion_from_rotation(frame.pose[:3, :3])
    position, sigma = frame.pose[:3, 3].tolist(), frame.sigma.tolist()
    return FrameReport(name, outer, tuple(position), tuple(quaternion.tolist()), tuple(sigma))


def _cell_parameters(found: CellIdentification) -> tuple[CellParameter, ...]:
    fit = found.robust.fit
    sigma = np.sqrt(np.diag(fit.covariance))
    return tuple(
        CellParameter(item.name, item.unit, float(value), float(deviation), item.prior)
        for item, value, deviation in zip(fit.layout.parameters, fit.deviations, sigma, strict=True)
        if item.role not in _PLACES
    )
