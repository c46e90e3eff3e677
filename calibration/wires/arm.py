"""What may be wrong with an arm that pulls a draw-wire, beside its sag: geometry, and its tooth flanks."""

import numpy as np

from cellcal.calibration.arm.joint_terms import JointTerm, gravity_terms, term_values
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array

_PARALLEL = 1e-3  # sine of the twist below which consecutive axes count as parallel
_FLANK_LEVER_M = 0.02  # of a joint's load: well above, gravity holds it on one tooth flank


def free_geometry(model: RobotModel) -> np.ndarray:
    """Return which geometry errors are sought, flat: those that do more than move base or flange as a whole."""
    if model.dh is None:
        free = np.ones((model.axis_count + 1, 6), dtype=bool)
        free[[0, -1]] = False
        return free.ravel()
    free = np.ones((model.axis_count, 5), dtype=bool)
    free[:, 4] = np.abs(np.sin(model.dh.alpha_rad)) < _PARALLEL
    free[0, :2] = False
    free[-1, :] = False
    return free.ravel()


def flank_values(model: RobotModel, joints_rad: Array) -> tuple[list[int], Array]:
    """Return joints that carry links, and on which flank of their teeth gravity holds them at every posture.

    A joint that comes to rest from below lies on the flank of that side, unless weight pulls it to the other one.

    Parameters
    ----------
    model : RobotModel
        Nominal model.
    joints_rad : (N, n)
        Postures [rad].

    Returns
    -------
    list of J joints, (J, N) in -1 ... 1
        ``tanh`` of the load's lever. The weights are not known: every link counts alike.
    """
    last = model.axis_count - 1
    terms = (*gravity_terms(model), JointTerm("gravity", last - 1, last))  # the wrist bends under the tool
    values = term_values(model, joints_rad, terms)
    loaded = sorted({term.joint for term in terms})
    levers = [values[[term.joint == joint for term in terms]].sum(axis=0) for joint in loaded]
    return loaded, np.tanh(np.array(levers) / _FLANK_LEVER_M)
