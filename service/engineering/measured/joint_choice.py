"""Which of several sets of joint columns goes with what was read, where no heading says which the arm had."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_fit import fit_quickly
from cellcal.calibration.identification.misfit_units import unit_of_points
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.quick_fit import spread_rows
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.columns import units_of_joints
from cellcal.service.engineering.measured.headings import plain_name
from cellcal.service.engineering.measured.joint_columns import like_joint_columns
from cellcal.service.engineering.measured.joint_coupling import controller_joints
from cellcal.service.engineering.measured.joint_units import joint_units
from cellcal.service.engineering.measured.table import MeasurementTable
from cellcal.service.engineering.measured.unit_choice import UnitChoice
from cellcal.service.engineering.measured.units import LENGTH_UNITS, USUAL_LENGTH_UNITS

_FEWEST_ROWS = 10
_MOST_ROWS = 100  # are enough to see
_CLEAR = 0.7  # of the other's error: above, the rows do not tell
_SIGMA_M = 1e-4
_SAME_RAD = 1e-5  # between sets that are one, written twice


def joint_sets(
    table: MeasurementTable,
    first_names: tuple[str, ...],
    good: NDArray[np.bool_],
    arm: tuple[RobotModel, Array],
    coupling: str,
) -> dict[tuple[str, ...], Array]:
    """Return the joints [rad] of usable rows, and of further columns that headings rank as they do these."""
    model, joints_rad = arm
    sets = {first_names: joints_rad}
    for names in like_joint_columns(
        table.names, {name: plain_name(name) for name in table.names}, first_names
    ):
        raw = np.column_stack([table.numbers[good, table.names.index(name)] for name in names])
        if np.isfinite(raw).all():
            units = UnitChoice(units_of_joints(names), [])
            sets[names] = controller_joints(raw * joint_units(units, names, raw, model), model, coupling)
    return sets


def better_joints(
    model: RobotModel, sets: Mapping[tuple[str, ...], Array], positions: Array
) -> tuple[dict[str, tuple[str, ...]], str]:
    """Return the joints that fit the measured places clearly better than the first set, and what is to be said.

    Parameters
    ----------
    sets : of (N, n)
        Joint angles [rad] by their columns; the first set is what headings told.
    positions : (N, 3)
        What the device read, as written.
    """
    (first_names, first), *others = sets.items()
    differing = [(names, values) for names, values in others if np.abs(values - first).max() > _SAME_RAD]
    if not differing or len(first) < _FEWEST_ROWS:
        return {}, ""
    rows = spread_rows(len(first), _MOST_ROWS)
    unit = unit_of_points(model, first, positions, USUAL_LENGTH_UNITS)
    names = [first_names, *(each for each, _ in differing)]
    if unit:
        metres, once = positions[rows] * LENGTH_UNITS[unit], np.zeros(len(rows), dtype=np.intp)
        scores = np.array(
            [
                fit_quickly(
                    model, PointObservations(values[rows], metres, np.full(len(rows), _SIGMA_M), once)
                ).score_m
                for values in (first, *(values for _, values in differing))
            ]
        )
        best = int(np.argmin(scores))
        if best and scores[best] < _CLEAR * scores[0]:
            return {"joints": names[best]}, ""
        if scores[0] < _CLEAR * np.delete(scores, 0).min():
            return {}, ""
    return {}, make_message(
        "joints stand twice ({first_names}; {other}) and nothing tells which the robot had: name those that it had, "
        "not those that it was told (`--columns joints=…`)",
        first_names=", ".join(first_names),
        other=", ".join(names[1]),
    )
