"""Joints that stay at their taught values: an arm of seven joints reaches a pose in a line of postures."""

from collections.abc import Sequence

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.message import make_message
from cellcal.service.engineering.programs.project_poses import ProjectError

_POSE = 6
_ELBOW = 2  # joint 3 of an arm of seven that turn: it swings the elbow about the line from shoulder to wrist


def read_held_joints(written: Sequence[int] | None, model: RobotModel, where: str) -> tuple[int, ...]:
    """Return the joints (from 0) that stay; without a statement the slide, or joint 3, of an arm of seven.

    Raises
    ------
    ProjectError
        Joints that the arm has not, or too few or too many of them.
    """
    count = model.axis_count
    if written is None:
        if count <= _POSE:
            return ()
        slides = np.zeros(count, dtype=bool) if model.sliding is None else model.sliding
        found = tuple(np.flatnonzero(slides).tolist()) or (_ELBOW,)
    else:
        found = tuple(sorted({joint - 1 for joint in written}))
        _refuse_unknown(written, model, where)
    free = count - len(found)
    if free > _POSE or (count > _POSE and free < _POSE):
        raise ProjectError(
            make_message(
                "{where}: {shown_name} has {count} joints, and {free} of them are free to move.",
                where=where,
                shown_name=model.label,
                count=count,
                free=free,
            ),
            remedy="Name the joints that stay at their taught values, as many as leave six: held_joints = [1, 4].",
        )
    return found


def _refuse_unknown(written: Sequence[int], model: RobotModel, where: str) -> None:
    count = model.axis_count
    if (
        len(set(written)) < len(written)
        or not set(written) <= set(range(1, count + 1))
        or (count <= _POSE and written)
    ):
        raise ProjectError(
            make_message(
                "{where}: held_joints names {names}, and {shown_name} has {count} joints.",
                where=where,
                names=", ".join(str(joint) for joint in written),
                shown_name=model.label,
                count=count,
            ),
            remedy="Name each joint that stays once, from 1; an arm of at most six joints needs all of them.",
        )
