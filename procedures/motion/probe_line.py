"""Straight approaches of a probe: planned, and measured along the way of the tip. Pure functions."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.geometry import Array, log_rotation
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Joints

Place = tuple[float, float, float]
_PIECES = 40
_STEPS = 30
_THERE_M, _THERE_RAD = 1e-9, 1e-9
_LONGEST_STEP_RAD = 0.2
_BESIDE_RAD = 1e-3  # 1 mm at a metre: no farther does an arm stand from where it was stopped on the line


@dataclass(frozen=True, eq=False)
class ProbeLine:
    """A straight line in joint space; distances are the way of the tip from its start [m]."""

    model: RobotModel
    tip_in_flange_m: Place
    start_rad: Array  # (n,)
    way_rad: Array  # (n,), from start to end
    travelled_m: Array  # (pieces + 1,), of the tip, at equal parts of the way
    fastest_m: float  # of the tip for the whole way, where it is fastest

    @property
    def length_m(self) -> float:
        """The distance of the tip from start to end."""
        return float(self.travelled_m[-1])

    def joints_at(self, distance_m: float) -> Joints:
        """Return the joints at a distance from the start; never beyond either end."""
        share = float(np.interp(distance_m, self.travelled_m, np.linspace(0.0, 1.0, len(self.travelled_m))))
        return tuple(float(q) for q in self.start_rad + share * self.way_rad)

    def distance_of(self, joints_rad: Joints) -> float:
        """Return how far along the line joints are that lie on it, or near it."""
        share = float((np.array(joints_rad) - self.start_rad) @ self.way_rad / (self.way_rad @ self.way_rad))
        return float(np.interp(share, np.linspace(0.0, 1.0, len(self.travelled_m)), self.travelled_m))

    def is_on_line(self, joints_rad: Joints) -> bool:
        """Return whether joints lie on the line, as far as an arm stands where it was sent."""
        beside = np.array(joints_rad) - self.joints_at(self.distance_of(joints_rad))
        return bool(np.abs(beside).max() < _BESIDE_RAD)

    def joint_speed_rad_s(self, tip_speed_m_s: float) -> float:
        """Return the speed of the joint with the longest way at which the tip is nowhere faster than asked."""
        return tip_speed_m_s * float(np.abs(self.way_rad).max()) / self.fastest_m

    def tips_m(self, joints_rad: Array) -> Array:
        """Return where the tip is for joints (N, n), by the nominal model: (N, 3)."""
        return self.model.tip_positions(np.atleast_2d(joints_rad), np.array(self.tip_in_flange_m))


def probe_line(model: RobotModel, tip_in_flange_m: Place, start_rad: Joints, end_rad: Joints) -> ProbeLine:
    """Return the line from start to end.

    Raises
    ------
    DegenerateDataError
        Numbers that are not finite, or a line on which the tip does not move.
    """
    start, end = np.array(start_rad, dtype=float), np.array(end_rad, dtype=float)
    tip = np.array(tip_in_flange_m, dtype=float)
    if start.shape != (model.axis_count,) or end.shape != start.shape:
        raise DegenerateDataError(
            make_message(
                "start and end of an approach are {axis_count} joints each", axis_count=model.axis_count
            )
        )
    if not np.isfinite([*start, *end, *tip]).all():
        raise DegenerateDataError("an approach needs finite joints and a finite tip")
    joints = start + np.linspace(0.0, 1.0, _PIECES + 1)[:, None] * (end - start)
    tips, slopes = model.tip_jacobian(joints, tip)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1))])
    if travelled[-1] < 1e-5:
        raise DegenerateDataError("the tip does not move from start to end of the approach")
    fastest_m = float(np.linalg.norm(slopes @ (end - start), axis=1).max())
    return ProbeLine(model, tip_in_flange_m, start, end - start, travelled, fastest_m)


def joints_for_tip(
    model: RobotModel, tip_in_flange_m: Place, near_rad: Joints, tip_in_base_m: Array
) -> Joints:
    """Return joints near given ones that put the tip on a place and keep the tool's attitude.

    Newton's method on the six errors of the pose, with the model's own Jacobian.

    Raises
    ------
    DegenerateDataError
        No such joints nearby: out of reach, or near a singularity.
    """
    tip = np.array(tip_in_flange_m, dtype=float)
    joints = np.array(near_rad, dtype=float)
    attitude = model.base_flange(joints[None])[0, :3, :3]
    for _ in range(_STEPS):
        poses, jacobian = model.flange_jacobian(joints[None])
        pose = poses[0]
        away = np.asarray(tip_in_base_m, dtype=float) - (pose[:3, :3] @ tip + pose[:3, 3])
        turned = pose[:3, :3] @ log_rotation(pose[:3, :3].T @ attitude)
        if np.linalg.norm(away) < _THERE_M and np.linalg.norm(turned) < _THERE_RAD:
            return tuple(float(q) for q in joints)
        columns = np.vstack([model.tip_jacobian(joints[None], tip)[1][0], jacobian[0, 3:]])
        step, *_ = np.linalg.lstsq(columns, np.concatenate([away, turned]), rcond=1e-6)
        joints = joints + step * min(1.0, _LONGEST_STEP_RAD / max(float(np.abs(step).max()), 1e-12))
    raise DegenerateDataError(
        "the tip cannot be brought there with this attitude", remedy="Choose a start from which it can."
    )
