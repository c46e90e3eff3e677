"""Joints that were read a little earlier or later than the device read, while the arm moved."""

from collections.abc import Iterator

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_hypotheses import JointInterpretation
from cellcal.calibration.identification.observations import Observations, PointObservations, Rows
from cellcal.calibration.identification.quick_fit import refine_number, trimmed_joint_scores
from cellcal.calibration.message import make_message

_STEPS = (0.1, 0.01)  # of the time between two rows
_LONGEST = 1.0
_LEAST = 0.03


def lag_readings(model: RobotModel, observations: Observations, rows: Rows) -> Iterator[JointInterpretation]:
    """Return rows of a series with their joints at the part of a row before or behind that fits best, if any does."""
    inner = rows[(rows > 0) & (rows < len(observations) - 1)]
    if not isinstance(observations, PointObservations) or len(inner) < len(rows) - 2:
        return
    joints = observations.joints_rad
    change = np.gradient(joints, axis=0)

    def scores_of(parts: Array) -> Array:
        moved = joints[inner] + parts[:, None, None] * change[inner]
        return trimmed_joint_scores(model, moved, observations.positions_m[inner])

    part = refine_number(scores_of, _LONGEST, _STEPS)
    if abs(part) >= _LEAST:
        yield JointInterpretation("lag", 1, (joints + part * change)[rows], *_texts(part))


def _texts(part: float) -> tuple[str, str]:
    says = (
        make_message(
            "the joints were read {part:.2f} of the time between two rows earlier than the positions",
            part=part,
        )
        if part > 0
        else make_message(
            "the joints were read {part:.2f} of the time between two rows later than the positions",
            part=-part,
        )
    )
    return says, (
        "Let the arm stand still at each reading, or bring joints and positions to the same times (clocks, filters "
        "and delays of both)."
    )
