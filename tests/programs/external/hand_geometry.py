"""Poses, arms and axes by plain numpy: nothing here is the product's but the numbers of the nominal arms."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cellcal.calibration.arm.kinematics import RobotModel, load_model

Array = NDArray[np.float64]


def pose(place: object = (0.0, 0.0, 0.0), rotvec: object = (0.0, 0.0, 0.0)) -> Array:
    """Return (4, 4) [m, rad]."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_rotvec(np.asarray(rotvec, dtype=float)).as_matrix()
    found[:3, 3] = np.asarray(place, dtype=float)
    return found


def flange_of(model: RobotModel, joints: Array) -> Array:
    """Return the flange (4, 4) of the nominal arm, link by link."""
    angles = model.theta0_rad + model.joint_coupling @ joints
    found = model.placements[0].copy()
    for angle, placement in zip(angles, model.placements[1:], strict=True):
        found = found @ pose(rotvec=(0, 0, angle)) @ placement
    return found


def axis_pose(kind: str, frame: Array, direction: object, travel: float) -> Array:
    """Return what an axis does to what it carries, seen from the cell."""
    along = np.asarray(direction, dtype=float)
    step = pose(along * travel) if kind == "prismatic" else pose(rotvec=along * travel)
    return frame @ step @ np.linalg.inv(frame)


def apart(one: Array, other: Array) -> tuple[float, float]:
    """Return the distance [mm] and the angle [deg] between two poses."""
    turn = Rotation.from_matrix(one[:3, :3].T @ other[:3, :3]).magnitude()
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3]) * 1e3), float(np.degrees(turn))


def arm(name: str) -> RobotModel:
    """Return a nominal arm."""
    return load_model(name)
