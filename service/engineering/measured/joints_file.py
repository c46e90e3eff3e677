"""Joints that stand in another file than the readings."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.service.engineering.measured.joined_sheets import joined_files
from cellcal.service.engineering.measured.table import MeasurementTable, read_table
from cellcal.service.engineering.measured.unnamed_columns import tell_nothing


def with_joints_of(path: Path, readings: MeasurementTable, model: RobotModel) -> MeasurementTable:
    """Return readings with the joints of another file; its columns without headings are the joints.

    One number a row without a heading is a length.

    Raises
    ------
    MeasurementError
        The file of joints cannot be read, or nothing tells which rows belong together.
    """
    joints = read_table(path)
    if tell_nothing(readings.names) and len(readings.names) == 1:
        readings = replace(readings, names=("length",))
    silent = tell_nothing(joints.names)
    numbers = tuple(f"joint {at + 1}" for at in range(model.axis_count))
    if silent and len(joints.names) == model.axis_count:
        joints = replace(joints, names=numbers)
    elif silent and len(joints.names) == model.axis_count + 1 and _counts_rows(joints):
        joints = replace(joints, names=("point number", *numbers))
    elif silent and tell_nothing(readings.names):
        names = tuple(f"column {len(readings.names) + at + 1}" for at in range(len(joints.names)))
        joints = replace(joints, names=names)
    return joined_files(readings, joints)


def _counts_rows(table: MeasurementTable) -> bool:
    """Return whether the first column numbers the rows one by one."""
    return len(table) > 1 and bool((np.diff(table.numbers[:, 0]) == 1.0).all())
