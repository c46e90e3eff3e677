"""What an identification of a cell leaves behind: a parameter set and a description of every robot, and places."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.urdf import bare_urdf
from cellcal.calibration.cells.cell import CellSeries
from cellcal.calibration.cells.prediction import target_positions, tip_covariance
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.free_parameters import parameter_values
from cellcal.calibration.identification.lints import beyond_fitted_range
from cellcal.calibration.identification.model_error import HeldOutErrors, expanded_in_space, model_error
from cellcal.calibration.identification.parameters import FRAMES
from cellcal.calibration.message import make_message
from cellcal.service.engineering.identification.at_points import AtOptions, read_points, solve_joints
from cellcal.service.engineering.identification.cell_identify import ArmReport, IdentifiedCellReport
from cellcal.service.engineering.identification.identify_at import TipsAt, statement_of, tips_of
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.parameters.calibrated_models import nominal_sha256, values_of_identification
from cellcal.service.engineering.parameters.identified_parameter import IdentifiedParameter
from cellcal.service.engineering.parameters.parameter_files import SetOrigin
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, ParameterValue
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.files import SHARED_FILE, replace_file


@dataclass(frozen=True, slots=True)
class WrittenUrdf:
    """A description that was written, and what of its arm it cannot hold."""

    path: Path
    missing: tuple[str, ...]


def serials_of(text: str, robots: tuple[str, ...]) -> Mapping[str, str]:
    """Return the serial of every robot: ``4711`` of a single one, ``left=4711,right=4712`` of several.

    Raises
    ------
    MeasurementError
        A robot without a serial, or a serial without a robot.
    """
    pairs = [word.partition("=") for word in text.split(",")]
    if len(robots) == 1 and len(pairs) == 1 and not pairs[0][1]:
        return {robots[0]: text.strip()}
    found = {name.strip(): serial.strip() for name, _, serial in pairs}
    if found.keys() != set(robots) or not all(found.values()) or len(set(found.values())) < len(found):
        example = ",".join(f"{name}=…" for name in robots)
        raise MeasurementError(
            f"--serial {text} does not name one serial for each robot of the cell.",
            remedy=f"Write --serial {example}.",
        )
    return found


def save_cell(
    report: IdentifiedCellReport, measurements: Path, folder: Path, serials: Mapping[str, str], who: SetOrigin
) -> tuple[ParameterSet, ...]:
    """Save every robot's identified parameters as its newest version.

    Raises
    ------
    MeasurementError
        Nothing about the arms was identified.
    """
    _refuse_frames(report)
    digest = hashlib.sha256(read_plain_bytes(measurements)).hexdigest()
    sets = ParameterSets(folder)
    return tuple(
        sets.save_draft(
            ParameterSet(
                robot_serial=serials[arm.name],
                model=arm.fit.state.nominal.name,
                nominal_sha256=nominal_sha256(arm.fit.state.nominal),
                made_at=who.made_at,
                made_by=who.made_by,
                source=make_message(
                    "identification of a cell: {file}, sha256 {sha256}", file=measurements.name, sha256=digest
                ),
                values=_arm_values(arm),
                note=who.note,
            )
        )
        for arm in report.arms
    )


def _arm_values(arm: ArmReport) -> tuple[ParameterValue, ...]:
    sigma = np.sqrt(np.diag(arm.fit.covariance))
    values = parameter_values(arm.fit.layout, arm.fit.state)
    found = [
        IdentifiedParameter(item.name, item.unit, float(value), float(deviation), item.prior)
        for item, value, deviation in zip(arm.fit.layout.parameters, values, sigma, strict=True)
    ]
    return values_of_identification(found, arm.fit)


def write_cell_urdfs(
    report: IdentifiedCellReport, path: Path, *, geometric_joints: bool
) -> tuple[WrittenUrdf, ...]:
    """Write each arm as a bare description; of several robots, the name of each goes into that of its file.

    Raises
    ------
    MeasurementError
        Nothing about the arms was identified.
    CalibrationError
        An arm couples joints, and ``geometric_joints`` was not asked for.
    """
    _refuse_frames(report)
    kinds = {"gravity": "sag", "harmonic": "ripple", "gear": "gear ratios"}
    texts = [bare_urdf(arm.fit.state.arm_model, geometric_joints=geometric_joints) for arm in report.arms]
    written = []
    for arm, text in zip(report.arms, texts, strict=True):
        one = path if len(report.arms) == 1 else path.with_stem(f"{path.stem}_{arm.name}")
        replace_file(one, text, mode=SHARED_FILE)
        missing = sorted({kinds[term.kind] for term in arm.fit.state.terms})
        written.append(WrittenUrdf(one, tuple(missing)))
    return tuple(written)


def cell_tips(options: AtOptions, report: IdentifiedCellReport) -> dict[str, TipsAt]:
    """Predict where targets are at the points of a file, seen from their robot's base; by target.

    The column ``target`` names a target or tool; it may be missing where there is only one.

    Raises
    ------
    MeasurementError
        Points that cannot be read or reached, or a target that the cell does not have.
    """
    cell = report.measurements.cell
    targets = list(dict.fromkeys(series.target for series in cell.series))
    axes = {cell.robot_of(name).model.axis_count for name in targets}
    points = read_points(options, max(axes))
    named = points.words.get("target", tuple(targets[:1]) * len(points.joints_rad))
    if "target" not in points.words and len(targets) > 1:
        raise MeasurementError(
            f"{options.path} does not say which target is meant.",
            remedy=f"Add a column target with one of {', '.join(targets)}.",
        )
    unknown_names = sorted(set(named) - set(targets))
    if unknown_names:
        raise MeasurementError(
            f"{options.path}: the cell has no target {unknown_names[0]!r}.",
            remedy=make_message("It has {names}.", names=", ".join(targets)),
        )
    found = {}
    for target in dict.fromkeys(named):
        rows = np.flatnonzero([name == target for name in named])
        mine = replace(
            points,
            joints_rad=points.joints_rad[rows],
            base_flange=None if points.base_flange is None else points.base_flange[rows],
        )
        robot = cell.robot_of(target)
        measured = np.concatenate(
            [s.observations.joints_rad for s in cell.series if cell.robot_of(s.target) is robot]
        )
        state = next(arm.fit.state for arm in report.arms if arm.name == robot.name)
        joints = solve_joints(
            mine, TipArm.of_state(state) if options.identified else TipArm(robot.model), measured
        )
        found[target] = _predict_tips(report, target, joints, measured)
    return found


def _predict_tips(report: IdentifiedCellReport, target: str, joints: Array, measured: Array) -> TipsAt:
    found = report.identification
    covariances = tip_covariance(found.robust.fit, target, joints)
    missed = _held_out_errors(report, target)
    freedom = max(found.robust.degrees_of_freedom, 1.0)
    error = model_error(missed, HeldOutErrors.without_rows(), freedom)
    beyond = np.zeros(len(joints), dtype=bool)
    for note in beyond_fitted_range(measured, joints):
        beyond[list(note.rows)] = True
    own = np.zeros(len(joints))
    total = error.total_covariance(covariances, own)
    return tips_of(
        joints,
        target_positions(found.robust.fit, target, joints),
        (total, error.expanded_m(covariances, own, beyond), expanded_in_space(covariances, freedom)),
        (np.flatnonzero(beyond), np.flatnonzero(beyond)),
        make_message("base of {robot_name}", robot_name=report.measurements.cell.robot_of(target).name),
        statement_of(
            f"{error.rows} held-out rows of the robot's series",
            report.measurements.read,
            len(report.rejected),
            far=bool(beyond.any()),
        ),
    )


def _held_out_errors(report: IdentifiedCellReport, target: str) -> HeldOutErrors:
    """Return the errors of held-out rows of a target; of its robot's other targets where it has none.

    They contain what the parameters miss: it is counted once more with the covariance, which errs to the safe side.
    Readings of one channel count with the channels that they have. A cell whose series were too short to be held
    out shows its residuals instead.
    """
    cell, by_series = report.measurements.cell, report.identification.series
    robot = cell.robot_of(target)
    pairs = [
        (series, errors)
        for series, errors in zip(cell.series, by_series, strict=True)
        if cell.robot_of(series.target) is robot
    ]
    mine = [pair for pair in pairs if pair[0].target == target]
    for some in (mine, pairs):
        sizes = [_by_channel(series, np.asarray(errors.held_out_m)) for series, errors in some]
        if sum(len(each) for each in sizes):
            return _as_places(np.concatenate(sizes))
    return _as_places(
        np.concatenate([_by_channel(series, np.delete(e.fit_m, e.rejected)) for series, e in pairs])
    )


def _by_channel(series: CellSeries, sizes_m: Array) -> Array:
    """Return errors per root of a channel (N,) [m]."""
    return np.asarray(sizes_m / np.sqrt(min(series.observations.channels, 3)))


def _as_places(by_channel_m: Array) -> HeldOutErrors:
    nothing = np.zeros(len(by_channel_m))
    return HeldOutErrors(by_channel_m * np.sqrt(3.0), nothing, nothing, 3)


def _refuse_frames(report: IdentifiedCellReport) -> None:
    if report.level == FRAMES:
        raise MeasurementError(
            "no parameter of the arms predicts unseen rows better than nominal ones: there is nothing to save.",
            remedy="Measure more postures and more exactly, or ask for a `--level`.",
        )
