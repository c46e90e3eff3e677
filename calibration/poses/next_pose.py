"""Which posture tells most next about the target where the robot works, given all that is known already."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.poses.measurement_poses import DesignCriterion, design_task
from cellcal.calibration.poses.measurement_prediction import MeasurementPrediction, TestPoses
from cellcal.calibration.poses.optimal_design import DesignTask

_LARGEST_TURN_RAD = np.pi  # the scale on which turns of joints are compared with ways of the target


@dataclass(frozen=True, eq=False)
class NextPoses:
    """Poses in the order in which they were chosen, and what will be known once they are measured."""

    order: tuple[int, ...]
    after: MeasurementPrediction


def choose_in_turn(
    prediction: MeasurementPrediction,
    candidates_rad: Array,
    tests: TestPoses,
    enough: Callable[[int, MeasurementPrediction], bool],
    *,
    most: int,
    criterion: DesignCriterion = DesignCriterion.TEST_POSES,
) -> NextPoses:
    r"""Choose one candidate after the other, each the one that tells most once those before it are measured.

    With covariance S, rows B of a candidate and the root L of what counts, measuring it shrinks ``trace(L' S L)``
    by ``trace((1 + B S B')^-1 B S L L' S B')``.

    Parameters
    ----------
    prediction : MeasurementPrediction
        What is known.
    candidates_rad : (C, n)
        Postures that can be measured [rad].
    tests : TestPoses
        Where the target's place counts.
    enough : callable
        Of how many were chosen, and what will be known: whether to stop.
    most : int
        Never more than these.
    criterion : Criterion
        ``TEST_POSES`` or ``OFFSETS``.

    References
    ----------
    V. V. Fedorov, Theory of optimal experiments, 1972.
    """
    task = design_task(prediction, np.asarray(candidates_rad, dtype=float), criterion, tests)
    return _choose_by_gain(task, prediction, enough, most)


def choose_for_unknowns(
    prediction: MeasurementPrediction,
    candidates_rad: Array,
    unknowns: Rows,
    enough: Callable[[int, MeasurementPrediction], bool],
    *,
    most: int,
) -> NextPoses:
    """Choose one candidate after the other as `choose_in_turn`, by the information on some unknowns."""
    columns = np.ascontiguousarray(prediction.measurement_rows(np.asarray(candidates_rad, dtype=float)))
    interest = np.eye(len(prediction.layout))[:, unknowns]
    return _choose_by_gain(DesignTask(columns, prediction.information, interest), prediction, enough, most)


def _choose_by_gain(
    task: DesignTask,
    prediction: MeasurementPrediction,
    enough: Callable[[int, MeasurementPrediction], bool],
    most: int,
) -> NextPoses:
    order: list[int] = []
    while len(order) < min(most, task.candidate_count) and not enough(len(order), prediction):
        worth = _information_gains(task, prediction.information)
        worth[order] = -np.inf
        order.append(int(np.argmax(worth)))
        rows = task.columns[:, :, order[-1]]
        prediction = replace(prediction, information=prediction.information + rows @ rows.T)
    return NextPoses(tuple(order), prediction)


def _information_gains(task: DesignTask, information: Array) -> Array:
    covariance = np.linalg.inv(information)
    interest = np.eye(len(covariance)) if task.interest is None else task.interest
    spread = np.tensordot(covariance, task.columns, axes=1)
    reach = np.tensordot(interest.T, spread, axes=1)  # (r, m, C)
    gram = np.einsum("pac,pbc->cab", task.columns, spread)
    inner = np.linalg.inv(gram + np.eye(task.columns.shape[1]))
    found: Array = np.einsum("rmc,cmn,rnc->c", reach, inner, reach, optimize=True)
    return found


def random_poses_needed(
    prediction: MeasurementPrediction,
    pool_rad: Array,
    reached: Callable[[MeasurementPrediction], bool],
    *,
    draws: int = 5,
) -> int | None:
    """Return how many evenly drawn postures reach the same as a choice, median of several draws; None if too many.

    Parameters
    ----------
    prediction : MeasurementPrediction
        Before anything is measured.
    pool_rad : (C, n)
        Postures to draw from [rad].
    reached : callable
        Whether what is known is enough; more readings never tell less.
    draws : int
        How many plans are drawn, seeds 0 and on [1].
    """
    found: list[float] = []
    for seed in range(draws):
        drawn = pool_rad[np.random.default_rng(seed).permutation(len(pool_rad))]
        low, high = 1, len(drawn) + 1  # the last stands for too many
        while low < high:
            middle = (low + high) // 2
            good = middle <= len(drawn) and reached(prediction.with_measured(drawn[:middle]))
            low, high = (low, middle) if good else (middle + 1, high)
        found.append(low)
    median = sorted(found)[draws // 2]
    return None if median > len(pool_rad) else int(median)


def spread_order(
    joints_rad: Array, places_m: Array, count: int, *, first: Sequence[int] = ()
) -> tuple[int, ...]:
    """Return postures far from each other in joints and in the target's place, each the farthest from all before.

    Parameters
    ----------
    joints_rad, places_m : (N, n), (N, 3)
        Postures and where the target is in them [rad, m].
    count : int
        How many.
    first : sequence of int
        Postures that are taken already; they are not returned.
    """
    turned = np.asarray(joints_rad, dtype=float) / _LARGEST_TURN_RAD
    size = float(np.ptp(places_m, axis=0).max()) or 1.0
    points = np.hstack([turned / np.sqrt(turned.shape[1]), np.asarray(places_m, dtype=float) / size])
    middle = points.mean(axis=0)
    nearest = np.full(len(points), np.inf)
    for taken in first:
        nearest = np.minimum(nearest, np.linalg.norm(points - points[taken], axis=1))
    chosen: list[int] = []
    while len(chosen) < min(count, len(points) - len(first)):
        begins = not chosen and not first
        distance = np.linalg.norm(points - middle, axis=1) if begins else nearest.copy()
        distance[[*chosen, *first]] = -np.inf
        chosen.append(int(np.argmax(distance)))
        nearest = np.minimum(nearest, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return tuple(chosen)
