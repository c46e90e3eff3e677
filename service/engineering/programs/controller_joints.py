"""Joints as programs of a maker write them, and as the robot's model counts them.

Yaskawa writes the elbow axis E of an arm of seven joints behind the others (S L U R B T E); the chain, and with it
every description, has it third. This order is what Yaskawa's own driver for ROS converts (motoros2).
ABB and KUKA write six numbers for every arm, those of joints that it has not as zero, and no unit.
"""

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.drivers.programs.positions import JOINTS, Positions

_YASKAWA_ORDER = (0, 1, 6, 2, 3, 4, 5)  # column of a job by joint of the chain
_WITHOUT_UNIT = frozenset(("abb", "kuka"))
NO_UNIT = "the file gives joints without a unit, and a joint of this robot slides: its number may mean either"


def chain_order(brand: str, axes: int) -> tuple[int, ...] | None:
    """Return the column of a program for each joint of the chain; None where both count alike."""
    return _YASKAWA_ORDER if brand == "yaskawa" and axes == len(_YASKAWA_ORDER) else None


def as_chain(brand: str, joints: Array) -> Array:
    """Return joints (N, n) of a program in the order of the chain."""
    order = chain_order(brand, joints.shape[1])
    return joints if order is None else joints[:, list(order)]


def as_written(brand: str, joints: Array) -> Array:
    """Return joints (N, n) of the chain in the order of a program."""
    order = chain_order(brand, joints.shape[1])
    return joints if order is None else joints[:, np.argsort(order)]


def unused_columns(brand: str, joints: Array, axes: int) -> Array:
    """Return joints (N, m) without numbers that stand for joints which the arm has not."""
    if brand not in _WITHOUT_UNIT or joints.shape[1] <= axes:
        return joints
    used = joints.copy()
    beyond = used[:, axes:]
    beyond[beyond == 0.0] = np.nan
    return used


def lacks_units(brand: str, positions: Positions, model: RobotModel) -> NDArray[np.bool_]:
    """Return (N,) which positions are joints of an arm with a slide, without the unit of their numbers."""
    if brand not in _WITHOUT_UNIT or model.sliding is None:
        return np.zeros(len(positions), dtype=bool)
    return np.array([kind == JOINTS for kind in positions.kinds], dtype=bool)
