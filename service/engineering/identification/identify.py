"""The use case behind ``cellcal identify``: read, sharpen, fit, cross-validate, check. Prints nothing."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.column_options import columns_option
from cellcal.calibration.identification.cross_validation import ErrorSummary
from cellcal.calibration.identification.effect_lint import without_play
from cellcal.calibration.identification.frame_fits import mount_at_breaks
from cellcal.calibration.identification.free_parameters import PartLayout, parameter_values
from cellcal.calibration.identification.identify import Identification
from cellcal.calibration.identification.last_joint import DIRECTION, last_joint_note
from cellcal.calibration.identification.lints import Lint, find_calculated_positions
from cellcal.calibration.identification.misfit import refuse_gross_misfit
from cellcal.calibration.identification.misfit_zeros import refuse_far_zero_of_fit
from cellcal.calibration.identification.observations import Observations, Rows
from cellcal.calibration.identification.parameters import LEVEL_NAMES
from cellcal.calibration.identification.position_scale import (
    scale_note,
)
from cellcal.calibration.identification.residual_model import errors_with
from cellcal.calibration.identification.tip_uncertainty import HayatiTable, hayati_table
from cellcal.calibration.identification.work_parts import SERIAL, PartRunner
from cellcal.calibration.message import make_message
from cellcal.calibration.uncertainty import coverage_factor
from cellcal.service.engineering.identification.described_errors import DescribedErrors, described_errors
from cellcal.service.engineering.identification.fixed_joints import naming_fixed_joints
from cellcal.service.engineering.identification.identify_check import (
    CheckedFile,
    PreparedMeasurements,
    check_file,
    errors_of,
    file_names,
    lint_repeated_postures,
    lints_of_fit,
    lints_of_start,
    prepare_measurements,
    read_check_file,
)
from cellcal.service.engineering.identification.identify_start import (
    IdentificationStart,
    places_document,
    read_start,
)
from cellcal.service.engineering.identification.identify_verdicts import (
    IdentificationLimits,
    IdentificationVerdicts,
    judge_limits,
)
from cellcal.service.engineering.identification.row_fit import FittedRows, IdentifyOptions, fit_rows
from cellcal.service.engineering.measured.difference_words import sum_remedy
from cellcal.service.engineering.measured.measurements import Measurements
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.measured.usable_rows import ELSEWHERE, OUTLIER, RejectedRow
from cellcal.service.engineering.parameters.identified_parameter import IdentifiedParameter


@dataclass(frozen=True, eq=False)
class IdentifyReport:
    """The result of an identification of one file of measurements."""

    robot: str
    rows: int
    level: int
    before: ErrorSummary
    fit: ErrorSummary
    held_out: ErrorSummary
    check: ErrorSummary | None
    rejected: tuple[RejectedRow, ...]
    seconds: float
    identification: Identification
    measurements: Measurements
    parameters: tuple[IdentifiedParameter, ...]
    lints: tuple[Lint, ...]
    breaks: tuple[int, ...]  # rows of the file
    fitted_rows: Rows  # of the file, the rejected ones included
    held_out_rows: Rows  # of the file; the errors below belong to them
    held_out_m: Array
    before_m: Array
    held_out_by: str
    start: str  # what the fit and the figures "before" start from
    with_residual: ErrorSummary | None  # held out, if a residual model was asked for
    check_with_residual: ErrorSummary | None
    verdicts: IdentificationVerdicts
    dh: HayatiTable | None  # of an arm that has a table

    @property
    def coverage(self) -> float:
        """The factor from a standard deviation to 95 %: Student's, if few independent rows determine it."""
        return coverage_factor(max(self.identification.robust.degrees_of_freedom, 1.0))

    @property
    def described(self) -> DescribedErrors | None:
        """Errors of the rows that the model describes; none where no row was put aside (decision 337)."""
        return described_errors(self.rejected, self.held_out_rows, self.before_m, self.held_out_m)

    def as_document(self) -> dict[str, object]:
        """Return the object that ``--json`` prints."""
        found, described = self.identification, self.described
        return {
            "robot": self.robot,
            "level": self.level,
            "rows": self.rows,
            "before": asdict(self.before),
            "fit": asdict(self.fit),
            "held_out": asdict(self.held_out),
            "check": None if self.check is None else asdict(self.check),
            "breaks": list(self.breaks),
            "rejected": [asdict(row) for row in self.rejected],
            "not_identified": [
                {"parameter": item.parameter, "partner": item.partner, "cure": item.cure}
                for item in found.not_identified
            ],
            "seconds": self.seconds,
            "before_described": None if described is None else asdict(described.before),
            "held_out_described": None if described is None else asdict(described.held_out),
            "usable": len(self.measurements.rows),
            "level_name": LEVEL_NAMES[self.level],
            "level_reasons": list(found.level_reasons),
            "break_reasons": list(found.break_reasons),
            "held_out_by": self.held_out_by,
            "folds": [
                {"level": level, "breaks": [int(self.fitted_rows[row]) for row in breaks]}
                for level, breaks in zip(found.judgement.levels, found.judgement.breaks, strict=True)
            ],
            "parameters": [asdict(parameter) for parameter in self.parameters],
            "correlated": [asdict(pair) for pair in found.correlated],
            "lints": [asdict(lint) for lint in self.lints],
            "guesses": list(self.measurements.guesses),
            "start": self.start,
            "places": places_document(found.state, self.measurements.observations.kind),
            "degrees_of_freedom": found.robust.degrees_of_freedom,
            "coverage_factor": self.coverage,
            "group_effect": asdict(found.group_effect),
            "residual_model": self._residual_document(),
            "verdicts": {
                "error": None if self.verdicts.error is None else asdict(self.verdicts.error),
                "offsets": None if self.verdicts.offsets is None else asdict(self.verdicts.offsets),
            },
        }

    def _residual_document(self) -> dict[str, object] | None:
        residual = self.identification.residual
        if residual is None or self.with_residual is None:
            return None
        check = self.check_with_residual
        return {
            "chosen": residual.chosen,
            "reason": residual.reason,
            "held_out": asdict(self.with_residual),
            "check": None if check is None else asdict(check),
            "sigma_far_from_data_m": float(np.sqrt(residual.model.variance_m2)),
        }


def identify_file(
    path: Path, robot: str, options: IdentifyOptions | None = None, runner: PartRunner = SERIAL
) -> IdentifyReport:
    """Identify a robot from a file of measurements; the runner carries out what can be done side by side.

    Raises
    ------
    MeasurementError
        A file cannot be understood, or ``train_rows`` leaves nothing to hold out.
    CalibrationError
        No such robot model, or too few rows.
    """
    options = options or IdentifyOptions()
    _refuse_check_without_joints(options)
    started = time.perf_counter()
    model = load_model(robot)
    prepared = prepare_measurements(path, model, options.read)
    runner.show_stage("looking whether the rows fit the robot")
    start = read_start(options.start, model, prepared.observations.kind)
    other = None if options.check is None else read_check_file(options.check, options.read, model, prepared)
    with naming_fixed_joints(path, robot, options.read):
        fitted = fit_rows(model, prepared, start, options, runner)
    prepared, (train, held_out), found = fitted.prepared, fitted.split, fitted.found
    breaks = [int(train[item.row]) for item in found.breaks]
    judged = _judge_held_out(prepared, found, (train, held_out), breaks)
    calculated = _refuse_judged(model, prepared, judged)
    refuse_far_zero_of_fit(fitted.chain, fitted.rows, found.robust, file_names(prepared.measurements))
    checked = None if other is None else check_file(other, found, prepared)
    measurements = prepared.measurements
    noticed = [*prepared.noticed]
    if fitted.elsewhere is not None:
        noticed.append(fitted.elsewhere.describe_in_file(model, measurements.rows))
    if len(held_out):
        noticed += lint_repeated_postures(measurements, train, held_out)
    noticed += _lints_of_rows(fitted, lints_of_fit(found, judged.before_m, prepared, train))
    if not _say_calculated(noticed):
        noticed += calculated
    return IdentifyReport(
        robot=model.name,
        rows=measurements.read,
        level=found.level,
        before=ErrorSummary.from_sizes(judged.before_m),
        fit=found.fit_errors,
        held_out=ErrorSummary.from_sizes(judged.held_out_m),
        check=None if checked is None else ErrorSummary.from_sizes(checked.errors_m),
        rejected=_rejected_rows(fitted),
        seconds=time.perf_counter() - started,
        identification=found,
        measurements=measurements,
        parameters=_identified_parameters(found, start.sigmas),
        lints=(*noticed, *_lints_of_start(found, start, judged), *(() if checked is None else checked.lints)),
        breaks=tuple(int(measurements.rows[row]) for row in breaks),
        fitted_rows=measurements.rows[train],
        held_out_rows=measurements.rows[judged.rows],
        held_out_m=judged.held_out_m,
        before_m=judged.before_m,
        held_out_by=judged.by,
        start=start.name,
        with_residual=judged.with_residual,
        check_with_residual=None if checked is None else checked.with_residual,
        verdicts=_build_verdicts(options.limits, found, judged, checked),
        dh=None if model.dh is None else hayati_table(found.robust.fit),
    )


def _refuse_check_without_joints(options: IdentifyOptions) -> None:
    if options.check is not None and options.read.joints_file is not None:
        raise MeasurementError(
            "--joints names the joints of one file, and --check is another.",
            remedy="Bring joints and readings of the check file into one file, or hold rows out by `--train-rows`.",
        )


def _refuse_judged(model: RobotModel, prepared: PreparedMeasurements, judged: "_HeldOutErrors") -> list[Lint]:
    """Refuse what does not fit, and places that a controller calculated beside others; name those that stand alone.

    Raises
    ------
    MeasurementError
        The places are calculated, and the rows hold others that may be measured.
    """
    measured = prepared.measurements
    refuse_gross_misfit(model, prepared.observations, judged.held_out_m, file_names(measured))
    calculated = find_calculated_positions(judged.held_out_m, measured.value_step_m)
    layout = measured.layout
    if calculated and (layout.further or layout.differences) and not layout.is_named:
        raise MeasurementError(
            make_message(
                "{columns} are calculated by a controller, not measured: a model of its own fits them to "
                "{left_mm:.4f} mm, closer than an arm repeats.",
                columns=", ".join(layout.position),
                left_mm=float(np.median(judged.held_out_m)) * 1e3,
            ),
            remedy=make_message(
                "Name the columns that the device read: {columns_option}.",
                columns_option=columns_option("position", layout.typed_columns(layout.further[0])),
            )
            if layout.further
            else sum_remedy(layout.differences, layout.position),
        )
    return calculated


def _say_calculated(noticed: Sequence[Lint]) -> bool:
    return any(lint.code == "not_measured" for lint in noticed)


def _lints_of_rows(fitted: FittedRows, of_fit: Sequence[Lint]) -> list[Lint]:
    """Return what is noticed about rows, and what about their fit as far as they leave it open."""
    of_joint = last_joint_note(fitted.chain, fitted.rows)
    hides_play = any(lint.code == DIRECTION for lint in of_joint)
    return [*scale_note(fitted.scale), *of_joint, *(without_play(of_fit) if hides_play else of_fit)]


def _lints_of_start(
    found: Identification, start: IdentificationStart, judged: "_HeldOutErrors"
) -> list[Lint]:
    return [*lints_of_start(found, start), *_lints_of_free(start, judged)]


@dataclass(frozen=True, eq=False)
class _HeldOutErrors:
    """Errors of rows that were not fitted."""

    rows: Rows  # usable rows
    groups: Rows
    before_m: Array
    held_out_m: Array
    with_residual: ErrorSummary | None
    by: str


def _judge_held_out(
    prepared: PreparedMeasurements, found: Identification, split: tuple[Rows, Rows], breaks: list[int]
) -> _HeldOutErrors:
    train, held_out = split
    judged, groups = found.judgement, prepared.grouping.groups
    if not len(held_out):
        smooth = None if found.residual is None else found.residual.held_out
        by = judged.describe_method(found.grouping)
        return _HeldOutErrors(train, groups[train], judged.before_m, judged.held_out_m, smooth, by)
    others = mount_at_breaks(prepared.observations, breaks).select_rows(held_out)
    by = make_message(
        "{count} rows, drawn at random, that neither fit nor any choice has seen", count=len(held_out)
    )
    before, after = errors_of(found.frames, others), errors_of(found.state, others)
    return _HeldOutErrors(held_out, groups[held_out], before, after, _with_residual(found, others), by)


def _with_residual(found: Identification, others: Observations) -> ErrorSummary | None:
    if found.residual is None:
        return None
    return ErrorSummary.from_sizes(errors_with(found.residual.model, found.state, others))


def _build_verdicts(
    limits: IdentificationLimits, found: Identification, judged: _HeldOutErrors, checked: CheckedFile | None
) -> IdentificationVerdicts:
    if checked is not None:
        return judge_limits(limits, found, checked.errors_m, checked.groups, "check file")
    return judge_limits(limits, found, judged.held_out_m, judged.groups, "held-out rows")


def _lints_of_free(start: IdentificationStart, judged: _HeldOutErrors) -> list[Lint]:
    """Say if more than was named is free, or if what was named does not help rows that were not fitted."""
    if not start.point.free:
        return []
    noticed = []
    if start.point.places is None:
        noticed.append(
            Lint(
                "places",
                "base and tool are fitted, too: the start does not tell where they are for these rows.",
            )
        )
    before, after = ErrorSummary.from_sizes(judged.before_m), ErrorSummary.from_sizes(judged.held_out_m)
    if after.rmse_m < before.rmse_m:
        return noticed
    return [
        *noticed,
        Lint(
            "no_gain",
            make_message(
                "what is free ({free}) does not help rows that were not fitted: {before:.3f} mm before, {after:.3f} "
                "mm after.",
                free=", ".join(start.point.free),
                before=before.rmse_m * 1e3,
                after=after.rmse_m * 1e3,
            ),
        ),
    ]


def _rejected_rows(fitted: FittedRows) -> tuple[RejectedRow, ...]:
    measurements, found = fitted.prepared.measurements, fitted.found
    standing = [
        RejectedRow(
            int(measurements.rows[fitted.split[0][row]]),
            make_message(
                "off model and neighbours by {distance_mm:.2f} mm, {deviations:.1f} deviations (limit {limit:.1f})",
                distance_mm=found.fit_m[row] * 1e3,
                deviations=found.robust.deviations[row],
                limit=found.robust.threshold,
            ),
            OUTLIER,
        )
        for row in found.rejected
    ]
    elsewhere = [
        RejectedRow(
            int(measurements.rows[row]),
            "of another series: it fits with others from another place",
            ELSEWHERE,
        )
        for row in (() if fitted.elsewhere is None else fitted.elsewhere.rows)
    ]
    return tuple(sorted([*measurements.rejected, *standing, *elsewhere], key=lambda item: item.row))


def _identified_parameters(
    found: Identification, prior_sigmas: Mapping[str, float]
) -> tuple[IdentifiedParameter, ...]:
    """Return the arm's and wire's parameters, held ones too; places of devices and tools are told apart."""
    fit = found.robust.fit
    layout = fit.layout.whole if isinstance(fit.layout, PartLayout) else fit.layout
    sigma = dict(zip((p.name for p in fit.layout.parameters), np.sqrt(np.diag(fit.covariance)), strict=True))
    return tuple(
        IdentifiedParameter(
            item.name,
            item.unit,
            float(value),
            float(sigma.get(item.name, prior_sigmas.get(item.name, item.prior))),
            item.prior,
            held=item.name not in sigma,
        )
        for item, value in zip(layout.parameters, parameter_values(layout, fit.state), strict=True)
        if item.role not in ("base", "anchor", "tool") and (item.name in sigma or value != 0.0)
    )
