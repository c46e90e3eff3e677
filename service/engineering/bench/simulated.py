"""The arm that all contestants are given: a UR10 with errors of a real arm's size, in forms each of them reads."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array, exp_twist, homogeneous_matrix

ROBOT = "ur10"
LENGTH_ERROR_M = 4e-4
ANGLE_ERROR_RAD = float(np.deg2rad(0.03))
OFFSET_ERROR_RAD = float(np.deg2rad(0.15))


@dataclass(frozen=True, eq=False)
class SimulatedArms:
    """The nominal arm and the real one; the real one's errors leave out beta, which some peers cannot write."""

    nominal: RobotModel
    real: RobotModel

    def to_inputs(self) -> dict[str, Array]:
        """Return both as placements with the joints' zeros in them, and as rows theta, d, a, alpha [rad, m]."""
        return {**model_inputs(self.nominal, "nominal"), **model_inputs(self.real, "real")}


def draw_arms(seed: int) -> SimulatedArms:
    """Draw a real arm."""
    nominal = load_model(ROBOT)
    rng = np.random.default_rng(seed)
    scale = [OFFSET_ERROR_RAD, LENGTH_ERROR_M, LENGTH_ERROR_M, ANGLE_ERROR_RAD, 0.0]
    return SimulatedArms(nominal, nominal.with_dh_errors(rng.normal(size=(nominal.axis_count, 5)) * scale))


def draw_joints(rng: np.random.Generator, count: int) -> Array:
    """Return joints (N, 6) all over one turn of every joint."""
    joints: Array = rng.uniform(-3.0, 3.0, (count, 6))
    return joints


def device_and_target(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return where a tracker stands, device_base (4, 4), and where its target sits in the flange (3,) [m]."""
    place = exp_twist(np.concatenate([rng.uniform(-2, 2, 3), rng.uniform(-1, 1, 3)]))
    return homogeneous_matrix(place[:3, :3], place[:3, 3]), np.array([0.08, -0.05, 0.12])


def model_inputs(model: RobotModel, name: str) -> dict[str, Array]:
    """Return one arm in forms that contestants read, under a name."""
    return {f"{name}_placements": _joint_placements(model), f"{name}_dh": _dh_rows(model)}


def _joint_placements(model: RobotModel) -> Array:
    placements = model.placements.copy()
    turns = exp_twist(np.concatenate([np.zeros((model.axis_count, 5)), model.theta0_rad[:, None]], axis=1))
    placements[:-1] = placements[:-1] @ turns
    return placements


def _dh_rows(model: RobotModel) -> Array:
    if model.dh is None:
        return np.empty((0, 4))
    return model.dh.to_rows()[:, :4]
