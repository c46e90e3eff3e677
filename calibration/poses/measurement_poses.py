"""Which poses to measure for an identification, and how good it will be, before anything is measured.

A prediction holds what would be measured, what is unknown and what is known already: priors only, or a fit.
From it follow the rows of any candidate pose, hence the covariance of parameters and tool point after any
choice of poses. Kinds of observation other than the usual three come in as a function of the joints.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.joint_terms import gravity_terms, term_values
from cellcal.calibration.arm.kinematics import RobotModel, chain_frames, placement_columns
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
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
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import MotionLimits
from cellcal.calibration.poses.optimal_design import (
    DesignChoice,
    DesignTask,
    choose_blocks,
    design_efficiency,
)

_LARGEST_LENGTH_M = 1e-2  # design scale of a place that is not known beforehand
_LARGEST_ANGLE_RAD = float(np.deg2rad(0.5))
_LEARNT_SHARE = 0.5  # of the prior deviation: below, the data speak
_LEAST_SHARE = 1e-12
_STRUCTURE_POSTURES = 200

Observe = Callable[[Array], Observations]
PostureFilter = Callable[[Array], NDArray[np.bool_]]
Place = tuple[float, float, float]


class DesignCriterion(StrEnum):
    """What the chosen poses shall make small."""

    DETERMINANT = "determinant"  # volume of the uncertainty of all parameters (D)
    OFFSETS = "offsets"  # mean variance of the joint offsets that can be known (A)
    TEST_POSES = "test-poses"  # predicted error of the tool point where the user works


@dataclass(frozen=True, slots=True)
class DesignInstrument:
    """What a measuring device would say of one pose; values are one standard deviation."""

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
    """What would be measured, what is unknown, and the information at hand in units of the design scales."""

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


def measurable_postures(
    model: RobotModel,
    limits: MotionLimits,
    count: int,
    *,
    tip_in_flange_m: Place = (0.0, 0.0, 0.0),
    filters: Sequence[PostureFilter] = (),
    seed: int = 1,
) -> Array:
    """Return up to ``count`` postures (C, n) that keep all limits and pass every filter.

    Raises
    ------
    DegenerateDataError
        Not one posture is left; says which condition left none.
    """
    drawn = candidate_joints(model, limits, 2 * count, seed=seed, hook_in_flange_m=tip_in_flange_m)
    if not len(drawn):
        raise DegenerateDataError(
            make_message("{model_name}: no posture keeps the limits.", model_name=model.name),
            remedy="Check joint limits, workspace box and the wire's range against the place of its anchor.",
        )
    for allowed in filters:
        drawn = drawn[allowed(drawn)]
        if not len(drawn):
            raise DegenerateDataError(
                make_message(
                    "{model_name}: no posture is left after a check for collisions or sight.",
                    model_name=model.name,
                ),
                remedy="Check the places and sizes of obstacles.",
            )
    return drawn[:count]


@dataclass(frozen=True, eq=False)
class TestPoses:
    """Where the accuracy of the tool point counts."""

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
    """How well everything will be known; standard deviations in SI."""

    parameters: tuple[str, ...]
    units: tuple[str, ...]
    sigma: tuple[float, ...]
    offsets_rad: tuple[tuple[str, float], ...]  # those that can be known
    tip_rms_m: float  # over the test poses, of the distance (three coordinates together)
    tip_max_m: float  # at the worst test pose


@dataclass(frozen=True, eq=False)
class PosePlan:
    """Chosen poses, most telling first, and what will be known once they are measured."""

    indices: tuple[int, ...]
    joints_rad: Array  # (k, n)
    criterion: DesignCriterion
    prediction: AccuracyPrediction
    after: MeasurementPrediction  # once they are measured


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
        if parameter.role == "offset" and deviation < _LEARNT_SHARE * parameter.prior
    )
    return AccuracyPrediction(
        tuple(parameter.name for parameter in parameters),
        tuple(parameter.unit for parameter in parameters),
        tuple(float(deviation) for deviation in sigma),
        offsets,
        float(np.sqrt(variance.mean())),
        float(np.sqrt(variance.max())),
    )


def choose_poses(
    prediction: MeasurementPrediction,
    candidates_rad: Array,
    k: int,
    tests: TestPoses,
    *,
    criterion: DesignCriterion = DesignCriterion.TEST_POSES,
    starts: int = 3,
) -> PosePlan:
    """Choose the k candidates to measure next.

    Parameters
    ----------
    prediction : MeasurementPrediction
        From nominal, or from a fit onward.
    candidates_rad : (C, n)
        Postures that can be measured [rad].
    k : int
        How many.
    tests : TestPoses
        Where the predicted error counts.
    criterion : Criterion
        ``OFFSETS`` for mastering, ``TEST_POSES`` for accuracy at known work, ``DETERMINANT`` for all round.
    starts : int
        Of the search; more find slightly better plans [1].
    """
    candidates = np.asarray(candidates_rad, dtype=float)
    task = design_task(prediction, candidates, criterion, tests)
    choice = choose_blocks(task, k, starts=starts)
    indices = list(choice.indices)
    after = replace(prediction, information=task.information_of(np.array(indices, dtype=np.intp)))
    return PosePlan(choice.indices, candidates[indices], criterion, predict_accuracy(after, tests), after)


def plan_efficiency(
    prediction: MeasurementPrediction, candidates_rad: Array, plan: PosePlan, tests: TestPoses
) -> float:
    """Return how near a plan from these candidates comes to what no choice can exceed, at most 1.

    The bound is that of a relaxation to fractions of poses; with few poses nothing real comes near it.
    """
    task = design_task(prediction, np.asarray(candidates_rad, dtype=float), plan.criterion, tests)
    value = task.criterion_value(task.information_of(np.array(plan.indices, dtype=np.intp)))
    return design_efficiency(task, DesignChoice(plan.indices, value), rank=_learnable_directions(task))


def design_task(
    prediction: MeasurementPrediction, candidates_rad: Array, criterion: DesignCriterion, tests: TestPoses
) -> DesignTask:
    """Return the rows of all candidates and what to make small, for `optimal_design`."""
    task = DesignTask(
        np.ascontiguousarray(prediction.measurement_rows(candidates_rad)), prediction.information
    )
    if criterion is DesignCriterion.DETERMINANT:
        return task
    if criterion is DesignCriterion.TEST_POSES:
        rows = tests.tool_point_rows(prediction)
        square = np.einsum("pcn,qcn->pq", rows, rows, optimize=True) / rows.shape[2]
        return replace(task, interest=_square_root(square))
    every = np.linalg.inv(task.information_of(np.arange(task.candidate_count)))
    is_known = np.sqrt(np.diag(every)) * prediction.scales < _LEARNT_SHARE * prediction.layout.prior_sigmas
    offset_indices = [
        i for i, item in enumerate(prediction.layout.parameters) if item.role == "offset" and is_known[i]
    ]
    if not offset_indices:
        raise DegenerateDataError("no candidate tells anything about a joint offset")
    return replace(task, interest=np.eye(len(prediction.layout))[:, offset_indices])


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


def _square_root(square: Array) -> Array:
    """Return (p, r) with ``root @ root.T == square``."""
    values, vectors = np.linalg.eigh(square)
    is_significant = values > _LEAST_SHARE * values[-1]
    return np.asarray(vectors[:, is_significant] * np.sqrt(values[is_significant]), dtype=np.float64)


def _learnable_directions(task: DesignTask) -> int:
    """Return in how many directions all candidates together say more than what is known."""
    half = np.linalg.inv(np.linalg.cholesky(task.information))
    gained = half @ (task.information_of(np.arange(task.candidate_count)) - task.information) @ half.T
    return max(int((np.linalg.eigvalsh(gained) > 1.0).sum()), 1)
