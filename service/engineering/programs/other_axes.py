"""Axes beside the arm's own: extended axes, other motion groups, positions with another number of joints.

Such an axis may carry the arm, and no program says so. Points where it stands at zero are left together with the
others of their program: half of a program that goes along is worse than none.
"""

from collections.abc import Set

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import Positions, ProgramFile
from cellcal.service.engineering.programs.controller_joints import unused_columns

EXTERNAL = "carries external axes, and the project does not know what they move"
BESIDE_EXTERNAL = "its program carries external axes elsewhere, and the project does not know what they move"
OTHER_JOINTS = "holds another number of joints than the robot's {}"


def of_another_arm(program: ProgramFile, axes: int) -> NDArray[np.bool_]:
    """Return (N,) which positions of the robot's group hold another number of joints than the robot has.

    Raises
    ------
    ProgramFileError
        All that hold joints do.
    """
    has_value = np.isfinite(unused_columns(program.brand, program.positions.joints, axes))
    robots = has_value.any(axis=1) & (program.positions.groups == 1)
    other: NDArray[np.bool_] = robots & (
        has_value[:, axes:].any(axis=1) | ~has_value[:, :axes].all(axis=1) | (has_value.shape[1] < axes)
    )
    if other.any() and (other == robots).all():
        raise ProgramFileError(
            program.name,
            make_message("its positions hold another number of joints than the robot's {axes}.", axes=axes),
            remedy="Name the project of the robot that this program is for. An axis that carries the arm is no joint "
            "of its model: state it as [[track]], and let the model begin at the arm's own base.",
        )
    return other


def find_moved_other_axes(
    positions: Positions, axes: int, unstated: NDArray[np.bool_], stated_groups: Set[int]
) -> NDArray[np.bool_]:
    """Return (N,) all points of a program in which an axis beside the arm leaves zero; none of any other program.

    Axes that the project states do not count: neither rows that are not ``unstated`` nor groups among the stated.
    """
    has_value = np.isfinite(positions.joints)
    other = (positions.groups != 1) & has_value.any(axis=1) & ~has_value[:, axes - 1 : axes].any(axis=1)
    other &= ~np.isin(positions.groups, list(stated_groups))
    carries = bool((np.abs(np.nan_to_num(positions.joints[other])) > 0).any())
    carries |= bool(unstated[positions.groups == 1].any())
    return np.full(len(positions), carries)
