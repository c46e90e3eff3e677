"""Play the technician who drives a fake robot by hand: try the taught procedures without a robot.

In one terminal ``cellcal fakes CELL.toml``, which prints its control port; in another::

    python deploy/try_out/teach.py CELL.toml PORT six_point_tcp
    python deploy/try_out/teach.py CELL.toml PORT three_point_frame

The tool that the simulated technician holds is ``TIP_M`` from the flange, so that the result can be judged.
"""

import asyncio
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array
from cellcal.drivers.operator.scripted import ScriptedOperator
from cellcal.service.cli.run_end import print_outcome
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.runs.launch import RunTarget, start_run

TIP_M = (0.03, -0.02, 0.15)
START_RAD = (0.1, 0.0, -0.6, -1.0, -0.8, 0.8)  # the whole lesson is in reach from here
STEP_M = 0.32
SETTINGS: dict[str, dict[str, Any]] = {
    # the simulated technician touches with the arm as its controller believes it to be: such an arm has no errors
    "six_point_tcp": {"tool_number": 1, "touch_sigma_m": 5e-5, "arm_sigma_m": 0.0},
    "three_point_frame": {"frame_number": 1, "tip_in_flange_m": TIP_M, "check_above": True, "sigma_m": 5e-5},
}
# key of the instruction: turn about the tool's axes [deg], and way along them or along the base's axes [m]
TOUCHES = {"touch": (0, 0, 0), "touch_about_x": (40, 0, 0), "touch_about_y": (0, 35, 0)}
ALONG_TOOL = {"along_x": (STEP_M, 0, 0), "along_y": (0, STEP_M, 0), "along_z": (0, 0, STEP_M)}
ALONG_BASE = {
    "touch_origin": (0, 0, 0), "touch_on_x": (STEP_M, 0, 0), "touch_on_xy": (0.05, STEP_M, 0),
    "touch_above": (0, 0, STEP_M), "touch_origin_again": (0, 0, 0), "touch_more_on_x": (STEP_M, 0, 0),
    "touch_more_on_xy": (0.05, STEP_M, 0),
}  # fmt: skip
ONLY_YES = ("pin_is_fixed", "pointer_is_mounted", "accept_tool", "accept_frame", "may_move")


def flange_poses(model: RobotModel) -> dict[str, Array]:
    """Return where the flange has to be for each instruction (4, 4)."""
    square = model.base_flange(np.array([START_RAD]))[0]
    pin = square @ np.array([*TIP_M, 1.0])
    poses = {}
    for key, degrees in TOUCHES.items():
        flange = square.copy()
        flange[:3, :3] = square[:3, :3] @ Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
        flange[:3, 3] = pin[:3] - flange[:3, :3] @ np.array(TIP_M)
        poses[key] = flange
    for key, way in ALONG_TOOL.items():
        poses[key] = square.copy()
        poses[key][:3, 3] += square[:3, :3] @ np.array(way)
    for key, way in ALONG_BASE.items():
        poses[key] = square.copy()
        poses[key][:3, 3] += np.array(way)
    return poses


def solve_joints(model: RobotModel, flange: Array) -> Array:
    """Return joints near the start that bring the flange there."""

    def pose_error(joints_rad: Array) -> Array:
        found = model.base_flange(joints_rad[None])[0]
        return np.append((found[:3, 3] - flange[:3, 3]) * 1e3, (found[:3, :3] - flange[:3, :3]).ravel() * 1e3)

    solved = least_squares(
        pose_error, np.array(START_RAD), bounds=(model.lower_rad, model.upper_rad), xtol=1e-14
    )
    if solved.cost > 1e-6:
        raise SystemExit("the arm does not reach this pose: choose another START_RAD")
    joints: Array = solved.x
    return joints


def make_technician(fake_client: FakeCellClient, model: RobotModel, robot: str) -> ScriptedOperator:
    """Return an operator who moves the arm by hand through the fakes' control port and then confirms."""

    def make_hand_move(joints_rad: Array) -> Callable[[], Awaitable[None]]:
        async def drive_to_pose() -> None:
            await fake_client.inject_fault("hand_moves", device=robot, joints=joints_rad.tolist())

        return drive_to_pose

    hooks = {key: make_hand_move(solve_joints(model, flange)) for key, flange in flange_poses(model).items()}
    return ScriptedOperator(
        dict.fromkeys([*hooks, *ONLY_YES], "yes"), hooks=hooks, person="simulated technician"
    )


async def run_taught_procedure(cell: Path, port: int, procedure: str) -> int:
    """Run the procedure on the fake cell's first robot and return its exit code."""
    config = read_cell_file(cell)
    entry = config.robot_named()
    operator = make_technician(FakeCellClient("127.0.0.1", port), load_model(entry.model), entry.name)
    outcome = await start_run(RunTarget(config, operator, entry.name), procedure, dict(SETTINGS[procedure]))
    return print_outcome(outcome, config, as_json=True)


if __name__ == "__main__":
    if len(sys.argv) != 4 or sys.argv[3] not in SETTINGS:
        raise SystemExit(__doc__)
    sys.exit(asyncio.run(run_taught_procedure(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3])))
