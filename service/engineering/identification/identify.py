"""The use case behind ``cellcal identify``: read, sharpen, fit, cross-validate, check. Prints nothing."""

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.cross_validation import Errors, Grouping, group_rows
from cellcal.calibration.identification.free_parameters import PartLayout, values_of
from cellcal.calibration.identification.identify import Identification, identify
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.misfit import refuse_gross_misfit, refuse_misfit
from cellcal.calibration.identification.observations import Observations, Rows, with_mounting
from cellcal.calibration.identification.parameters import LEVEL_NAMES
from cellcal.calibration.identification.residual_model import errors_with
from cellcal.calibration.identification.selection import Options
from cellcal.calibration.identification.series_breaks import mounting_of
from cellcal.calibration.identification.temperature import temperature_effect
from cellcal.calibration.identification.tip_uncertainty import HayatiTable, hayati_table
from cellcal.calibration.uncertainty import coverage_factor
from cellcal.service.engineering.identification.identify_check import (
    Checked,
    Prepared,
    at_temperature,
    check_file,
    errors_of,
    file_names,
    lints_of_fit,
    lints_of_start,
    prepare,
    seen_before,
)
from cellcal.service.engineering.identification.identify_start import (
    Start,
    StartOptions,
    places_document,
    read_start,
)
from cellcal.service.engineering.identification.identify_verdicts import Limits, Verdicts, judge_limits
from cellcal.service.engineering.measured.measurements import OUTLIER, Measurements, ReadOptions, RejectedRow
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.parameters.identified_parameter import IdentifiedParameter


@dataclass(frozen=True, slots=True)
class IdentifyOptions:
    """What a person may ask of an identification."""

    level: int | None = None
    check: Path | None = None
    train_rows: int | None = None
    seed: int = 0
    read: ReadOptions = field(default_factory=ReadOptions)
    start: StartOptions = field(default_factory=StartOptions)
    residual_model: bool = False
    limits: Limits = field(default_factory=Limits)


@dataclass(frozen=True, eq=False)
class IdentifyReport:
    """Everything there is to say about one file of measurements."""

    robot: str
    rows: int
    level: int
    before: Errors
    fit: Errors
    held_out: Errors
    check: Errors | None
    rejected: tuple[RejectedRow, ...]
    seconds: float
    identification: Identification
    measurements: Measurements
    parameters: tuple[IdentifiedParameter, ...]
    lints: tuple[Lint, ...]
    breaks: tuple[int, ...]  # rows of the file
    held_out_rows: Rows  # of the file; the errors below belong to them
    held_out_m: Array
    before_m: Array
    held_out_by: str
    start: str  # what the fit and the figures "before" start from
    with_residual: Errors | None  # held out, if a residual model was asked for
    check_with_residual: Errors | None
    verdicts: Verdicts
    dh: HayatiTable | None  # of an arm that has a table

    @property
    def coverage(self) -> float:
        """The factor from a standard deviation to 95 %: Student's, if few independent rows determine it."""
        return coverage_factor(max(self.identification.robust.degrees_of_freedom, 1.0))

    def as_document(self) -> dict[str, Any]:
        """Return the object that ``--json`` prints."""
        found = self.identification
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
            "usable": len(self.measurements.rows),
            "level_name": LEVEL_NAMES[self.level],
            "level_reasons": list(found.level_reasons),
            "break_reasons": list(found.break_reasons),
            "held_out_by": self.held_out_by,
            "folds": [
                {"level": level, "breaks": [int(self.measurements.rows[row]) for row in breaks]}
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

    def _residual_document(self) -> dict[str, Any] | None:
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


def identify_file(path: Path, robot: str, options: IdentifyOptions | None = None) -> IdentifyReport:
    """Identify a robot from a file of measurements.

    Raises
    ------
    MeasurementError
        A file cannot be understood, or ``train_rows`` leaves nothing to hold out.
    CalibrationError
        No such robot model, or too few rows.
    """
    options = options or IdentifyOptions()
    started = time.perf_counter()
    model = load_model(robot)
    prepared = prepare(path, model, options.read)
    start = read_start(options.start, model, prepared.observations.kind)
    refuse_misfit(start.point.chain(model), prepared.observations, file_names(prepared.measurements))
    train, held = _split(len(prepared.observations), options)
    grouping = group_rows(
        prepared.measurements.observations.joints_rad[train], prepared.grouping.groups[train]
    )
    grouping = Grouping(grouping.groups, prepared.grouping.kind)
    prepared = _at_one_temperature(model, prepared, train, grouping)
    found = identify(
        model,
        prepared.observations.take(train),
        grouping=grouping,
        options=Options(
            level=options.level,
            seed=options.seed,
            judge=not len(held) or options.residual_model,
            start=start.point,
            residual_model=options.residual_model,
        ),
    )
    breaks = [int(train[item.row]) for item in found.breaks]
    judged = _judged(prepared, found, (train, held), breaks)
    refuse_gross_misfit(model, prepared.observations, judged.held_out_m)
    checked = None
    if options.check is not None:
        checked = check_file(options.check, options.read, found, prepared)
    measurements = prepared.measurements
    noticed = [*prepared.noticed, *(seen_before(measurements, train, held) if len(held) else ())]
    noticed += [*lints_of_fit(found, judged.before_m, prepared, train), *lints_of_start(found, start)]
    noticed += _lints_of_free(start, judged)
    return IdentifyReport(
        robot=model.name,
        rows=measurements.read,
        level=found.level,
        before=Errors.of(judged.before_m),
        fit=found.fit,
        held_out=Errors.of(judged.held_out_m),
        check=None if checked is None else Errors.of(checked.errors_m),
        rejected=_rejected(measurements, found, train),
        seconds=time.perf_counter() - started,
        identification=found,
        measurements=measurements,
        parameters=_parameters(found, start.sigmas),
        lints=(*noticed, *(() if checked is None else checked.lints)),
        breaks=tuple(int(measurements.rows[row]) for row in breaks),
        held_out_rows=measurements.rows[judged.rows],
        held_out_m=judged.held_out_m,
        before_m=judged.before_m,
        held_out_by=judged.by,
        start=start.name,
        with_residual=judged.with_residual,
        check_with_residual=None if checked is None else checked.with_residual,
        verdicts=_verdicts(options.limits, found, judged, checked),
        dh=None if model.dh is None else hayati_table(found.robust.fit),
    )


def _at_one_temperature(model: RobotModel, prepared: Prepared, train: Rows, grouping: Grouping) -> Prepared:
    """Return measurements brought to one temperature, where the rows that are fitted show that it matters."""
    temperature = prepared.measurements.temperature
    if temperature is None:
        return prepared
    effect = temperature_effect(model, prepared.observations.take(train), temperature[train], grouping)
    return prepared if effect is None else at_temperature(prepared, effect)


@dataclass(frozen=True, eq=False)
class _Judged:
    """Errors of rows that were not fitted."""

    rows: Rows  # usable rows
    groups: Rows
    before_m: Array
    held_out_m: Array
    with_residual: Errors | None
    by: str


def _judged(
    prepared: Prepared, found: Identification, split: tuple[Rows, Rows], breaks: list[int]
) -> _Judged:
    train, held = split
    judged, groups = found.judgement, prepared.grouping.groups
    if not len(held):
        smooth = None if found.residual is None else found.residual.held_out
        by = judged.said(found.grouping)
        return _Judged(train, groups[train], judged.before_m, judged.held_out_m, smooth, by)
    others = with_mounting(prepared.observations, mounting_of(len(prepared.observations), breaks)).take(held)
    by = f"{len(held)} rows, drawn at random, that neither fit nor any choice has seen"
    before, after = errors_of(found.frames, others), errors_of(found.state, others)
    return _Judged(held, groups[held], before, after, _with_residual(found, others), by)


def _with_residual(found: Identification, others: Observations) -> Errors | None:
    if found.residual is None:
        return None
    return Errors.of(errors_with(found.residual.model, found.state, others))


def _verdicts(limits: Limits, found: Identification, judged: _Judged, checked: Checked | None) -> Verdicts:
    if checked is not None:
        return judge_limits(limits, found, checked.errors_m, checked.groups, "check file")
    return judge_limits(limits, found, judged.held_out_m, judged.groups, "held-out rows")


def _lints_of_free(start: Start, judged: _Judged) -> list[Lint]:
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
    before, after = Errors.of(judged.before_m), Errors.of(judged.held_out_m)
    if after.rmse_m < before.rmse_m:
        return noticed
    return [
        *noticed,
        Lint(
            "no_gain",
            f"what is free ({', '.join(start.point.free)}) does not help rows that were not fitted: "
            f"{before.rmse_m * 1e3:.3f} mm before, {after.rmse_m * 1e3:.3f} mm after.",
        ),
    ]


def _split(count: int, options: IdentifyOptions) -> tuple[Rows, Rows]:
    """Return training rows, in order, and all other rows."""
    if options.train_rows is None:
        return np.arange(count), np.arange(0)
    if not 0 < options.train_rows < count:
        raise MeasurementError(
            f"{options.train_rows} training rows of {count} leave nothing to hold out.",
            remedy=f"Give `--train-rows` between 1 and {count - 1}.",
        )
    order = np.random.default_rng(options.seed).permutation(count)
    return np.sort(order[: options.train_rows]), np.sort(order[options.train_rows :])


def _rejected(measurements: Measurements, found: Identification, train: Rows) -> tuple[RejectedRow, ...]:
    standing = [
        RejectedRow(
            int(measurements.rows[train[row]]),
            f"off model and neighbours by {found.fit_m[row] * 1e3:.2f} mm, "
            f"{found.robust.deviations[row]:.1f} deviations (limit {found.robust.threshold:.1f})",
            OUTLIER,
        )
        for row in found.rejected
    ]
    return tuple(sorted([*measurements.rejected, *standing], key=lambda item: item.row))


def _parameters(found: Identification, known: Mapping[str, float]) -> tuple[IdentifiedParameter, ...]:
    """Return the arm's and wire's parameters, held ones too; places of devices and tools are told apart."""
    fit = found.robust.fit
    layout = fit.layout.whole if isinstance(fit.layout, PartLayout) else fit.layout
    sigma = dict(zip((p.name for p in fit.layout.parameters), np.sqrt(np.diag(fit.covariance)), strict=True))
    return tuple(
        IdentifiedParameter(
            item.name,
            item.unit,
            float(value),
            float(sigma.get(item.name, known.get(item.name, item.prior))),
            item.prior,
            held=item.name not in sigma,
        )
        for item, value in zip(layout.parameters, values_of(layout, fit.state), strict=True)
        if item.role not in ("base", "anchor", "tool") and (item.name in sigma or value != 0.0)
    )
