"""Where a device and its target are, roughly, before any fit: starts that cannot lead astray."""

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array, homogeneous_matrix, mean_rotation, nearest_rotation
from cellcal.calibration.identification.observations import (
    DevicePlacement,
    LengthObservations,
    Observations,
    PoseObservations,
)
from cellcal.calibration.identification.parameters import ArmState, nominal_state
from cellcal.calibration.message import make_message

_MOST_ROWS = 100  # more make a guess no better
_NEAR_M = 1e-3  # a nominal arm is off by as much
_UNTURNED = 1e-10  # of the largest eigenvalue
_STILL_M = 1e-6
START_OFF_AXIS = np.array([1.0, 0.7, 0.4])  # a tip that any turn moves
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
            make_message(
                "too few usable rows to place the device and its target: {rows}.", rows=len(observations)
            ),
            remedy=make_message(
                "Measure at least {fewest} postures, better 30.", fewest=_FEWEST[observations.kind]
            ),
        )
    count = int(observations.mounting.max()) + 1
    observations = observations.select_rows(
        np.arange(0, len(observations), 1 + len(observations) // _MOST_ROWS)
    )
    frames = model.base_flange(observations.joints_rad)
    if isinstance(observations, LengthObservations):
        both = locate_anchors(frames[:, :3, 3], observations.lengths_m)
        places = [tuple(DevicePlacement(np.eye(4), anchor) for _ in range(count)) for anchor in both]
        return tuple(nominal_state(model, devices) for devices in places)
    device_base, tool = base_and_tool(frames, observations.positions_m)
    if isinstance(observations, PoseObservations):
        turned = np.swapaxes(device_base[:3, :3] @ frames[:, :3, :3], 1, 2) @ observations.rotations
        tool = homogeneous_matrix(mean_rotation(turned), tool[:3, 3])
    return (nominal_state(model, (DevicePlacement(device_base, np.zeros(3)),) * count, tool),)


def base_and_tool(base_flange: Array, positions_m: Array) -> tuple[Array, Array]:
    """Alternate between the best base for a tool point and the best tool point for a base.

    With base R, t and tool point x each posture says ``R (F x + c) + t = p``, of which only sums over the
    postures matter; so the postures are met once.
    """
    turns, origins = base_flange[:, :3, :3], base_flange[:, :3, 3]
    turn, origin, goal = turns.mean(axis=0), origins.mean(axis=0), positions_m.mean(axis=0)
    moved = positions_m - goal
    with_origins = moved.T @ origins
    with_turns = (moved.T @ turns.reshape(-1, 9)).reshape(9, 3)  # rows: measured and base axis
    turned_origins = (origins - origin).reshape(-1) @ turns.reshape(-1, 3)
    # Postures that turn the flange about one axis only, or not at all, leave some of the tool point at zero.
    inverse = np.linalg.pinv(len(turns) * (np.eye(3) - turn.T @ turn), rcond=_UNTURNED, hermitian=True)
    tip = START_OFF_AXIS if stand_still(origins) else np.zeros(3)
    for _ in range(30):
        rotation = _nearest_rotation_of((with_turns @ tip).reshape(3, 3) + with_origins)
        # Tip and shift are found together, or the alternation would crawl.
        better = inverse @ (rotation.reshape(-1) @ with_turns - turned_origins)
        step, tip = better - tip, better
        if step @ step < _NEAR_M**2:
            break
    return homogeneous_matrix(rotation, goal - rotation @ (turn @ tip + origin)), homogeneous_matrix(
        np.eye(3), tip
    )


def stand_still(origins_m: Array) -> Array:
    """Return whether flanges (..., N, 3) turn without moving, as on the axis of a turntable: of each series."""
    still: Array = np.ptp(origins_m, axis=-2).max(axis=-1) < _STILL_M
    return still


def _nearest_rotation_of(spread: Array) -> Array:
    try:
        return nearest_rotation(spread)
    except CalibrationError as error:
        raise DegenerateDataError(
            "the measured places all lie on one point or line.",
            remedy="Measure postures that turn at least three joints; check the columns.",
        ) from error


def locate_anchors(tips_m: Array, lengths_m: Array) -> tuple[Array, Array]:
    """Return the anchor by linear trilateration of the tips, and its mirror image.

    ``l^2 = |a|^2 - 2 a . p + |p|^2`` is linear in a and |a|^2. Where the postures lie almost in a plane, the
    linear equations cannot tell on which side the anchor is, so both are tried.
    """
    centre = tips_m.mean(axis=0)
    points = tips_m - centre
    design = np.column_stack([-2 * points, np.ones(len(points))])
    right = lengths_m**2 - (points**2).sum(axis=1)
    anchor = np.linalg.lstsq(design, right, rcond=None)[0][:3]
    _, _, axes = np.linalg.svd(points, full_matrices=False)
    mirrored = anchor - 2 * axes[2] * (axes[2] @ anchor)
    return anchor + centre, mirrored + centre
