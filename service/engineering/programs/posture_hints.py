"""Joints that only choose the posture in which a pose is reached: ``qnear`` of URScript's ``get_inverse_kin``.

Where they are those of the pose they are taught joints. Where they are near it, the controller takes the solution
nearest to them, and so does this; which one it takes far from them is not documented.
"""

import numpy as np

from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.geometry import Array
from cellcal.calibration.programs.transfer import same_place, tip_poses
from cellcal.service.engineering.programs.other_postures import OtherPostureSearch
from cellcal.service.engineering.programs.postures import PostureSearch
from cellcal.service.engineering.programs.program_points import ProgramPoints, Rows

CONTRADICTS_M = 5e-4  # between the joints and the pose of one position
HINT_STAYS = (
    "its joints only choose the posture of places that move (qnear), and may choose another one there: move joint "
    "points, too (--joints move), or look at the posture at the robot"
)
_HINT_IS_FAR = (
    "no joints within 45 deg of those that choose its posture (qnear) reach it, so it is not known which posture the "
    "controller takes: state joints near the place, or teach it"
)
_NEAR_RAD, _NEAR_LAST_RAD = np.pi / 4, 0.9 * np.pi  # the last joint alone chooses no posture but its turn


def joints_by_hints(
    points: ProgramPoints,
    rows: Rows,
    stated: tuple[Array, Array],
    arm: TipArm,
    search: PostureSearch | OtherPostureSearch,
) -> Array:
    """Return joints (K, n) that reach poses: those stated, or the nearest to them where they only choose the posture.

    ``stated`` are joints (K, n) and poses (K, 4, 4) of the flange in the base. A point is left where no joints near
    those stated reach it.
    """
    joints, base_flange = stated
    hinted = np.flatnonzero(points.hinted[rows])
    if not len(hinted):
        return joints
    apart, _ = same_place(tip_poses(arm, joints[hinted]), base_flange[hinted])
    chosen = hinted[apart > CONTRADICTS_M]
    if not len(chosen):
        return joints
    texts = [points.texts[i] for i in rows[chosen].tolist()]
    found, _ = search.find_joints(base_flange[chosen], texts, joints[chosen])
    most = np.append(np.full(joints.shape[1] - 1, _NEAR_RAD), _NEAR_LAST_RAD)
    near = (np.abs(found - joints[chosen]) < most).all(axis=1)
    points.refuse_points(rows[chosen[~near]], _HINT_IS_FAR)
    points.unusable[rows[chosen[~near]]] = True
    new = joints.copy()
    new[chosen[near]] = found[near]
    points.joints[rows[chosen[near]]] = found[near]
    return new
