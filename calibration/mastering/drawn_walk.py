"""What a recovery would have taken without choosing its poses: evenly drawn ones, for the same certainty."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.pose_design import candidate_joints, predict_turns, turn_covariances
from cellcal.calibration.motion.motion_check import MotionLimits
from cellcal.calibration.wires.reference import WirePredictor

_POOL, _DRAWS = 60, 5


@dataclass(frozen=True, slots=True)
class DrawnWalk:
    """A walk that was taken, beside one through evenly drawn poses that knows the least known motor as well.

    Travel is of all axes added [rad]: a robot that lost its encoders moves them one at a time.
    """

    travel_rad: float
    drawn_captures: int | None  # median of a few draws; None: more than were drawn
    drawn_travel_rad: (
        float  # in the shortest order found, whether or not every way is free; 0 where there is none
    )


def drawn_walk(
    model: RobotModel, record: MasteringRecord, limits: MotionLimits, here_rad: Array, measured_rad: Array
) -> DrawnWalk:
    """Compare a walk with evenly drawn poses.

    Parameters
    ----------
    here_rad : (n,)
        Where the walk began [rad].
    measured_rad : (N, n)
        Its captures, in order [rad].
    """
    measured = np.asarray(measured_rad, dtype=float).reshape(-1, model.axis_count)
    worst = float(predict_turns(model, record, measured)[1].max())
    predictor, hook = WirePredictor(model, *record.wire_lengths()), record.wire_lengths()[1].hook_in_flange_m
    found: list[tuple[float, float]] = []
    for seed in range(_DRAWS):
        pool = candidate_joints(model, limits, _POOL, seed=seed, hook_in_flange_m=hook)
        count = _poses_needed(record, predictor, pool, worst)
        travel = np.inf if count is None else _travel_rad(here_rad, _nearest_first(here_rad, pool[:count]))
        found.append((np.inf if count is None else float(count), travel))
    captures, travel = sorted(found)[_DRAWS // 2]
    own = _travel_rad(here_rad, measured)
    return DrawnWalk(own, None, 0.0) if np.isinf(captures) else DrawnWalk(own, int(captures), float(travel))


def _poses_needed(record: MasteringRecord, predictor: WirePredictor, pool: Array, worst: float) -> int | None:
    """Return how many of the first know every motor at least that well; more never tell less."""
    covariance_of = turn_covariances(record, predictor, pool)
    low, high = 1, len(pool) + 1  # the last stands for too many
    while low < high:
        middle = (low + high) // 2
        good = middle <= len(pool) and float(np.diag(covariance_of(middle)).max()) <= worst**2
        low, high = (low, middle) if good else (middle + 1, high)
    return low if low <= len(pool) else None


def _nearest_first(here_rad: Array, poses_rad: Array) -> Array:
    remaining, here, ordered = list(poses_rad), np.asarray(here_rad, dtype=float), list[Array]()
    while remaining:
        nearest = int(np.argmin([np.abs(pose - here).sum() for pose in remaining]))
        here = remaining.pop(nearest)
        ordered.append(here)
    return np.array(ordered)


def _travel_rad(here_rad: Array, poses_rad: Array) -> float:
    return float(np.abs(np.diff(np.vstack([here_rad, poses_rad]), axis=0)).sum())
