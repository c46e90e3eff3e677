"""Where a device and its target are, roughly, before any fit: starts that cannot lead astray."""

import numpy as np

from calibration.errors import CalibrationError, DegenerateDataError
from calibration.geometry import Array, homogeneous, mean_rotation, nearest_rotation
from calibration.kinematics import RobotModel
from calibration.observations import Device, LengthObservations, Observations, PoseObservations
from calibration.parameters import ArmState, nominal_state

_MOST_ROWS = 100  # more make a guess no better
_NEAR_M = 1e-4
_FEWEST = {"point": 4, "pose": 3, "length": 8}


def first_guess(model: RobotModel, observations: Observations) -> tuple[ArmState, ...]:
    """Return starts to try, best first: one for points and poses, two mirror images for lengths.

    Raises
    ------
    DegenerateDataError
        Too few rows to place device and target at all.
    """
    if len(observations) < _FEWEST[observations.kind]:
        raise DegenerateDataError(
            f"{len(observations)} usable rows cannot place the device and its target.",
            remedy=f"Measure at least {_FEWEST[observations.kind]} postures, better 30.",
        )
    count = int(observations.mounting.max()) + 1
    observations = observations.take(np.arange(0, len(observations), 1 + len(observations) // _MOST_ROWS))
    frames = model.base_flange(observations.joints_rad)
    if isinstance(observations, LengthObservations):
        anchors = _anchors(frames[:, :3, 3], observations.lengths_m)
        places = [tuple(Device(np.eye(4), anchor) for _ in range(count)) for anchor in anchors]
        return tuple(nominal_state(model, devices) for devices in places)
    device_base, tool = _base_and_tool(frames, observations.positions_m)
    if isinstance(observations, PoseObservations):
        turned = np.swapaxes(device_base[:3, :3] @ frames[:, :3, :3], 1, 2) @ observations.rotations
        tool = homogeneous(mean_rotation(turned), tool[:3, 3])
    return (nominal_state(model, (Device(device_base, np.zeros(3)),) * count, tool),)


def _base_and_tool(base_flange: Array, positions_m: Array) -> tuple[Array, Array]:
    """Alternate between the best base for a tool point and the best tool point for a base."""
    tip = np.zeros(3)
    device_base = np.eye(4)
    for _ in range(30):
        device_base = rigid_fit(base_flange[:, :3, :3] @ tip + base_flange[:, :3, 3], positions_m)
        turned = device_base[:3, :3] @ base_flange[:, :3, :3]
        origin = base_flange[:, :3, 3] @ device_base[:3, :3].T + device_base[:3, 3]
        # Base and tip are found together, to first order, or the alternation would crawl: each posture's
        # equation is turned . tip + shift = measured - origin.
        design = np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], axis=2)
        answer = np.linalg.lstsq(design.reshape(-1, 6), (positions_m - origin).reshape(-1), rcond=None)[0]
        if np.linalg.norm(answer[:3] - tip) < _NEAR_M:
            break
        tip = answer[:3]
    return device_base, homogeneous(np.eye(3), tip)


def rigid_fit(points: Array, targets: Array) -> Array:
    """Return the rigid transform (4, 4) that best takes points (N, 3) to targets (N, 3)."""
    centre, goal = points.mean(axis=0), targets.mean(axis=0)
    spread = (targets - goal).T @ (points - centre)
    try:
        rotation = nearest_rotation(spread)
    except CalibrationError as error:
        raise DegenerateDataError(
            "the measured places all lie on one point or line.",
            remedy="Measure postures that turn at least three joints; check the columns.",
        ) from error
    return homogeneous(rotation, goal - rotation @ centre)


def _anchors(flange_m: Array, lengths_m: Array) -> tuple[Array, Array]:
    """Return the anchor by linear trilateration of the flange, and its mirror image.

    ``l^2 = |a|^2 - 2 a . p + |p|^2`` is linear in a and |a|^2. Where the postures lie almost in a plane, the
    linear equations cannot tell on which side the anchor is, so both are tried.
    """
    centre = flange_m.mean(axis=0)
    points = flange_m - centre
    design = np.column_stack([-2 * points, np.ones(len(points))])
    right = lengths_m**2 - (points**2).sum(axis=1)
    anchor = np.linalg.lstsq(design, right, rcond=None)[0][:3]
    _, _, axes = np.linalg.svd(points, full_matrices=False)
    mirrored = anchor - 2 * axes[2] * (axes[2] @ anchor)
    return anchor + centre, mirrored + centre
