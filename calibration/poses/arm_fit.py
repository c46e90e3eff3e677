"""An arm fitted to one device's readings while they are being taken: what is known so far, and how surely."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.identification.estimator import ArmFit, FitProblem, whitened_residuals
from cellcal.calibration.identification.free_parameters import StartingPoint, parameter_values
from cellcal.calibration.identification.identifiability import parameter_correlations
from cellcal.calibration.identification.observations import (
    DevicePlacement,
    LengthObservations,
    Observations,
    PointObservations,
    Rows,
)
from cellcal.calibration.identification.parameters import GRAVITY, OFFSETS, ArmState, Priors, nominal_state
from cellcal.calibration.identification.robust import RobustFit
from cellcal.calibration.identification.selection import fit_level
from cellcal.calibration.poses.calibrated_arm import FoundParameter
from cellcal.calibration.poses.measurement_prediction import (
    DesignInstrument,
    MeasurementPrediction,
    TestPoses,
    predict_accuracy,
    predict_after_fit,
    predict_from_poses,
    with_targets,
)
from cellcal.calibration.registration import best_fit_transform

Triple = tuple[float, float, float]

_STATED_COUNTS_AS = 10.0  # residuals: how firmly the stated sigma is believed against what the residuals show
_ARM_ROLES = ("offset", "geometry", "gravity")
_FEWEST_READINGS = 24  # of one coordinate each: below, a fit tells less than its priors


@cache
def _nominal_model(name: str) -> RobotModel:
    return load_model(name)


def maker_priors() -> Priors:
    """Return how far an arm may be from its drawing, and a wire from its certificate."""
    return Priors(length_m=5e-4, angle_rad=5e-4, wire_scale=1e-4)


@dataclass(frozen=True, slots=True)
class ArmTask:
    """The task of a fit: which arm, which observations, and what is known beforehand."""

    model: str
    kind: str  # length | point
    sigma_m: float  # expected of one coordinate of a reading: device and what no parameter describes
    target_in_flange_m: Triple  # by a ruler
    anchor_in_base_m: Triple = (0.0, 0.0, 0.0)  # lengths only, by a tape measure
    level: int = GRAVITY
    priors: Priors = field(default_factory=maker_priors)
    points_in_flange_m: tuple[Triple, ...] = ()  # further targets, roughly: mountings 1 and on

    @property
    def channel_count(self) -> int:
        """The number of coordinates of a reading."""
        return 1 if self.kind == "length" else 3

    def nominal_model(self) -> RobotModel:
        """Return the arm as its maker draws it."""
        return _nominal_model(self.model)

    def instrument(self) -> DesignInstrument:
        """Return what the device would say of one posture."""
        return DesignInstrument(self.kind, self.sigma_m, anchor_in_base_m=self.anchor_in_base_m)

    def to_observations(
        self, joints_rad: Array, values_m: Array, targets: Sequence[int] | None = None
    ) -> Observations:
        """Return readings (N, 1) or (N, 3) [m] at these joints as rows of a fit; without targets, of the first."""
        joints, values = np.asarray(joints_rad, dtype=float), np.asarray(values_m, dtype=float)
        sigma, mounting = np.full(len(joints), self.sigma_m), np.zeros(len(joints), dtype=np.intp)
        if targets is not None:
            mounting[:] = targets
        if self.kind == "length":
            return LengthObservations(joints, values.reshape(-1), sigma, mounting)
        return PointObservations(joints, values, sigma, mounting)

    def enough_for_a_fit(self, rows: int) -> bool:
        """Return whether so many readings tell more than the priors do."""
        return rows * self.channel_count >= _FEWEST_READINGS


def fit_arm(task: ArmTask, observations: Observations, *, level: int | None = None) -> RobustFit:
    """Fit an arm robustly; its covariance belongs to the stated sigma, or to that of the residuals if it is larger.

    Few residuals can look small by luck; who stops measuring as soon as it looks good would stop too early.

    Raises
    ------
    CalibrationError
        Readings of another kind than the task's.
    DegenerateDataError
        Too few points to place the device.
    """
    if observations.kind != task.kind:
        raise CalibrationError(f"the task is for {task.kind}s, not {observations.kind}s")
    level_task = task if level is None else replace(task, level=level)
    model = task.nominal_model()
    robust = fit_level(
        model, observations, _initial_places(task, model, observations), level_task.level, task.priors
    )
    covariance = predict_from_fit(level_task, robust).parameter_covariance()
    return replace(robust, fit=replace(robust.fit, covariance=covariance))


def reading_sigma(task: ArmTask, robust: RobustFit) -> float:
    """Return the standard deviation [m] of one coordinate of a reading: as stated, or as found if that is larger."""
    shown = float(np.median(robust.problem.observations.sigma_m)) / task.sigma_m
    freedom = robust.degrees_of_freedom
    mixed = (_STATED_COUNTS_AS + freedom * shown**2) / (_STATED_COUNTS_AS + freedom)
    return task.sigma_m * max(1.0, float(np.sqrt(mixed)))


def predict_task(task: ArmTask, joints_rad: Array) -> MeasurementPrediction:
    """Return what is known before any fit, once these joints are measured."""
    nominal = predict_from_poses(
        task.nominal_model(),
        task.instrument(),
        tool_in_flange_m=task.target_in_flange_m,
        level=task.level,
        priors=task.priors,
    )
    nominal = with_targets(nominal, task.points_in_flange_m, task.priors)
    joints = np.asarray(joints_rad, dtype=float).reshape(-1, task.nominal_model().axis_count)
    return nominal.with_measured(joints) if len(joints) else nominal


def predict_from_fit(task: ArmTask, robust: RobustFit) -> MeasurementPrediction:
    """Return what is known after a fit; further readings are expected to be as good as those before."""
    expected = replace(task, sigma_m=reading_sigma(task, robust))
    observations = robust.problem.observations
    observe = expected.instrument().make_observations
    starting = replace(
        predict_task(task, observations.joints_rad[:0]), state=robust.fit.state, observe=observe
    )
    kept_rows = np.delete(np.arange(len(observations)), robust.rejected)
    return with_readings(starting, observations.joints_rad[kept_rows], observations.mounting[kept_rows])


def with_readings(
    prediction: MeasurementPrediction, joints_rad: Array, targets: Rows
) -> MeasurementPrediction:
    """Return the prediction once readings of several targets (N,) at these joints (N, n) are taken, too."""
    updated = prediction
    for target in np.unique(targets):
        updated = updated.of_target(int(target)).with_measured(joints_rad[targets == target])
        updated = replace(updated, observe=prediction.observe)
    return updated


def further_target_points(state: ArmState) -> tuple[Triple, ...]:
    """Return where the further targets are in the flange [m]."""
    places = (target[:3, 3] for target in state.further)
    return tuple((float(x), float(y), float(z)) for x, y, z in places)


def point_covariance(prediction: MeasurementPrediction) -> Array:
    r"""Return the covariance (3 k, 3 k) [m^2] of the further targets in the flange, as the controller has the flange.

    What stands behind the last axis and where that axis has its zero cannot be told from where the targets are: no
    reading is of the flange itself. The controller's last link and zero are what a tool frame is written on top of;
    so they are held, and what they are wrong by is in the tool.
    """
    layout, last = prediction.layout, prediction.state.nominal.axis_count - 1
    roles = ("offset",) if prediction.state.nominal.dh is None else ("offset", "geometry")
    fixed_parameters = [i for i, p in enumerate(layout.parameters) if p.joint == last and p.role in roles]
    free = np.delete(np.arange(len(layout)), fixed_parameters)
    covariance = np.linalg.inv(prediction.information[np.ix_(free, free)])
    rows = point_rows(prediction)
    at = np.searchsorted(free, rows)
    scales = prediction.scales[rows]
    found: Array = covariance[np.ix_(at, at)] * np.outer(scales, scales)
    return found


def point_rows(prediction: MeasurementPrediction) -> Rows:
    """Return which parameters are the places of the further targets (3 k,)."""
    layout = prediction.layout
    places = [np.arange(len(layout))[layout.target_slice(k)] for k in range(1, 1 + layout.further)]
    return np.concatenate(places) if places else np.zeros(0, dtype=np.intp)


def target_expanded_u(prediction: MeasurementPrediction, tests: TestPoses) -> tuple[float, float]:
    """Return U (k = 2) of the target's place over the test postures: RMS and largest [m]."""
    found = predict_accuracy(prediction, tests)
    return 2.0 * found.tip_rms_m, 2.0 * found.tip_max_m


def errors_at(state: ArmState, observations: Observations) -> Array:
    """Return measured minus predicted (channels, N) [m]."""
    problem = FitProblem.from_observations(state, observations)
    return np.asarray(whitened_residuals(state, problem) * observations.sigma_m)


def predicted_sigma(fit: ArmFit, task: ArmTask, joints_rad: Array, target: int = 0) -> Array:
    """Return the standard uncertainty (N,) [m] with which a fit predicts readings, RMS of their coordinates."""
    prediction = predict_after_fit(fit, task.instrument().make_observations).of_target(target)
    rows = prediction.measurement_rows(np.asarray(joints_rad, dtype=float)) * task.sigma_m
    scaled = fit.covariance / np.outer(prediction.scales, prediction.scales)
    variance = np.einsum("pcn,pq,qcn->n", rows, scaled, rows, optimize=True) / task.channel_count
    sigma: Array = np.sqrt(np.maximum(variance, 0.0))
    return sigma


def found_parameters(fit: ArmFit) -> tuple[FoundParameter, ...]:
    """Return the arm's parameters with their standard uncertainties; places of devices and tools are left out."""
    values, sigma = parameter_values(fit.layout, fit.state), np.sqrt(np.diag(fit.covariance))
    return tuple(
        FoundParameter(p.name, p.unit, float(values[i]), float(sigma[i]), p.prior, p.role)
        for i, p in enumerate(fit.layout.parameters)
        if p.role in _ARM_ROLES
    )


def found_correlations(fit: ArmFit) -> tuple[tuple[float, ...], ...]:
    """Return the correlations of each of `found_parameters` with those before it, rounded to nine digits."""
    rows = [i for i, p in enumerate(fit.layout.parameters) if p.role in _ARM_ROLES]
    rho = np.round(np.clip(parameter_correlations(fit)[np.ix_(rows, rows)], -1.0, 1.0), 9) + 0.0
    return tuple(tuple(row[:i]) for i, row in enumerate(rho.tolist()))


def fit_placement(task: ArmTask, observations: Observations, values: dict[str, float]) -> ArmFit:
    """Fit device, target, and zero and scale of a wire to readings of a known arm."""
    model = task.nominal_model()
    start = StartingPoint(values, free=("base", "tool", "wire"))
    places = _initial_places(task, model, observations)
    return fit_level(model, observations, places, OFFSETS, task.priors, start).fit


def _initial_places(task: ArmTask, model: RobotModel, observations: Observations) -> ArmState:
    """Return the nominal arm with device and target where they roughly are."""
    tool = homogeneous_matrix(np.eye(3), np.array(task.target_in_flange_m))
    further = tuple(homogeneous_matrix(np.eye(3), np.array(place)) for place in task.points_in_flange_m)
    if not isinstance(observations, PointObservations):
        device = DevicePlacement(np.eye(4), np.array(task.anchor_in_base_m))
        return replace(nominal_state(model, (device,), tool), further=further)
    first = np.flatnonzero(observations.mounting == 0)
    in_base = model.tip_positions(observations.joints_rad[first], np.array(task.target_in_flange_m))
    target_pose = best_fit_transform(in_base.tolist(), observations.positions_m[first].tolist()).target_source
    return replace(
        nominal_state(model, (DevicePlacement(target_pose.to_matrix(), np.zeros(3)),), tool), further=further
    )
