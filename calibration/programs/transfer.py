"""Points of one cell brought to another, or to the same one corrected: Eq. 9 to 12 with the robots' real models.

A controller turns a programmed point into joints with the arm it believes in; its robot then stands where the real
arm stands at these joints. A point is right in another cell when that cell's *real* tip is in the same place at the
fixture, so the joints are found with the real arm, and written back as the coordinates that the other *controller*
turns into just these joints.
"""

from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.compensation.compensate import Compensation, CompensationLimits, reach_poses
from cellcal.calibration.compensation.pose_gap import Flags, TipArm
from cellcal.calibration.geometry import Array, inverse_transform

EXACTLY = CompensationLimits()
_ANY_TURN_RAD = (
    1e3  # limits are judged afterwards, so that a person reads by how much a joint would pass them
)


@dataclass(frozen=True, eq=False)
class TransferFrames:
    """From where to where: all frames of points that share their tools.

    For a clone ``source`` is the master's real arm, ``target`` the clone's, and ``written`` the clone's controller;
    their tips are the real, the real and the entered tool. For an upload ``source`` is the controller, ``target`` the
    real arm; for a download the other way round.
    """

    source: TipArm
    change: Array  # (4, 4): the source's base seen from the target's; E of Eq. 9
    target: TipArm
    written: TipArm


@dataclass(frozen=True, eq=False)
class TransferResult:
    """The new places of points, the pose first."""

    joints_rad: Array  # (N, n) of the other controller
    base_tip: Array  # (N, 4, 4) that the other controller computes there, with its tool as entered
    target_tip: Array  # (N, 4, 4) real tip in the other base
    reached: Flags  # (N,)
    left_m: Array  # (N,) distance that the nearest posture leaves
    left_rad: Array  # (N,) turn that it leaves; of an arm of fewer than six joints also where it is reached


def transfer_points(
    way: TransferFrames,
    joints_rad: Array,
    *,
    start_rad: Array | None = None,
    limits: CompensationLimits = EXACTLY,
    careful: bool = True,
) -> TransferResult:
    """Find the joints with which the target's real tip is where the source's is.

    Parameters
    ----------
    way : Way
        Arms and the change of base.
    joints_rad : (N, n)
        Of the source's controller [rad], finite.
    start_rad : (N, n), optional
        Where the search begins; the source's joints, which suit cells that are nearly alike.
    limits : CompensationLimits
        Tolerances [m, rad]; no joint goes farther than ``branch_rad`` from its start. Joint limits are not heeded.
    careful : bool
        Whether the few points that do not arrive at once are searched for.

    Raises
    ------
    CalibrationError
        Joints that are not finite, or arms of different numbers of joints.

    References
    ----------
    F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot Positioning Accuracy, 2008, Eq. 9 to 12.
    """
    target_tips = way.change @ tip_poses(way.source, joints_rad)
    start = joints_rad if start_rad is None else start_rad
    found = reach_poses(_without_limits(way.target), target_tips, start, limits=limits, careful=careful)
    return TransferResult(
        found.joints_rad,
        tip_poses(way.written, found.joints_rad),
        target_tips,
        found.has_converged,
        found.position_error_m,
        found.angle_error_rad,
    )


def tip_poses(arm: TipArm, joints_rad: Array) -> Array:
    """Return the tip (N, 4, 4) of an arm at joints (N, n), sag and ripple included."""
    rotations, origins = arm.compute_frames(joints_rad.T)
    poses = np.zeros((len(joints_rad), 4, 4))
    poses[:, :3, :3] = rotations[-1].transpose(2, 0, 1)
    poses[:, :3, 3] = origins[-1].T
    poses[:, 3, 3] = 1.0
    return poses


def joints_near(arm: TipArm, base_tip: Array, start_rad: Array, limits: CompensationLimits) -> Compensation:
    """Return joints for poses (N, 4, 4) near given ones, whatever the joint limits."""
    return reach_poses(_without_limits(arm), base_tip, start_rad, limits=limits)


def same_place(base_tip: Array, other: Array) -> tuple[Array, Array]:
    """Return how far apart poses are: distances (N,) [m] and angles (N,) [rad]."""
    apart = (inverse_transform(base_tip) @ other) if len(base_tip) else np.zeros((0, 4, 4))
    sine = np.linalg.norm(
        np.stack(
            [
                apart[:, 2, 1] - apart[:, 1, 2],
                apart[:, 0, 2] - apart[:, 2, 0],
                apart[:, 1, 0] - apart[:, 0, 1],
            ]
        ),
        axis=0,
    )
    cosine = np.trace(apart[:, :3, :3], axis1=1, axis2=2) - 1.0
    return np.linalg.norm(apart[:, :3, 3], axis=1), np.arctan2(sine, cosine)


def nearest_turns(joints_rad: Array, to_rad: Array) -> Array:
    """Return joints turned by whole turns, so that each is within half a turn of another posture's."""
    near: Array = joints_rad - 2 * np.pi * np.round((joints_rad - to_rad) / (2 * np.pi))
    return near


def smallest_sigma(
    model: RobotModel, joints_rad: Array, enough: float = np.inf, held: tuple[int, ...] = ()
) -> Array:
    """Return (N,) the smallest singular value of the flange's Jacobian [m/rad], zero in a singularity.

    Where it is surely above ``enough``, a bound below it is returned: the volume over the largest that the other
    five could be, ``|det J| / (|J|^2 / 5)^(5/2)``. Of an arm of fewer joints, or with some held, it is the least
    motion of the joints that move.
    """
    _, jacobian = model.flange_jacobian(joints_rad)
    if jacobian.shape[2] != 6 or held:
        free = [joint for joint in range(model.axis_count) if joint not in held]
        return np.asarray(np.linalg.svd(jacobian[:, :, free], compute_uv=False)[:, -1], dtype=np.float64)
    whole = np.einsum("nij,nij->n", jacobian, jacobian)
    found = np.abs(np.linalg.det(jacobian)) / (whole / 5.0) ** 2.5
    near = np.flatnonzero(found <= enough)
    found[near] = np.linalg.svd(jacobian[near], compute_uv=False)[:, -1]
    return np.asarray(found, dtype=np.float64)


def _without_limits(arm: TipArm) -> TipArm:
    wide = np.full(arm.model.axis_count, _ANY_TURN_RAD)
    return replace(arm, model=replace(arm.model, lower_rad=-wide, upper_rad=wide))
