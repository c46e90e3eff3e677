"""Joints in words, each axis by the name that the robot's pendant gives it."""

import math
from collections.abc import Sequence

from cellcal.calibration.geometry import Array
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.cell import Cell


def axis_name(cell: Cell, axis: int) -> str:
    """Return what the pendant calls an axis, counted from zero."""
    return cell.robot.capabilities.axis_name(axis)


def joints_text(cell: Cell, joints_rad: Joints | Array, digits: int) -> str:
    """Return joints [rad] in degrees, such as ``J1 10.0, J2 -5.0 deg``."""
    return axis_values_text(cell, [f"{math.degrees(q):.{digits}f}" for q in joints_rad]) + " deg"


def axis_values_text(cell: Cell, values: Sequence[object]) -> str:
    """Return one value for each axis, each behind the axis's name."""
    return ", ".join(f"{axis_name(cell, axis)} {value}" for axis, value in enumerate(values))
