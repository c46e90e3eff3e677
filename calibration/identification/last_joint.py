"""Whether the rows show which way the last joint turns: a target on its axis does not move when it turns."""

from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.misfit_fit import fit_quickly
from cellcal.calibration.identification.observations import Observations, PointObservations, PoseObservations
from cellcal.calibration.identification.quick_fit import spread_rows
from cellcal.calibration.message import make_message

DIRECTION = "direction"
_MOST_ROWS = 80
_FEWEST = 12
_FEW_JOINTS = 2  # of a turntable or a positioner
_ALIKE = 3.0  # times better must one direction fit before these rows tell it
_FLOOR_M = 2e-5  # two fits as good as this are alike
_MOST_LEFT_M = 5e-3  # errors of the arm beyond hide the turn of any target, on the axis or not
_TURNED_RAD = float(np.deg2rad(10.0))  # a joint that hardly turned has no direction to be seen


def last_joint_note(model: RobotModel, observations: Observations) -> list[Lint]:
    """Return a note where the last joint fits alike in both directions, so that its direction cannot be seen.

    Attitudes show it wherever the target sits.
    """
    if (
        not isinstance(observations, PointObservations)
        or isinstance(observations, PoseObservations)
        or len(observations) < _FEWEST
    ):
        return []
    some = observations.select_rows(spread_rows(len(observations), _MOST_ROWS))
    name = model.joint_names[-1]
    if float(np.std(some.joints_rad[:, -1])) < _TURNED_RAD:
        return []
    turned = some.joints_rad.copy()
    turned[:, -1] *= -1.0
    as_read = fit_quickly(model, some).score_m
    other = fit_quickly(model, replace(some, joints_rad=turned)).score_m
    if as_read > _MOST_LEFT_M or other > _ALIKE * as_read + _FLOOR_M:
        return []
    return [
        Lint(
            DIRECTION,
            make_message(
                "the direction of {name} cannot be seen from these data: {why} ({as_read:.3f} mm remain as it was "
                "read, {other:.3f} mm with {name} turned round). What follows {name} in the residuals may be this "
                "alone. {cure}",
                name=name,
                why=_why_unseen(model),
                as_read=as_read * 1e3,
                other=other * 1e3,
                cure=_cure_unseen(model),
            ),
        )
    ]


def _cure_unseen(model: RobotModel) -> str:
    if model.axis_count <= _FEW_JOINTS:
        return "Check its sign at the robot, or measure attitudes."
    return "Check its sign at the robot, or measure with the target off the axis."


def _why_unseen(model: RobotModel) -> str:
    if model.axis_count <= _FEW_JOINTS:
        return "with so few joints another place of device and target undoes it, or the target is on its axis"
    return "the target is on its axis, or nearly"
