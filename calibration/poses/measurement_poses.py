"""Which poses to measure for an identification, by what they are predicted to bring."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.motion_check import MotionLimits, narrow_joints
from cellcal.calibration.poses.measurement_prediction import (
    LEARNT_SHARE,
    AccuracyPrediction,
    MeasurementPrediction,
    Place,
    TestPoses,
    predict_accuracy,
)
from cellcal.calibration.poses.optimal_design import (
    DesignChoice,
    DesignTask,
    choose_blocks,
    design_efficiency,
)

_LEAST_SHARE = 1e-12


PostureFilter = Callable[[Array], NDArray[np.bool_]]


class DesignCriterion(StrEnum):
    """The quantity that the chosen poses shall make small."""

    DETERMINANT = "determinant"  # volume of the uncertainty of all parameters (D)
    OFFSETS = "offsets"  # mean variance of the joint offsets that can be known (A)
    TEST_POSES = "test-poses"  # predicted error of the tool point where the user works


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
        if narrow := narrow_joints(model, limits):
            raise DegenerateDataError(
                make_message(
                    "{model_name}: the range of {joints} is smaller than the distance to keep from both its ends.",
                    model_name=model.label,
                    joints=", ".join(model.joint_names[joint] for joint in narrow),
                ),
                remedy="Correct its limits in the robot's description, or describe a joint that does not move as "
                "fixed.",
            )
        raise DegenerateDataError(
            make_message("{model_name}: no posture keeps the limits.", model_name=model.label),
            remedy="Check joint limits, workspace box and the wire's range against the place of its anchor.",
        )
    for allowed in filters:
        drawn = drawn[allowed(drawn)]
        if not len(drawn):
            raise DegenerateDataError(
                make_message(
                    "{model_name}: no posture is left after a check for collisions or sight.",
                    model_name=model.label,
                ),
                remedy="Check the places and sizes of obstacles.",
            )
    return drawn[:count]


@dataclass(frozen=True, eq=False)
class PosePlan:
    """Chosen poses, most telling first, and what will be known once they are measured."""

    indices: tuple[int, ...]
    joints_rad: Array  # (k, n)
    criterion: DesignCriterion
    prediction: AccuracyPrediction
    after: MeasurementPrediction  # once they are measured


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
    is_known = np.sqrt(np.diag(every)) * prediction.scales < LEARNT_SHARE * prediction.layout.prior_sigmas
    offset_indices = [
        i for i, item in enumerate(prediction.layout.parameters) if item.role == "offset" and is_known[i]
    ]
    if not offset_indices:
        raise DegenerateDataError("no candidate tells anything about a joint offset")
    return replace(task, interest=np.eye(len(prediction.layout))[:, offset_indices])


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
