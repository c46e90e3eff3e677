"""Units of joint columns: angles of joints that turn, lengths of joints that slide."""

from collections.abc import Sequence

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.service.engineering.measured.table import MeasurementError
from cellcal.service.engineering.measured.unit_choice import UnitChoice

_BEYOND = 1.05  # times the travel: what a joint may overrun


def joint_units(units: UnitChoice, columns: Sequence[str], values: Array, model: RobotModel) -> Array:
    """Return rad, or m of joints that slide, per unit of each joint column (n,).

    Raises
    ------
    MeasurementError
        A unit was stated that is none.
    """
    found = np.ones(len(columns))
    slides = model.sliding
    if slides is None:
        found[:] = units.angle_factors(columns, values)
        return found
    if not slides.all():
        turning = [name for name, slide in zip(columns, slides, strict=True) if not slide]
        found[~slides] = units.angle_factors(turning, values[:, ~slides])
    sliding = [name for name, slide in zip(columns, slides, strict=True) if slide]
    travel = np.maximum(np.abs(model.lower_rad), np.abs(model.upper_rad))[slides]
    in_metres = bool((np.abs(values[:, slides]) <= _BEYOND * travel).all())
    found[slides] = units.slide("slides", sliding, "m" if in_metres else "mm")
    return found


def refuse_typed_zeros(zeros: Array, model: RobotModel) -> None:
    """Refuse a zero in degrees that was typed with the column of a joint that slides.

    Raises
    ------
    MeasurementError
        There is one.
    """
    if model.sliding is not None and zeros[model.sliding].any():
        raise MeasurementError(
            "a zero in degrees was typed for a joint that slides.",
            remedy="Leave it out: the fit finds the zero.",
        )
