"""Causes of a misfit that stand outside the arm: a device on the flange, and columns that take no part but should."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitScore
from cellcal.calibration.identification.misfit_mixed_units import mixed_units
from cellcal.calibration.identification.observations import Observations, PointObservations
from cellcal.calibration.identification.quick_fit import point_residuals, trimmed_point_scores
from cellcal.calibration.message import make_message

_MOST_PARTS = 8  # targets, tools or stations
_FEWEST_ROWS = 8  # of each
_FEWEST_MOVED = 16
_ROUNDS = 40  # of the alternation between the arm's places and what a column moves them by
_EXPLAINED = 0.98  # of the rows

Fit = Callable[[RobotModel, Observations], MisfitScore]


def outer_causes(
    model: RobotModel, some: Observations, columns: Mapping[str, Array], fit: Fit, limit_m: float
) -> tuple[MisfitCause, ...]:
    """Return what explains rows that no reading of their joints and places does, likeliest first.

    Parameters
    ----------
    columns : mapping
        Columns that take no part, one number or code for each row (N,).
    fit : function
        A quick fit of the arm.
    limit_m : float
        What rows that are explained leave at most [m].
    """
    if not isinstance(some, PointObservations) or not np.isfinite(limit_m):
        return ()
    found = [
        *mixed_units(model, some, fit, limit_m),
        *_seen_from_flange(model, some, limit_m),
        *(
            cause
            for name, of in columns.items()
            for cause in _moved_by(model, some, (name, of), fit, limit_m)
        ),
        *(
            cause
            for name, of in columns.items()
            for cause in _divided_by(model, some, (name, of), fit, limit_m)
        ),
    ]
    return tuple(found[:1])


def _seen_from_flange(model: RobotModel, some: PointObservations, limit_m: float) -> Iterator[MisfitCause]:
    """Return the device that rides on the flange and reads the place of something that stands still."""
    inverse = inverse_transform(model.base_flange(some.joints_rad))
    for mirrored in (False, True):
        left_m = float(trimmed_point_scores(inverse[None], some.positions_m[None], np.array([mirrored]))[0])
        if left_m <= limit_m:
            yield MisfitCause(
                ("device",),
                "the device rides on the flange, such as a camera, and reads the place of what stands still",
                "Record the whole pose of what it sees in each row, which is read (`--convention …_inverse_pose`); "
                "or let a device that stands still measure a target on the flange.",
                left_m,
            )


def _moved_by(
    model: RobotModel, some: PointObservations, column: tuple[str, Array], fit: Fit, limit_m: float
) -> Iterator[MisfitCause]:
    """Return a column along whose numbers robot or target moved in one direction: a track, a gantry, a slide."""
    name, values = column
    if len(some) < _FEWEST_MOVED or len(np.unique(values)) < 3 or not np.isfinite(values).all():
        return
    away = (values - values.mean()) / np.std(values)
    flanges, along = model.base_flange(some.joints_rad)[None], np.zeros(3)
    for _ in range(_ROUNDS):
        places = some.positions_m - away[:, None] * along
        along = along - away @ point_residuals(flanges, places[None], np.zeros(1, dtype=bool))[0] / len(away)
    fitted = fit(model, replace(some, positions_m=some.positions_m - away[:, None] * along))
    if fitted.score_m <= limit_m:
        yield MisfitCause(
            ("column",),
            make_message(
                "what column {column!r} tells moved robot or target along a line, by {moved_mm:.3g} mm for 1 of it",
                column=name,
                moved_mm=float(np.linalg.norm(along) / np.std(values)) * 1e3,
            ),
            "Describe the robot with the track that carries it, as a joint that slides (`prismatic` in a URDF or "
            "model file), or keep the rows in which this axis stood in one place.",
            fitted.score_m,
        )


def _divided_by(
    model: RobotModel, some: PointObservations, column: tuple[str, Array], fit: Fit, limit_m: float
) -> Iterator[MisfitCause]:
    """Return a column whose values tell rows apart that fit by themselves: tools, targets, places of the device."""
    name, values = column
    parts = [np.flatnonzero(values == value) for value in np.unique(values)]
    large = [part for part in parts if len(part) >= _FEWEST_ROWS]
    if not 1 < len(large) <= _MOST_PARTS or sum(map(len, large)) < _EXPLAINED * len(values):
        return
    if np.count_nonzero(np.diff(values)) < len(parts):  # one behind the other: found as a break of the series
        return
    left_m = max(fit(model, some.select_rows(part)).score_m for part in large)
    if left_m <= limit_m:
        yield MisfitCause(
            ("column",),
            make_message(
                "rows are taken apart by column {column!r}: {count} targets, tools or places of the device",
                column=name,
                count=len(large),
            ),
            "Keep the rows of one in the file, or describe all of them in a layout (`--layout`, examples in "
            "`deploy/layouts/`).",
            left_m,
        )
