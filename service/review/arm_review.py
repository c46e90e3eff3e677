"""A robot calibration looked at again: its residuals, its check poses, its work; and with other readings, what if.

The what-if fits exactly the readings that a person chose, by least squares, from what the run itself has recorded.
Nothing of it is kept: the signed result stays what it is.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # loads a part of it when that is first used
from numpy.typing import NDArray
from pydantic import TypeAdapter

from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.estimator import ArmFit, FitProblem, estimate_arm, whitened_residuals
from cellcal.calibration.identification.leverage import effective_unknowns, standardised_residuals
from cellcal.calibration.identification.parameters import ArmState
from cellcal.calibration.identification.robust import RobustFit
from cellcal.calibration.message import make_message
from cellcal.calibration.poses.arm_fit import (
    ArmTask,
    errors_at,
    fit_placement,
    predict_from_fit,
    target_expanded_u,
)
from cellcal.calibration.poses.measurement_prediction import MeasurementPrediction, TestPoses
from cellcal.calibration.registration import best_fit_transform
from cellcal.procedures.arm.arm_bench import ArmCapture, Bench, observations_of
from cellcal.procedures.arm.calibration_plan import fit_captures, task_of
from cellcal.procedures.arm.calibration_spec import RobotCalibration
from cellcal.service.record.run_store import RunView
from cellcal.service.review.review_models import (
    CheckPoint,
    ErrorSpread,
    Review,
    ReviewError,
    ReviewPoint,
    Validation,
    WorkPlace,
)

Chosen = NDArray[np.bool_]
_BENCH: TypeAdapter[Bench] = TypeAdapter(Bench)
_CAPTURE: TypeAdapter[ArmCapture] = TypeAdapter(ArmCapture)
_SPEC: TypeAdapter[RobotCalibration] = TypeAdapter(RobotCalibration)
_FITTED, _CHECK = re.compile(r"capture (point )?\d+"), re.compile(r"capture check \d+")
_ROUNDS = 3  # of scaling: the third changes nothing that is shown
_SIGNED_COUNTS_AS = 10.0  # readings: how firmly the errors' size of the signed fit is believed


@dataclass(frozen=True, eq=False)
class ArmSeries:
    """All that a calibration measured: first the captures that its fit had, in its order, then those set aside."""

    run_id: str
    task: ArmTask
    steps: tuple[str, ...]
    captures: tuple[ArmCapture, ...]
    in_force: int  # how many of them the fit had; its own robust rejections among them
    reasons: Mapping[str, str]
    checks: Mapping[str, ArmCapture]
    tests_rad: Array  # postures that stand for the work

    def signed_fit(self) -> RobustFit:
        """Return the fit that the run's result came from."""
        return fit_captures(self.task, self.captures[: self.in_force])

    def signed_choice(self) -> Chosen:
        """Return which captures that fit believed."""
        chosen = np.zeros(len(self.captures), dtype=bool)
        chosen[: self.in_force] = True
        chosen[self.signed_fit().rejected] = False
        return chosen


def series_of(view: RunView) -> ArmSeries:
    """Read a finished robot calibration from its findings.

    Raises
    ------
    ReviewError
        It has no result.
    """
    found = {finding.step: finding.value for finding in view.past.findings}
    if not isinstance(view.result, dict) or "identified" not in view.result:
        raise ReviewError(
            make_message("run {run_id} has no result to look at.", run_id=view.run_id),
            remedy="Resume it, or start it anew.",
        )
    spec = _SPEC.validate_python(view.spec)
    bench = _BENCH.validate_python(found["read the robot"])
    taken = {step: _CAPTURE.validate_python(v) for step, v in found.items() if _FITTED.fullmatch(step)}
    reasons = {str(entry["step"]): str(entry["reason"]) for entry in view.result["set_aside"]}
    fitted_joints_rad = view.result["identified"]["arm"]["fitted_joints_rad"]
    # what the fit left out is in force all the same: it was not measured again
    in_force = _in_order(dict(sorted(taken.items(), key=lambda each: each[0] in reasons)), fitted_joints_rad)
    steps = (*in_force, *(step for step in taken if step not in in_force))
    return ArmSeries(
        run_id=view.run_id,
        task=task_of(bench, spec.series_goal(), spec.rules),
        steps=steps,
        captures=tuple(taken[step] for step in steps),
        in_force=len(in_force),
        reasons=reasons,
        checks={s: _CAPTURE.validate_python(v) for s, v in found.items() if _CHECK.fullmatch(s)},
        tests_rad=np.array(found["plan the poses"]["tests"], dtype=float),
    )


def _in_order(remaining: dict[str, ArmCapture], wanted_rad: Sequence[Sequence[float]]) -> tuple[str, ...]:
    """Return the steps in the order of the fit: one that was taken again stands where the doubted one stood."""
    steps = []
    for joints in wanted_rad:
        step = next((s for s, c in remaining.items() if list(c.joints_rad) == list(joints)), None)
        if step is None:
            raise ReviewError(
                "the captures of this run are not those of its result.",
                remedy="`cellcal show` tells what was done again.",
            )
        del remaining[step]
        steps.append(step)
    return tuple(steps)


def fit_of(series: ArmSeries, chosen: Chosen) -> RobustFit:
    """Fit exactly the chosen captures; the signed choice gives the signed fit.

    The size of the errors is taken from the chosen readings themselves, as the signed fit does.

    Raises
    ------
    ReviewError
        So few readings tell less than what is known beforehand.
    """
    signed, task = series.signed_fit(), series.task
    if (chosen == series.signed_choice()).all() and series.in_force == len(series.captures):
        return signed
    if int(chosen.sum()) < fewest_readings(task):
        raise ReviewError(
            make_message("{chosen} readings are too few for this fit.", chosen=int(chosen.sum())),
            remedy=make_message("Keep {least} or more.", least=fewest_readings(task)),
            code="review.too_few",
        )
    observations = observations_of(task, series.captures)
    scale = float(np.median(signed.problem.observations.sigma_m)) / task.sigma_m
    as_signed, fit, weights = (
        FitProblem.from_observations(signed.fit.state, observations.scale_sigma(scale)),
        signed.fit,
        chosen.astype(float),
    )
    problem = as_signed
    for _ in range(_ROUNDS if not (chosen == series.signed_choice()).all() else 0):
        fit = estimate_arm(fit.layout, fit.state, problem, weights)
        problem = FitProblem.from_observations(
            fit.state, as_signed.observations.scale_sigma(_error_ratio(fit, as_signed, chosen))
        )
    robust = replace(signed, fit=fit, problem=problem, rejected=np.flatnonzero(~chosen))
    covariance = predict_from_fit(task, robust).parameter_covariance()
    return replace(robust, fit=replace(fit, covariance=covariance))


def _error_ratio(fit: ArmFit, as_signed: FitProblem, chosen: Chosen) -> float:
    """Return how much larger the errors are than those of the signed fit; few readings cannot say much of it."""
    residuals = whitened_residuals(fit.state, as_signed)[:, chosen]
    freedom = max(residuals.size - effective_unknowns(fit), 1.0)
    square = float((residuals**2).sum()) / freedom
    return float(np.sqrt((_SIGNED_COUNTS_AS + freedom * square) / (_SIGNED_COUNTS_AS + freedom)))


def fewest_readings(task: ArmTask) -> int:
    """Return how many readings a what-if takes: half of a series' own first fit; what they leave open, U tells."""
    return next(count for count in range(1, 1000) if task.enough_for_a_fit(2 * count))


def review_arm(series: ArmSeries, chosen: Chosen | None) -> Review:
    """Judge a calibration; ``chosen`` tells the captures to fit, None those that the run fitted."""
    signed = series.signed_choice()
    used_rows = signed if chosen is None else chosen
    robust, before = fit_of(series, used_rows), fit_of(series, signed)
    points = _review_points(series, used_rows, robust)
    used = np.array([abs(point.residual_m) for point in points if point.used])
    tests = TestPoses(series.tests_rad)
    return Review(
        run_id=series.run_id,
        along="wire" if series.task.kind == "length" else "space",
        signed=bool((used_rows == signed).all()),
        least=fewest_readings(series.task),
        points=points,
        rms_m=_root_mean_square(used),
        max_m=float(used.max()),
        u_m=target_expanded_u(predict_from_fit(series.task, robust), tests)[0],
        signed_rms_m=_root_mean_square(_error_sizes(series, before.fit.state, series.captures)[signed]),
        signed_u_m=target_expanded_u(predict_from_fit(series.task, before), tests)[0],
        validation=_validate_choice(series, used_rows, robust),
        places=places_of(series, robust),
    )


def _review_points(series: ArmSeries, used_rows: Chosen, robust: RobustFit) -> tuple[ReviewPoint, ...]:
    errors = errors_at(robust.fit.state, observations_of(series.task, series.captures))
    residuals = errors[0] if len(errors) == 1 else np.linalg.norm(errors, axis=0)
    off = _normalised_deviations(series, used_rows, robust)
    return tuple(
        ReviewPoint(
            step, bool(used_rows[i]), bool(off[i] > robust.threshold), float(residuals[i]), float(off[i]),
            series.reasons.get(step, ""),
        )
        for i, step in enumerate(series.steps)
    )  # fmt: skip


def _normalised_deviations(series: ArmSeries, used_rows: Chosen, robust: RobustFit) -> Array:
    """Return each residual in deviations of what it may be, which the median tells as in the robust fit."""
    observations, weights = observations_of(series.task, series.captures), used_rows.astype(float)
    scale = float(np.median(robust.problem.observations.sigma_m)) / series.task.sigma_m
    problem = FitProblem.from_observations(robust.fit.state, observations.scale_sigma(scale))
    fit = estimate_arm(
        robust.fit.layout, robust.fit.state, problem, weights
    )  # its covariance belongs to these sigmas
    sizes: Array = np.linalg.norm(standardised_residuals(fit, problem, weights), axis=0)
    typical = float(np.median(sizes[used_rows])) / float(
        np.sqrt(scipy.special.chdtri(series.task.channel_count, 0.5))
    )
    return sizes / max(typical, 1e-12)


def _validate_choice(series: ArmSeries, used_rows: Chosen, robust: RobustFit) -> Validation | None:
    checks = tuple(series.checks.values())
    if not checks:
        return None
    task = series.task
    rows = (
        series.captures[: series.in_force]
        if (used_rows == series.signed_choice()).all()
        else _chosen_captures(series, used_rows)
    )
    nominal = fit_placement(task, observations_of(task, rows), {}).state
    before, after = (_error_sizes(series, state, checks) for state in (nominal, robust.fit.state))
    freedom = len(checks) * task.channel_count
    return Validation(
        before=spread_of(before, freedom),
        after=spread_of(after, freedom),
        points=tuple(
            CheckPoint(step, float(b), float(a))
            for step, b, a in zip(series.checks, before, after, strict=True)
        ),
    )


def _chosen_captures(series: ArmSeries, used_rows: Chosen) -> tuple[ArmCapture, ...]:
    return tuple(capture for capture, taken in zip(series.captures, used_rows, strict=True) if taken)


def spread_of(sizes_m: Array, freedom: int) -> ErrorSpread:
    """Return errors as mean, RMS and maximum; U of the RMS as many readings tell it."""
    rms = _root_mean_square(sizes_m)
    return ErrorSpread(
        float(sizes_m.mean()), rms, float(sizes_m.max()), 2.0 * rms / float(np.sqrt(2.0 * freedom))
    )


def places_of(series: ArmSeries, robust: RobustFit) -> tuple[WorkPlace, ...]:
    """Return the nominal arm's error and the fitted arm's uncertainty where the work is."""
    state, tests = robust.fit.state, TestPoses(series.tests_rad)
    tip = state.flange_tool[:3, 3]
    nominal = state.nominal.tip_positions(series.tests_rad, tip)
    found = _target_positions(state, series.tests_rad)
    residuals_m = np.array(best_fit_transform(nominal.tolist(), found.tolist()).residuals_m)
    u = 2.0 * np.sqrt(target_variances(predict_from_fit(series.task, robust), tests))
    return tuple(
        WorkPlace((float(x), float(y), float(z)), float(np.linalg.norm(error)), float(expanded))
        for (x, y, z), error, expanded in zip(found, residuals_m, u, strict=True)
    )


def target_variances(prediction: MeasurementPrediction, tests: TestPoses) -> Array:
    """Return the variance of the target's place at each posture, three coordinates together [m^2]."""
    rows = tests.tool_point_rows(prediction)
    found = np.einsum("pcn,pq,qcn->n", rows, np.linalg.inv(prediction.information), rows, optimize=True)
    return np.asarray(np.maximum(found, 0.0))


def _target_positions(state: ArmState, joints_rad: Array) -> Array:
    """Return where a model says the target is, in the base (P, 3) [m]."""
    values = term_values(state.nominal, joints_rad, state.terms)
    flanges = state.arm_model.base_flange(state.moved_joints(joints_rad, values))
    return np.asarray((flanges @ state.flange_tool)[:, :3, 3])


def _error_sizes(series: ArmSeries, state: ArmState, captures: tuple[ArmCapture, ...]) -> Array:
    sizes: Array = np.linalg.norm(errors_at(state, observations_of(series.task, captures)), axis=0)
    return sizes


def _root_mean_square(sizes_m: Array) -> float:
    return float(np.sqrt(np.mean(sizes_m**2)))


def chosen_rows(steps: Sequence[str], chosen_steps: Sequence[str] | None) -> Chosen | None:
    """Return which of the steps are wanted; None for the run's own choice.

    Raises
    ------
    ReviewError
        A step is named that is none of this fit.
    """
    if chosen_steps is None:
        return None
    strange: list[Any] = sorted(set(chosen_steps) - set(steps))
    if strange:
        raise ReviewError(
            make_message("{strange!r} is no reading of this run.", strange=strange[0]),
            remedy="Load the page again.",
        )
    return np.isin(np.array(steps), np.array(sorted(set(chosen_steps)), dtype=np.array(steps).dtype))
