"""One coordinate of measured positions whose numbers are larger or smaller than those of the other two.

A factor of all positions hides in link lengths (`position_scale`); a factor of one coordinate alone does so only in
part, for no arm is longer along an axis of the device. It is fitted beside all other unknowns.
"""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.misfit_error import MisfitCause, misfit_error
from cellcal.calibration.identification.misfit_fit import motion_of
from cellcal.calibration.identification.observations import LengthObservations, Observations
from cellcal.calibration.identification.target_change import (
    DEVIATIONS,
    TIMES_BETTER,
    SeriesColumns,
    orthonormal_columns,
)
from cellcal.calibration.message import make_message

_AXES = 3
_SMALLEST = 5e-4  # a tracker's axes differ by a hundredth of that
_CURE = (
    "See from where this column is, and whether its unit was converted by a rounded factor or by another one than "
    "the others; then put the device's own numbers into the file."
)


@dataclass(frozen=True, slots=True)
class AxisScale:
    """By which factor one coordinate is too large, and what the rows leave without and with it."""

    axis: int
    factor: float
    before_m: float
    remaining_m: float


def find_axis_scale(found: SeriesColumns | None, observations: Observations) -> AxisScale | None:
    """Return the coordinate that alone is of another size, if the rows fit far better with it.

    ``found`` is what `series_columns` tells of the observations.
    """
    if found is None or isinstance(observations, LengthObservations):
        return None
    count = found.left.shape[1]
    base = orthonormal_columns(found.columns.transpose(2, 1, 0).reshape(_AXES * count, -1))
    values = found.left.T.reshape(-1)
    rest = values - base @ (base.T @ values)
    before, freedom = float(rest @ rest), max(len(rest) - base.shape[1], 2)
    places = observations.positions_m[found.rows] - found.left.T * found.sigma_m[:, None]  # as predicted
    places = (places - places.mean(axis=0)) / found.sigma_m[:, None]
    fits = []
    for axis in range(_AXES):
        own = (places * (np.arange(_AXES) == axis)).reshape(-1)
        own = own - base @ (base.T @ own)
        sight = max(float(own @ own), 1e-30)
        size = float(own @ rest) / sight
        fits.append((before - size**2 * sight, size, sight, axis))
    after, size, sight, axis = min(fits)
    scatter = max(after, 1e-30) / (freedom - 1)
    if before < TIMES_BETTER**2 * after or abs(size) < max(DEVIATIONS * (scatter / sight) ** 0.5, _SMALLEST):
        return None
    metres = float(np.median(found.sigma_m) * np.sqrt(_AXES))
    return AxisScale(
        axis, 1.0 + size, metres * float(np.sqrt(before / freedom)), metres * float(np.sqrt(scatter))
    )


def refuse_axis_scale(
    model: RobotModel, observations: Observations, scale: AxisScale | None, names: tuple[str, ...]
) -> None:
    """Refuse positions of which one coordinate alone is of another size; the names are those of the columns.

    Raises
    ------
    MisfitError
        With the coordinate and its factor.
    """
    if scale is None:
        return
    says = make_message(
        "{column} is {factor:.4g} times as large as it should be beside the other two",
        column=names[scale.axis],
        factor=scale.factor,
    )
    cause = MisfitCause(("scale",), says, _CURE, scale.remaining_m)
    raise misfit_error(model, scale.before_m, motion_of(model, observations), (cause,))
