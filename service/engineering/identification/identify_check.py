"""The finished model on another file, and the notes that a fit's residuals give."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.joint_kinds import PRISMATIC
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.arm.model_references import is_linkage
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification import lints
from cellcal.calibration.identification.break_lint import unsure_breaks
from cellcal.calibration.identification.contradicting_attitudes import (
    AttitudeSteps,
    contradicting_attitudes,
)
from cellcal.calibration.identification.cross_validation import (
    ErrorSummary,
    Grouping,
    group_rows,
    same_postures,
)
from cellcal.calibration.identification.drift_lint import order_drift, temperature_drift
from cellcal.calibration.identification.earlier_posterior import OffsetContradiction
from cellcal.calibration.identification.effect_lint import misfit_notes, without_play
from cellcal.calibration.identification.estimator import (
    FitProblem,
    errors_m,
    estimate_arm,
    whitened_residuals,
)
from cellcal.calibration.identification.exchanged_rows import exchanged_rows
from cellcal.calibration.identification.identify import Identification
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_hypotheses import FileNames
from cellcal.calibration.identification.observations import (
    Observations,
    PoseObservations,
    Rows,
    points_of_poses,
    with_joints,
    with_mounting,
)
from cellcal.calibration.identification.parameters import FRAMES, ArmState
from cellcal.calibration.identification.residual_model import errors_with
from cellcal.calibration.identification.rows_apart import rows_apart
from cellcal.calibration.identification.sag_change import find_sag_change
from cellcal.calibration.identification.series_breaks import assign_mountings
from cellcal.calibration.identification.sweep_lint import sweep_lint
from cellcal.calibration.identification.temperature import TemperatureEffect, temperature_note
from cellcal.calibration.identification.unrounding import unround_joints
from cellcal.calibration.message import join_messages, make_message
from cellcal.service.engineering.identification.identify_start import IdentificationStart
from cellcal.service.engineering.measured.measurements import Measurements, ReadOptions, read_measurements
from cellcal.service.engineering.measured.table import MeasurementError

_ENOUGH_TO_PLACE = 30  # check rows
_MOVED = 1.5  # times better with device and target placed anew: one of them was moved


@dataclass(frozen=True, eq=False)
class PreparedMeasurements:
    """Measurements with sharpened joints, groups by the joints as written, and what was noticed."""

    measurements: Measurements
    observations: Observations
    grouping: Grouping
    noticed: tuple[Lint, ...]
    effect: TemperatureEffect | None = None  # taken out of the observations


@dataclass(frozen=True, eq=False)
class CheckedFile:
    """Errors of another file's rows, by the finished model."""

    errors_m: Array  # (N,)
    groups: Rows
    with_residual: ErrorSummary | None
    lints: tuple[Lint, ...]


def prepare_measurements(path: Path, model: RobotModel, options: ReadOptions) -> PreparedMeasurements:
    """Read a file, look it over, and sharpen rounded joints with the controller's positions.

    Raises
    ------
    MeasurementError
        The file cannot be understood.
    """
    measurements = read_measurements(path, model, options)
    raw = measurements.observations
    noticed = [
        *_rods(model),
        *_several_targets(measurements),
        *lints.sign_flips(raw.joints_rad, model.joint_names),
        *lints.beyond_limits(model, raw.joints_rad),
        *lints.find_duplicates(raw.joints_rad),
        *lints.rounding_floor(model, raw.joints_rad, measurements.joint_step_rad, measurements.value_step_m),
    ]
    observations = raw
    if measurements.controller_m is not None and len(raw) >= 8:
        has_position = np.isfinite(measurements.controller_m).all(axis=1)
        if has_position.all():
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
    grouping = group_rows(raw.joints_rad, measurements.groups)
    return PreparedMeasurements(measurements, observations, grouping, in_file(noticed, measurements))


def without_contradicting_attitudes(
    model: RobotModel, prepared: PreparedMeasurements
) -> PreparedMeasurements:
    """Return measurements as points, and say so, where their attitudes cannot belong to the places."""
    measured, observations = prepared.measurements, prepared.observations
    steps = AttitudeSteps(measured.joint_step_rad, measured.attitude_step_rad)
    found = contradicting_attitudes(model, observations, prepared.grouping.groups, steps)
    if not (found and isinstance(observations, PoseObservations)):
        return prepared
    points = points_of_poses(observations)
    read = replace(
        measured, observations=with_joints(points, measured.observations.joints_rad), convention=""
    )
    return replace(prepared, measurements=read, observations=points, noticed=(*prepared.noticed, *found))


def file_names(measurements: Measurements) -> FileNames:
    """Return what a file calls its columns and units, for cures that can be typed."""
    layout, units = measurements.layout, measurements.units
    columns = (*layout.joints, *layout.position)
    return FileNames(
        layout.as_typed(layout.joints),
        layout.as_typed(layout.position) or ("X", "Y", "Z"),
        units.get("length" if layout.length else "position", ""),
        units.get("joints", ""),
        measurements.joint_coupling,
        measurements.targets[0],
        dict(zip(layout.as_typed(columns), layout.typed_columns(columns), strict=True)),
        measurements.unused,
        measurements.rows,
    )


def bring_to_temperature(prepared: PreparedMeasurements, effect: TemperatureEffect) -> PreparedMeasurements:
    """Return measurements brought to the temperature of an effect; without a column of temperatures as they are."""
    temperature = prepared.measurements.temperature
    if temperature is None:
        return prepared
    return replace(
        prepared, observations=effect.remove_effect(prepared.observations, temperature), effect=effect
    )


def in_file(found: Sequence[Lint], measurements: Measurements) -> tuple[Lint, ...]:
    """Return notes about usable rows with the rows' numbers in the file."""
    return tuple(
        Lint(lint.code, lint.message, tuple(int(measurements.rows[row]) for row in lint.rows))
        for lint in found
    )


def lint_repeated_postures(measurements: Measurements, train: Rows, held_out: Rows) -> list[Lint]:
    """Name held-out rows in a posture that was fitted."""
    postures = same_postures(measurements.observations.joints_rad)
    again = held_out[np.isin(postures[held_out], postures[train])]
    if not len(again):
        return []
    return [
        Lint(
            "leakage",
            make_message(
                "{count} held-out rows repeat a posture that was fitted: without --train-rows such rows stay "
                "together.",
                count=len(again),
            ),
            tuple(int(row) for row in measurements.rows[again]),
        )
    ]


def errors_of(state: ArmState, observations: Observations) -> Array:
    """Return the errors (N,) [m] of rows by a state."""
    return errors_m(state, FitProblem.from_observations(state, observations))


def lints_of_fit(
    found: Identification, before_m: Array, fitted: PreparedMeasurements, train: Rows
) -> tuple[Lint, ...]:
    """Return what the residuals of a fit say about measurements and model."""
    measurements = fitted.measurements
    accepted = np.ones(len(train), dtype=bool)
    accepted[found.rejected] = False
    residuals = whitened_residuals(found.state, found.robust.problem)[:, accepted]
    observations = found.robust.problem.observations
    left_m = residuals[:3] * observations.sigma_m[accepted]
    groups = found.grouping.groups[accepted]
    payload = find_sag_change(found, measurements.rows[train])
    effects = misfit_notes(found.misfit, len(train), len(found.rejected))
    return (
        *lints.find_nominal_positions(before_m, measurements.value_step_m),
        *lints.find_alike_neighbours(residuals, same_postures(observations.joints_rad[accepted])),
        *sweep_lint(
            observations.joints_rad[accepted],
            left_m,
            groups,
            found.state.nominal.joint_names,
            lengths=observations.kind == "length",
            slides=[kind == PRISMATIC for kind in found.state.nominal.kinds],
        ),
        *_lint_temperature(fitted, train[accepted], left_m, groups),
        *order_drift(left_m, groups),
        *unsure_breaks(found, measurements.rows[train]),
        *exchanged_rows(found, measurements.rows[train]),
        *rows_apart(found, measurements.rows[train]),
        *payload,
        *(without_play(effects) if payload else effects),
    )


def _lint_temperature(fitted: PreparedMeasurements, rows: Rows, left_m: Array, groups: Rows) -> list[Lint]:
    temperature = fitted.measurements.temperature
    if fitted.effect is not None:
        return temperature_note(fitted.effect)
    return temperature_drift(None if temperature is None else temperature[rows], left_m, groups)


def _several_targets(measurements: Measurements) -> list[Lint]:
    """Say that a column tells targets apart, of which the fit knows one."""
    column, words = measurements.targets
    if not column:
        return []
    return [
        Lint(
            "targets",
            make_message(
                "column {column!r} tells {targets} apart, and all rows were taken as of one target: where these "
                "differ on the flange, keep the rows of one, or describe them in a layout.",
                column=column,
                targets=", ".join(words),
            ),
        )
    ]


def _rods(model: RobotModel) -> list[Lint]:
    """Say what no serial model can hold of an arm whose third axis is driven by rods."""
    if not is_linkage(model.name):
        return []
    return [
        Lint(
            "linkage",
            "rods drive axis 3 of this arm. The serial model is exact while they form a parallelogram; what a rod or "
            "a bearing is off by changes with the posture and is in no parameter, so it stays in the errors held "
            "out: take these for the accuracy that is left.",
        )
    ]


def lints_of_start(found: Identification, start: IdentificationStart) -> list[Lint]:
    """Name what these rows contradict of an earlier fit, whose deviations were taken as this one's priors."""
    if not found.contradicted:
        return []
    worst = found.contradicted[0]
    return [
        Lint(
            "arm_changed",
            make_message(
                "these rows contradict {start}: they want {parameter} off by {moved_by}. If that joint was mastered "
                'since, find it anew with --free "{parameter}"; if not, one of the two measurements is wrong.',
                start=start.name,
                parameter=worst.parameter,
                moved_by=_moved_by(found, worst),
            ),
        )
    ]


def _moved_by(found: Identification, worst: OffsetContradiction) -> str:
    """Return by how much rows want an offset elsewhere, in degrees, or millimetres of a joint that slides."""
    unit = next(p.unit for p in found.robust.fit.layout.parameters if p.name == worst.parameter)
    return f"{worst.moved_rad * 1e3:+.3f} mm" if unit == "m" else f"{np.rad2deg(worst.moved_rad):+.3f} deg"


def read_check_file(
    path: Path, read: ReadOptions, model: RobotModel, fitted: PreparedMeasurements
) -> PreparedMeasurements:
    """Read another file on which a model is to be evaluated, before the work.

    Raises
    ------
    MeasurementError
        The file cannot be understood, or holds what another instrument measured.
    MisfitError
        Its rows do not fit the robot.
    """
    other = prepare_measurements(path, model, replace(read, of_another_file=True))
    if (other.observations.kind == "length") != (fitted.observations.kind == "length"):
        raise MeasurementError(
            f"{path} holds {other.observations.kind}s, not {fitted.observations.kind}s as the fit.",
            remedy="Check with a file of the same instrument.",
        )
    refuse_misfit(model, other.observations, file_names(other.measurements))
    return other


def check_file(
    other: PreparedMeasurements, found: Identification, fitted: PreparedMeasurements
) -> CheckedFile:
    """Evaluate the finished model, frames included, on another file."""
    if fitted.effect is not None:
        other = bring_to_temperature(other, fitted.effect)
    pair = fitted.measurements.observations.joints_rad, other.measurements.observations.joints_rad
    noticed = [*lints.find_leakage(*pair), *lints.beyond_fitted_range(*pair)]
    count = len(other.observations)
    by_mounting = np.array(
        [
            errors_of(found.state, with_mounting(other.observations, np.full(count, mounting)))
            for mounting in range(len(found.state.devices))
        ]
    )
    chosen = assign_mountings(by_mounting, max(found.fit_errors.rmse_m, 1e-6))
    sizes = by_mounting[chosen, np.arange(count)]
    noticed += _lint_moved_device(found, other.observations, ErrorSummary.from_sizes(sizes))
    if len(by_mounting) > 1:
        parts = [
            make_message(
                "{count} rows on mounting {mounting}", count=int((chosen == i).sum()), mounting=i + 1
            )
            for i in np.unique(chosen)
        ]
        fits = make_message(
            "the device had several mountings; the check file fits {parts}.",
            parts=join_messages(", ", parts),
        )
        noticed.append(Lint("check_mounting", fits))
    smooth = None
    if found.residual is not None:
        observations = with_mounting(other.observations, chosen)
        smooth = ErrorSummary.from_sizes(errors_with(found.residual.model, found.state, observations))
    return CheckedFile(sizes, other.grouping.groups, smooth, tuple(noticed))


def _lint_moved_device(found: Identification, observations: Observations, stood: ErrorSummary) -> list[Lint]:
    anew = _placed_anew(found, observations)
    if len(observations) < _ENOUGH_TO_PLACE or stood.rmse_m <= _MOVED * anew.rmse_m:
        return []
    return [
        Lint(
            "check_moved",
            make_message(
                "with device and target placed anew the check file fits to {anew:.3f} mm (RMSE), as they stood to "
                "{stood:.3f} mm: was one of them moved between the files?",
                anew=anew.rmse_m * 1e3,
                stood=stood.rmse_m * 1e3,
            ),
        )
    ]


def _placed_anew(found: Identification, observations: Observations) -> ErrorSummary:
    """Return the errors of the identified arm when base or anchor, and tool, are fitted to the check rows."""
    state = replace(found.state, devices=found.state.devices[:1])
    layout = make_layout(state.nominal, observations.kind, 1, level=FRAMES)
    problem = FitProblem.from_observations(state, observations)
    return ErrorSummary.from_sizes(errors_m(estimate_arm(layout, state, problem).state, problem))
