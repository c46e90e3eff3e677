"""A part of the rows written in another unit than the others: metres below millimetres, radians below degrees."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import degrees, log

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitScore
from cellcal.calibration.identification.observations import Observations, PointObservations
from cellcal.calibration.message import make_message

_LENGTHS = (("m", "mm", 1000.0), ("m", "cm", 100.0), ("m", "inch", 1.0 / 0.0254), ("inch", "mm", 25.4))
_ALIKE = log(4.0)  # how far the ratio of two parts may be from that of two units
_SMALLEST_GAP = log(4.0)
_FEWEST_ROWS = 4  # of each part
_FULL_TURN_RAD = 6.3

Fit = Callable[[RobotModel, Observations], MisfitScore]


def mixed_units(
    model: RobotModel, some: PointObservations, fit: Fit, limit_m: float
) -> Iterator[MisfitCause]:
    """Give the unit of a part of the rows with which all fit; at most ``limit_m`` is left [m]."""
    for what, first, second, small, changed in (*_places(some), *_joints(model, some)):
        left_m = fit(model, changed).score_m
        if left_m > limit_m:
            continue
        says = make_message(
            "{what} of a part of the rows are in {first} and of the others in {second}: {small} of {count} rows are "
            "the smaller part",
            what=what,
            first=first,
            second=second,
            small=int(small.sum()),
            count=len(some),
        )
        yield MisfitCause(("mixed",), says, "Write all rows of a column in one unit.", left_m)


def _places(some: PointObservations) -> Iterator[tuple[str, str, str, NDArray[np.bool_], PointObservations]]:
    sizes = np.log(np.maximum(np.linalg.norm(some.positions_m, axis=1), 1e-9))
    ordered = np.sort(sizes)
    at = int(np.argmax(np.diff(ordered)))
    if ordered[at + 1] - ordered[at] < _SMALLEST_GAP:
        return
    small = sizes <= ordered[at]
    if min(small.sum(), (~small).sum()) < _FEWEST_ROWS:
        return
    ratio = float(np.median(sizes[~small]) - np.median(sizes[small]))
    for first, second, factor in _LENGTHS:
        if abs(ratio - log(factor)) > _ALIKE:
            continue
        for scale in (np.where(small, factor, 1.0), np.where(small, 1.0, 1.0 / factor)):
            changed = replace(some, positions_m=some.positions_m * scale[:, None])
            yield "positions", first, second, small, changed


def _joints(
    model: RobotModel, some: PointObservations
) -> Iterator[tuple[str, str, str, NDArray[np.bool_], PointObservations]]:
    turns = ~model.sliding if model.sliding is not None else np.ones(model.axis_count, dtype=bool)
    sizes = np.abs(some.joints_rad[:, turns]).max(axis=1)
    for limit, factors in (
        (_FULL_TURN_RAD / degrees(1.0), (degrees(1.0), 1.0)),
        (_FULL_TURN_RAD, (1.0, 1.0 / degrees(1.0))),
    ):
        small = sizes < limit
        if min(small.sum(), (~small).sum()) < _FEWEST_ROWS:
            continue
        scale = np.where(small, *factors)[:, None]
        joints = np.where(turns, some.joints_rad * scale, some.joints_rad)
        yield "joints", "rad", "deg", small, replace(some, joints_rad=joints)
