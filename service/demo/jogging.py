"""The demo's technician at the pendant: jogs the arm until the tip is where a touch wants it.

He sees the real tip, not what the model says of it, and misses by a tenth of a millimetre.
"""

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.compensation.posture_of_pose import postures_of_poses
from cellcal.calibration.errors import CellError
from cellcal.calibration.geometry import Array, log_rotation
from cellcal.service.demo.demo_fixtures import place_for
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.demo.faults import ROBOT

MODEL = "fanuc_m6ib"  # of the robot that the demo's cell file calls ROBOT
MISSED_M = 1e-4  # one coordinate (k=1)
_NEAR_M, _LOOKS = 2e-5, 8
_STARTS_RAD = (
    (0.0, 0.3, -0.1, 0.0, -1.2, 0.0),
    (0.0, 0.3, -0.1, 1.2, -1.0, -1.2),
    (0.0, 0.3, -0.1, -1.2, -1.0, 1.2),
)


def can_jog(robot: str, procedure: str, key: str) -> bool:
    """Whether the technician knows where this instruction wants the arm."""
    return robot == ROBOT and place_for(procedure, key) is not None


async def jog_for(
    fake_cell: FakeCellClient, robot: str, procedure: str, key: str, rng: np.random.Generator
) -> None:
    """Bring the arm to where an instruction wants it.

    Raises
    ------
    CellError
        The technician does not know where that is, or the arm does not get there.
    """
    place = place_for(procedure, key) if robot == ROBOT else None
    if place is None:
        raise CellError(
            "the demo's technician knows no place for this step.",
            remedy="Answer the step yourself; only touches with the FANUC are jogged.",
            code="usage",
        )
    target = place.copy()
    target[:3, 3] += rng.normal(scale=MISSED_M, size=3)
    model = load_model(MODEL)
    joints = _solve_posture(model, target)
    for _ in range(_LOOKS):
        await fake_cell.inject_fault("hand_moves", device=robot, joints=joints.tolist())
        here = np.array((await fake_cell.read_truth())["robots"][robot]["base_flange"])
        gap = _pose_error(here, target)
        if np.abs(gap).max() < _NEAR_M:
            return
        joints = joints + np.linalg.lstsq(model.flange_jacobian(joints[None])[1][0], gap, rcond=1e-6)[0]
    raise CellError(
        "the demo's technician did not get the tip there.", remedy="Press the button again.", code="fake"
    )


def _solve_posture(model: RobotModel, base_flange: Array) -> Array:
    found = postures_of_poses(TipArm(model), base_flange[None], np.array(_STARTS_RAD))
    if not found.reached[0]:
        raise CellError(
            "the arm does not reach this place.", remedy="Choose other points in the settings.", code="fake"
        )
    return np.asarray(found.joints_rad[0])


def _pose_error(here: Array, target: Array) -> Array:
    """Return what is left (6,): metres, then radians, in base axes."""
    turn = here[:3, :3] @ log_rotation(here[:3, :3].T @ target[:3, :3])
    return np.concatenate([target[:3, 3] - here[:3, 3], turn])
