"""How good an identification will be, before anything is measured.

A prediction holds what would be measured, what is unknown and what is known already: priors only, or a fit.
From it follow the rows of any candidate pose, hence the covariance of parameters and tool point after any
choice of poses. Kinds of observation other than the usual three come in as a function of the joints.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.joint_terms import gravity_terms, term_values
from cellcal.calibration.arm.kinematics import RobotModel, chain_frames, placement_columns
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix
from cellcal.calibration.identification.base_parameters import base_subset
from cellcal.calibration.identification.estimator import ArmFit, FitProblem, place_columns
from cellcal.calibration.identification.identifiability import NotIdentified, not_identified
from cellcal.calibration.identification.layouts import make_layout, with_further
from cellcal.calibration.identification.observations import (
    DevicePlacement,
    LengthObservations,
    Observations,
    PointObservations,
    with_mounting,
)
from cellcal.calibration.identification.observations import pose_from_points as with_attitudes
from cellcal.calibration.identification.parameters import (
    GEOMETRY,
    GRAVITY,
    ArmState,
    ParameterLayout,
    Priors,
    nominal_state,
)
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.motion.motion_check import MotionLimits

_LARGEST_LENGTH_M = 1e-2  # design scale of a place that is not known beforehand
_LARGEST_ANGLE_RAD = float(np.deg2rad(0.5))
LEARNT_SHARE = 0.5  # of the prior deviation: below, the data determine the value
_STRUCTURE_POSTURES = 200


Place = tuple[float, float, float]
Observe = Callable[[Array], Observations]


@dataclass(frozen=True, slots=True)
class DesignInstrument:
    """The deviations of a measuring device's readings at one pose; values are one standard deviation."""

    kind: str  # point | pose | length
    sigma_m: float
    sigma_rad: float = 0.0  # of attitudes; poses only
    anchor_in_base_m: Place = (0.0, 0.0, 0.0)  # lengths only

    def __post_init__(self) -> None:
        numbers = [self.sigma_m, self.sigma_rad, *self.anchor_in_base_m]
        valid = bool(np.isfinite(numbers).all()) and self.sigma_m > 0
        if self.kind not in ("point", "pose", "length") or not valid:
            raise CalibrationError("an instrument measures point, pose or length, with a sigma above zero")
        if self.kind == "pose" and not self.sigma_rad > 0:
            raise CalibrationError("an instrument that measures poses has a sigma of attitudes, too")

    def make_observations(self, joints_rad: Array) -> Observations:
        """Return observations at these joints whose sigmas hold and whose values do not matter."""
        count = len(joints_rad)
        mounting, sigma = np.zeros(count, dtype=np.intp), np.full(count, self.sigma_m)
        if self.kind == "length":
            return LengthObservations(joints_rad, np.zeros(count), sigma, mounting)
        points = PointObservations(joints_rad, np.zeros((count, 3)), sigma, mounting)
        if self.kind == "point":
            return points
        turns = np.broadcast_to(np.eye(3), (count, 3, 3))
        return with_attitudes(points, turns, np.full(count, self.sigma_rad))


@dataclass(frozen=True, eq=False)
class MeasurementPrediction:
    """The predicted readings, the unknowns, and the information at hand in units of the design scales."""

    layout: ParameterLayout
    state: ArmState
    observe: Observe
    scales: Array  # (p,)
    information: Array  # (p, p)

    def measurement_rows(self, joints_rad: Array) -> Array:
        """Return the whitened rows (p, channels, N) of measurements at these joints, scaled."""
        problem = FitProblem.from_observations(self.state, self.observe(joints_rad))
        return place_columns(self.layout, self.state, problem)[0] * self.scales[:, None, None]

    def of_target(self, mounting: int) -> "MeasurementPrediction":
        """Return the prediction on readings of another of the targets; 0 is the first."""
        return replace(self, observe=lambda joints: rows_of_mounting(self.observe(joints), mounting))

    def with_measured(self, joints_rad: Array, *, times: float = 1.0) -> "MeasurementPrediction":
        """Return the prediction once these joints are measured, too, so many times each."""
        rows = self.measurement_rows(joints_rad).reshape(len(self.scales), -1)
        return replace(self, information=self.information + times * (rows @ rows.T))

    def parameter_covariance(self) -> Array:
        """Return the covariance (p, p) of the parameters, in their own units."""
        covariance: Array = np.linalg.inv(self.information) * np.outer(self.scales, self.scales)
        return covariance

    def not_identified(self) -> tuple[NotIdentified, ...]:
        """Return what stays unknown, with its partner and the cure."""
        return not_identified(self.as_fit())

    def as_fit(self) -> ArmFit:
        """Return a fit with this covariance, for everything that judges fits."""
        return ArmFit(
            self.state, self.layout, self.parameter_covariance(), np.zeros(len(self.layout)), 0.0, 0
        )


def predict_from_poses(
    model: RobotModel,
    instrument: DesignInstrument,
    *,
    tool_in_flange_m: Place = (0.0, 0.0, 0.0),
    level: int = GEOMETRY,
    priors: Priors | None = None,
    drop_redundant: bool = False,
) -> MeasurementPrediction:
    """Return the prediction on a robot of which nothing is known but its nominal model and the priors.

    From the level of gravity on, the terms of sag are unknown, too; gear ripple is not planned for. Parameters
    that others can imitate are carried by their priors, and widen those others; or they are dropped, and the
    offsets are what they stand for together.
    """
    terms = gravity_terms(model) if level >= GRAVITY else ()
    tool = np.eye(4)
    tool[:3, 3] = tool_in_flange_m
    device = DevicePlacement(np.eye(4), np.array(instrument.anchor_in_base_m))
    state = replace(nominal_state(model, (device,), tool), terms=terms, coefficients=np.zeros(len(terms)))
    layout = make_layout(model, instrument.kind, 1, level=level, terms=terms, priors=priors)
    if drop_redundant:
        postures = candidate_joints(model, MotionLimits(), _STRUCTURE_POSTURES)
        layout = base_subset(layout, state, instrument.make_observations(postures))
    return _predict_prior(layout, state, instrument.make_observations)


def with_targets(
    prediction: MeasurementPrediction, places: Sequence[Place], priors: Priors
) -> MeasurementPrediction:
    """Return what is expected before any measurement, with further targets on the flange seen from one place."""
    further = tuple(homogeneous_matrix(np.eye(3), np.array(place)) for place in places)
    layout = with_further(prediction.layout, len(places), priors)
    return _predict_prior(layout, replace(prediction.state, further=further), prediction.observe)


def _predict_prior(layout: ParameterLayout, state: ArmState, observe: Observe) -> MeasurementPrediction:
    scales = _design_scales(layout)
    return MeasurementPrediction(layout, state, observe, scales, np.diag((scales / layout.prior_sigmas) ** 2))


def rows_of_mounting(observations: Observations, mounting: int) -> Observations:
    """Return the rows as those of one mounting."""
    return with_mounting(observations, np.full(len(observations), mounting))


def predict_after_fit(fit: ArmFit, observe: Observe) -> MeasurementPrediction:
    """Return the prediction after a fit: what more measurements would add to what it knows."""
    scales = _design_scales(fit.layout)
    information = np.linalg.inv(fit.covariance / np.outer(scales, scales))
    return MeasurementPrediction(fit.layout, fit.state, observe, scales, (information + information.T) / 2)


@dataclass(frozen=True, eq=False)
class TestPoses:
    """The poses at which the accuracy of the tool point counts."""

    __test__ = False  # not a test case

    joints_rad: Array  # (T, n)
    tip_in_flange_m: Place | None = None  # None: the measured target itself

    def tool_point_rows(self, prediction: MeasurementPrediction) -> Array:
        """Return how the tool point follows each parameter (p, 3, T), scaled.

        With a tracker, in the tracker's frame. Lengths have no frame: what a user frame set at the test poses
        would take away is taken away, any rigid motion of all of them together.
        """
        state, joints = prediction.state, np.asarray(self.joints_rad, dtype=float)
        mounting = len(state.devices) - 1
        values = term_values(state.nominal, joints, state.terms)
        rotations, origins = chain_frames(state.seen_from(mounting), state.moved_joints(joints, values))
        tip = origins[-1]
        if self.tip_in_flange_m is not None:
            offset = np.asarray(self.tip_in_flange_m) - state.flange_tool[:3, 3]
            across = state.flange_tool[:3, :3].T @ offset
            tip = tip + np.einsum("jin,i->jn", rotations[-1], across)
        columns = placement_columns(rotations, origins, tip).reshape(-1, 3, len(joints))
        moved = [columns[6 * term.joint + 5] * value for term, value in zip(state.terms, values, strict=True)]
        every = np.concatenate([columns, np.reshape(moved, (-1, 3, len(joints)))])
        tangent = prediction.layout.tangent_rows(state, mounting)[:, : len(every)]
        rows = np.einsum("pr,rcn->pcn", tangent, every, optimize=True) * prediction.scales[:, None, None]
        for row, parameter in enumerate(prediction.layout.parameters):
            if self.tip_in_flange_m is not None and parameter.role == "tool":
                rows[row] = 0.0
        return _without_rigid_motion(rows, tip) if prediction.layout.kind == "length" else rows


@dataclass(frozen=True, slots=True)
class AccuracyPrediction:
    """The predicted accuracy of everything; standard deviations in SI."""

    parameters: tuple[str, ...]
    units: tuple[str, ...]
    sigma: tuple[float, ...]
    offsets_rad: tuple[tuple[str, float], ...]  # those that can be known
    tip_rms_m: float  # over the test poses, of the distance (three coordinates together)
    tip_max_m: float  # at the worst test pose


def predict_accuracy(prediction: MeasurementPrediction, tests: TestPoses) -> AccuracyPrediction:
    """Predict parameter and tool point uncertainty from the information of a prediction."""
    covariance = np.linalg.inv(prediction.information)
    rows = tests.tool_point_rows(prediction)
    variance = np.einsum("pcn,pq,qcn->n", rows, covariance, rows, optimize=True)
    sigma = np.sqrt(np.diag(covariance)) * prediction.scales
    parameters = prediction.layout.parameters
    offsets = tuple(
        (parameter.name, float(deviation))
        for parameter, deviation in zip(parameters, sigma, strict=True)
        if parameter.role == "offset" and deviation < LEARNT_SHARE * parameter.prior
    )
    return AccuracyPrediction(
        tuple(parameter.name for parameter in parameters),
        tuple(parameter.unit for parameter in parameters),
        tuple(float(deviation) for deviation in sigma),
        offsets,
        float(np.sqrt(variance.mean())),
        float(np.sqrt(variance.max())),
    )


def _design_scales(layout: ParameterLayout) -> Array:
    largest = {"m": _LARGEST_LENGTH_M, "rad": _LARGEST_ANGLE_RAD}
    return np.array([min(item.prior, largest.get(item.unit, item.prior)) for item in layout.parameters])


def _without_rigid_motion(rows: Array, tip: Array) -> Array:
    """Take away from (p, 3, T) what one rigid motion of all tips (3, T) explains."""
    count = tip.shape[1]
    shifts = np.repeat(np.eye(3)[:, :, None], count, axis=2)
    turns = np.stack([np.cross(axis, (tip - tip.mean(axis=1, keepdims=True)).T).T for axis in np.eye(3)])
    left, sizes, _ = np.linalg.svd(np.concatenate([shifts, turns]).reshape(6, -1).T, full_matrices=False)
    motions = left[:, sizes > 1e-9 * sizes[0]]
    flat = rows.reshape(len(rows), -1)
    return np.asarray((flat - (flat @ motions) @ motions.T).reshape(rows.shape), dtype=np.float64)
