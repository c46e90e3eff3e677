"""Which of several places of a row the device read, where no heading says so, and which the controller calculated."""

from collections.abc import Mapping, Sequence

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_units import unit_of_points
from cellcal.calibration.identification.quick_fit import spread_rows
from cellcal.calibration.identification.unrounding import find_resolution, follow_nominal_arm
from cellcal.calibration.message import make_message
from cellcal.service.engineering.measured.columns import TableLayout
from cellcal.service.engineering.measured.units import LENGTH_UNITS, USUAL_LENGTH_UNITS

_FEWEST_ROWS = 8
_MOST_ROWS = 200  # are enough to see
_MOST_PLACES = 6  # of a row that are looked at: what a controller prints is one of the first
_SHOWN = 4
_EQUAL = 1e-6


def better_places(
    model: RobotModel,
    joints_rad: Array,
    joint_step_rad: Array,
    layout: TableLayout,
    values: Mapping[str, Array],
) -> dict[str, tuple[str, ...]]:
    """Return which columns are the measured and the controller's places, where they are others than headings told.

    What the nominal arm calculates from the joints to the last digit is the controller's: no device reads that. A
    length that is the distance of x, y, z from the origin is a tracker's range to what it measured there.

    Parameters
    ----------
    joints_rad : (N, n)
        Of the usable rows.
    joint_step_rad : (n,)
        To which they are rounded.
    values : of (N,)
        The usable rows of the columns of places, as written.
    """
    if layout.length and layout.controller and _is_range(values[layout.length], layout.controller, values):
        return {"position": layout.controller}
    unknown = [*(() if layout.is_named else (layout.position,)), *layout.further[:_MOST_PLACES]]
    if not layout.further or not layout.position or len(joints_rad) < _FEWEST_ROWS:
        return {}
    rows = spread_rows(len(joints_rad), _MOST_ROWS)
    calculated = [
        names
        for names in unknown
        if is_calculated(
            model, joints_rad[rows], joint_step_rad, np.column_stack([values[n][rows] for n in names])
        )
    ]
    read = [names for names in (layout.position, *layout.further) if names not in calculated]
    if not calculated or not read:
        return {}
    position = layout.position if layout.position in read else read[0]
    controller = layout.controller or calculated[0]
    if (position, controller) == (layout.position, layout.controller):
        return {}
    return {"position": position, "controller": controller}


def calculated_places(
    model: RobotModel, raw_joints: Array, joint_unit: Array, places: Sequence[Array]
) -> list[bool]:
    """Return of each series of places (N, 3), as written, whether the nominal arm calculates it from the joints.

    ``raw_joints`` (N, n) are as written, ``joint_unit`` (n,) is rad or m per unit of them.
    """
    rows = spread_rows(len(raw_joints), _MOST_ROWS)
    step_rad = np.array([find_resolution(column) for column in raw_joints.T]) * joint_unit
    return [is_calculated(model, raw_joints[rows] * joint_unit, step_rad, each[rows]) for each in places]


def _is_range(lengths: Array, place: Sequence[str], values: Mapping[str, Array]) -> bool:
    positions = np.column_stack([values[name] for name in place])
    if len(lengths) < _FEWEST_ROWS or not (np.isfinite(positions).all() and np.isfinite(lengths).all()):
        return False
    step = max(find_resolution(column) for column in (*positions.T, lengths))
    distances = np.linalg.norm(positions, axis=1)
    return bool((np.abs(distances - lengths) <= 2 * step + _EQUAL * distances).all())


def is_calculated(model: RobotModel, joints_rad: Array, joint_step_rad: Array, values: Array) -> bool:
    """Return whether the nominal arm calculates places (N, 3), as written, from the joints."""
    if len(joints_rad) < _FEWEST_ROWS:
        return False
    unit = unit_of_points(model, joints_rad, values, USUAL_LENGTH_UNITS) if np.isfinite(values).all() else ""
    if not unit:
        return False
    step = max(find_resolution(column) for column in values.T)
    metres = LENGTH_UNITS[unit]
    try:
        return follow_nominal_arm(model, joints_rad, joint_step_rad, values * metres, step * metres)
    except CalibrationError:
        return False


def further_places_note(places: Sequence[Sequence[str]]) -> str:
    """Say which columns hold places that take no part; empty without any."""
    if not places:
        return ""
    shown = "; ".join(", ".join(names) for names in places[:_SHOWN])
    return make_message(
        "places in each row that take no part: {columns}; if they are other targets, a layout fits all together "
        "(`--layout`)",
        columns=shown if len(places) <= _SHOWN else f"{shown}; …",
    )
