"""Joints in words, each axis by the name that the robot's pendant gives it."""

import math

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.interfaces import Joints
from cellcal.procedures.cell import Cell


def axis_name(cell: Cell, axis: int) -> str:
    """Return what the pendant calls an axis, counted from zero."""
    return cell.robot.capabilities.axis_name(axis)


def joints_text(cell: Cell, joints_rad: Joints | Array, digits: int) -> str:
    """Return joints [rad] in degrees, such as ``J1 10.0, J2 -5.0 deg``."""
    values = [
        make_message("{axis} {angle}", axis=axis_name(cell, axis), angle=f"{math.degrees(q):.{digits}f}")
        for axis, q in enumerate(joints_rad)
    ]
    return make_message("{first}, {others} deg", first=values[0], others=join_messages(", ", values[1:]))
