"""Which poses of a record are still needed before lost turns are known surely enough."""

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.integer_search import success_probability
from cellcal.calibration.mastering.pose_design import next_poses, turn_covariances
from cellcal.calibration.mastering.turn_gate import SUCCESS_PROBABILITY
from cellcal.calibration.wires.reference import WirePredictor

_MOST_FURTHER = 12


def further_lengths(
    model: RobotModel, record: MasteringRecord, measured: Array, at_least: int
) -> tuple[tuple[float, ...], ...]:
    """Return the poses of the record that are still needed, best first; at least one."""
    kit = record.capture_joints_rad()
    order = next_poses(model, record, measured, kit, _MOST_FURTHER)
    joints = np.vstack([measured, kit[list(order)]])
    covariance_of = turn_covariances(record, WirePredictor(model, *record.wire_lengths()), joints)
    needed, count = max(1, at_least), len(measured)
    while needed < len(order) and success_probability(covariance_of(count + needed)) <= SUCCESS_PROBABILITY:
        needed += 1
    return tuple(tuple(float(v) for v in row) for row in kit[list(order[:needed])])
