"""The use case behind ``cellcal identify``: read, sharpen, fit, cross-validate, check. Prints nothing."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration import lints
from calibration.cross_validation import Errors, Grouping, group_rows, same_postures
from calibration.estimator import Problem, errors_m, estimate, whitened_residuals
from calibration.geometry import Array
from calibration.identification import Identification, identify
from calibration.kinematics import RobotModel, load_model
from calibration.lints import Lint
from calibration.observations import Observations, Rows, with_joints, with_mounting
from calibration.parameters import FRAMES, LEVEL_NAMES, ArmState, make_layout
from calibration.selection import Options
from calibration.series_breaks import assign_mountings, mounting_of
from calibration.unrounding import unround_joints
from service.measurement_table import MeasurementError
from service.measurements import Measurements, ReadOptions, RejectedRow, read_measurements

_ENOUGH_TO_PLACE = 30  # check rows
_MOVED = 1.5  # times better with device and target placed anew: one of them was moved


@dataclass(frozen=True, slots=True)
class IdentifyOptions:
    """What a person may ask of an identification."""

    level: int | None = None
    check: Path | None = None
    train_rows: int | None = None
    seed: int = 0
    read: ReadOptions = field(default_factory=ReadOptions)


@dataclass(frozen=True, slots=True)
class IdentifiedParameter:
    """One parameter in SI, with its standard deviation and what its prior allowed."""

    name: str
    unit: str
    value: float
    sigma: float
    prior: float


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
        }


@dataclass(frozen=True, eq=False)
class _Prepared:
    """Measurements with sharpened joints, groups by the joints as written, and what was noticed."""

    measurements: Measurements
    observations: Observations
    grouping: Grouping
    noticed: tuple[Lint, ...]


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
    prepared = _prepare(path, model, options.read)
    count = len(prepared.observations)
    train, held = _split(count, options)
    grouping = group_rows(
        prepared.measurements.observations.joints_rad[train], prepared.grouping.groups[train]
    )
    grouping = Grouping(grouping.groups, prepared.grouping.kind)
    found = identify(
        model,
        prepared.observations.take(train),
        grouping=grouping,
        options=Options(level=options.level, seed=options.seed, judge=not len(held)),
    )
    breaks = [int(train[item.row]) for item in found.breaks]
    judged = found.judgement
    before, after, rows, by = judged.before_m, judged.held_out_m, train, judged.said(grouping)
    seen_before: list[Lint] = []
    if len(held):
        others = with_mounting(prepared.observations, mounting_of(count, breaks)).take(held)
        before, after = _errors(found.frames, others), _errors(found.state, others)
        rows, by = held, f"{len(held)} rows, drawn at random, that neither fit nor any choice has seen"
        seen_before = _seen_before(prepared.measurements, train, held)
    check, check_lints = _check(options, model, found, prepared)
    return IdentifyReport(
        robot=model.name,
        rows=prepared.measurements.read,
        level=found.level,
        before=Errors.of(before),
        fit=found.fit,
        held_out=Errors.of(after),
        check=check,
        rejected=_rejected(prepared.measurements, found, train),
        seconds=time.perf_counter() - started,
        identification=found,
        measurements=prepared.measurements,
        parameters=_parameters(found),
        lints=(
            *prepared.noticed,
            *seen_before,
            *_lints_of_fit(found, before, prepared.measurements),
            *check_lints,
        ),
        breaks=tuple(int(prepared.measurements.rows[row]) for row in breaks),
        held_out_rows=prepared.measurements.rows[rows],
        held_out_m=after,
        before_m=before,
        held_out_by=by,
    )


def _prepare(path: Path, model: RobotModel, options: ReadOptions) -> _Prepared:
    measurements = read_measurements(path, model, options)
    raw = measurements.observations
    noticed = [
        *lints.sign_flips(raw.joints_rad, model.joint_names),
        *lints.duplicates(raw.joints_rad),
        *lints.rounding_floor(model, raw.joints_rad, measurements.joint_step_rad, measurements.value_step_m),
        *lints.temperature_drift(measurements.temperature),
    ]
    observations = raw
    if measurements.controller_m is not None and len(raw) >= 8:
        known = np.isfinite(measurements.controller_m).all(axis=1)
        if known.all():
            sharp = unround_joints(
                model,
                raw.joints_rad,
                measurements.joint_step_rad,
                measurements.controller_m,
                measurements.controller_step_m,
            )
            observations = with_joints(raw, sharp.joints_rad)
            noticed += lints.controller_positions(
                sharp.doubtful_rows, sharp.disagreement_m, used=sharp.useful
            )
    in_file = tuple(
        Lint(lint.code, lint.message, tuple(int(measurements.rows[row]) for row in lint.rows))
        for lint in noticed
    )
    return _Prepared(measurements, observations, group_rows(raw.joints_rad, measurements.groups), in_file)


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


def _seen_before(measurements: Measurements, train: Rows, held: Rows) -> list[Lint]:
    """Name held-out rows in a posture that was fitted."""
    postures = same_postures(measurements.observations.joints_rad)
    again = held[np.isin(postures[held], postures[train])]
    if not len(again):
        return []
    return [
        Lint(
            "leakage",
            f"{len(again)} held-out rows repeat a posture that was fitted: without --train-rows such rows stay "
            "together.",
            tuple(int(row) for row in measurements.rows[again]),
        )
    ]


def _errors(state: ArmState, observations: Observations) -> Array:
    return errors_m(state, Problem.of(state, observations))


def _check(
    options: IdentifyOptions, model: RobotModel, found: Identification, fitted: _Prepared
) -> tuple[Errors | None, list[Lint]]:
    """Evaluate the finished model, frames included, on another file."""
    if options.check is None:
        return None, []
    other = _prepare(options.check, model, options.read)
    if (other.observations.kind == "length") != (fitted.observations.kind == "length"):
        raise MeasurementError(
            f"{options.check} holds {other.observations.kind}s, not {fitted.observations.kind}s as the fit.",
            remedy="Check with a file of the same instrument.",
        )
    pair = fitted.measurements.observations.joints_rad, other.measurements.observations.joints_rad
    noticed = [*lints.leakage(*pair), *lints.beyond_fitted_range(*pair)]
    count = len(other.observations)
    by_mounting = np.array(
        [
            _errors(found.state, with_mounting(other.observations, np.full(count, mounting)))
            for mounting in range(len(found.state.devices))
        ]
    )
    chosen = assign_mountings(by_mounting, max(found.fit.rmse_m, 1e-6))
    errors = Errors.of(by_mounting[chosen, np.arange(count)])
    anew = _placed_anew(found, other.observations)
    if count >= _ENOUGH_TO_PLACE and errors.rmse_m > _MOVED * anew.rmse_m:
        fitted_mm, stood_mm = anew.rmse_m * 1e3, errors.rmse_m * 1e3
        noticed.append(
            Lint(
                "check_moved",
                f"with device and target placed anew the check file fits to {fitted_mm:.3f} mm (RMSE), as they "
                f"stood to {stood_mm:.3f} mm: was one of them moved between the files?",
            )
        )
    if len(by_mounting) > 1:
        parts = ", ".join(f"{int((chosen == i).sum())} rows on mounting {i + 1}" for i in np.unique(chosen))
        noticed.append(
            Lint("check_mounting", f"the device had several mountings; the check file fits {parts}.")
        )
    return errors, noticed


def _placed_anew(found: Identification, observations: Observations) -> Errors:
    """Return the errors of the identified arm when base or anchor, and tool, are fitted to the check rows."""
    state = replace(found.state, devices=found.state.devices[:1])
    layout = make_layout(state.nominal, observations.kind, 1, level=FRAMES)
    problem = Problem.of(state, observations)
    return Errors.of(errors_m(estimate(layout, state, problem).state, problem))


def _rejected(measurements: Measurements, found: Identification, train: Rows) -> tuple[RejectedRow, ...]:
    standing = [
        RejectedRow(
            int(measurements.rows[train[row]]),
            f"stands out from model and neighbours: {found.fit_m[row] * 1e3:.2f} mm, "
            f"{found.robust.deviations[row]:.1f} deviations (limit {found.robust.threshold:.1f}); not fitted",
        )
        for row in found.rejected
    ]
    return tuple(sorted([*measurements.rejected, *standing], key=lambda item: item.row))


def _lints_of_fit(found: Identification, before_m: Array, measurements: Measurements) -> Sequence[Lint]:
    residuals = np.delete(whitened_residuals(found.state, found.robust.problem), found.rejected, axis=1)
    return (
        *lints.not_a_measurement(before_m, measurements.value_step_m),
        *lints.alike_neighbours(residuals),
    )


def _parameters(found: Identification) -> tuple[IdentifiedParameter, ...]:
    """Return the arm's and wire's parameters; places of devices and tools follow, with what was found."""
    fit = found.robust.fit
    sigma = np.sqrt(np.diag(fit.covariance))
    return tuple(
        IdentifiedParameter(item.name, item.unit, float(value), float(deviation), item.prior)
        for item, value, deviation in zip(fit.layout.parameters, fit.deviations, sigma, strict=True)
        if item.role not in ("base", "anchor", "tool")
    )
