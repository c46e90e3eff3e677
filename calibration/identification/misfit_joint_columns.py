"""One column of joints that is at fault: rows apart from the others, another gear, or together with another joint."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_couplings import pair_readings
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitScore, say_column_apart
from cellcal.calibration.identification.misfit_hypotheses import FileNames, JointInterpretation
from cellcal.calibration.identification.observations import Observations, PointObservations, Rows
from cellcal.calibration.identification.quick_fit import refine_number, trimmed_joint_scores
from cellcal.calibration.message import make_message

_FEWEST_ROWS = 20
_MOST_FITTED = 8
_APART = (1, -1, 2, -2, 3, -3)
_FACTORS = (2.0, 0.5, -2.0, -0.5, 10.0, 0.1)
_WIDEST = 0.1  # of a gear that is not quite the right one
_STEPS = (0.01, 0.001)
_LEAST = 0.003

Fit = Callable[[RobotModel, Observations], MisfitScore]


def joint_column_causes(
    model: RobotModel, series: Observations, rows: Rows, names: FileNames, fit: Fit, limit_m: float
) -> tuple[MisfitCause, ...]:
    """Return what is wrong with one column of joints, if rows then leave no more than the limit [m].

    Parameters
    ----------
    series : observations
        All rows, in the order of the file, of which ``rows`` are looked at.
    """
    some = series.select_rows(rows)
    if not isinstance(some, PointObservations) or len(some) < _FEWEST_ROWS or not np.isfinite(limit_m):
        return ()
    readings = [
        *_apart(series.joints_rad, rows, names),
        *_other_gears(model, some, names),
        *_together(some.joints_rad, names),
        *_turned_along(model, some, names),
    ]
    return fit_best_readings(model, some, readings, fit, limit_m, most=_MOST_FITTED)


def fit_best_readings(
    model: RobotModel,
    some: PointObservations,
    readings: Sequence[JointInterpretation],
    fit: Fit,
    limit_m: float,
    *,
    most: int,
) -> tuple[MisfitCause, ...]:
    """Return the reading with which the rows leave least, if no more than the limit [m].

    The fit is made of the ``most`` readings that score best by the rows that fit best.
    """
    scores = trimmed_joint_scores(
        model, np.stack([reading.joints_rad for reading in readings]), some.positions_m
    )
    found = []
    for at in np.argsort(scores, kind="stable")[:most].tolist():
        left_m = fit(model, replace(some, joints_rad=readings[at].joints_rad)).score_m
        if left_m <= limit_m:
            found.append(MisfitCause((readings[at].kind,), readings[at].says, readings[at].cure, left_m))
    return tuple(sorted(found, key=lambda cause: cause.remaining_m)[:1])


def _apart(series_rad: Array, rows: Rows, names: FileNames) -> Iterator[JointInterpretation]:
    for joint, count in itertools.product(range(series_rad.shape[1]), _APART):
        changed = series_rad.copy()
        changed[:, joint] = np.roll(series_rad[:, joint], count)
        yield JointInterpretation(
            "rows",
            1,
            changed[rows],
            say_column_apart(names.joints[joint], -count),
            "Put each of its values beside the others of its row.",
        )


def _other_gears(
    model: RobotModel, some: PointObservations, names: FileNames
) -> Iterator[JointInterpretation]:
    """Return each joint with its motion larger or smaller, by a plain factor or by a little."""
    for joint in range(model.axis_count):
        near = 1.0 + refine_number(
            lambda parts, of=joint: trimmed_joint_scores(  # type: ignore[misc]
                model, _multiplied(some.joints_rad, of, 1.0 + parts), some.positions_m
            ),
            _WIDEST,
            _STEPS,
        )
        for factor in (*_FACTORS, *((near,) if abs(near - 1.0) >= _LEAST else ())):
            yield JointInterpretation(
                "gear",
                1,
                _multiplied(some.joints_rad, joint, np.array([factor]))[0],
                make_message(
                    "{joint} moves about {factor:.3g} times as far as its column says",
                    joint=names.joints[joint],
                    factor=factor,
                ),
                "See the gear ratio with which this column was calculated, and correct the column in the file.",
            )


def _turned_along(
    model: RobotModel, some: PointObservations, names: FileNames
) -> Iterator[JointInterpretation]:
    """Return each joint with the share of one of the two before it that its column lacks, as wrists have."""
    for joint, behind in itertools.product(range(model.axis_count), (1, 2)):
        before = joint - behind
        if before < 1:
            continue
        share = refine_number(
            lambda shares, of=joint, by=before: trimmed_joint_scores(  # type: ignore[misc]
                model, _with_share(some.joints_rad, of, by, shares), some.positions_m
            ),
            _WIDEST,
            _STEPS,
        )
        if abs(share) < _LEAST:
            continue
        yield JointInterpretation(
            "coupling",
            1,
            _with_share(some.joints_rad, joint, before, np.array([share]))[0],
            make_message(
                "{joint} turns by about {share:+.3f} of {other} more than its column says",
                joint=names.joints[joint],
                share=share,
                other=names.joints[before],
            ),
            "See how the controller or the log couples these joints, and correct the column in the file.",
        )


def _with_share(joints_rad: Array, joint: int, before: int, shares: Array) -> Array:
    """Return joints (H, N, n) of which one has each share (H,) of another added."""
    joints = np.repeat(joints_rad[None], len(shares), axis=0)
    joints[:, :, joint] += shares[:, None] * joints_rad[:, before]
    return joints


def _multiplied(joints_rad: Array, joint: int, factors: Array) -> Array:
    """Return joints (H, N, n) of which one is multiplied with each factor (H,)."""
    joints = np.repeat(joints_rad[None], len(factors), axis=0)
    joints[:, :, joint] *= factors[:, None]
    return joints


def _together(joints_rad: Array, names: FileNames) -> Iterator[JointInterpretation]:
    for at, coupled in itertools.permutations(range(joints_rad.shape[1]), 2):
        yield from pair_readings(joints_rad, names, at, coupled)
