"""pybotics 3.1.2: its own inverse kinematics and its own optimiser hooks with scipy. It wants numpy below 2."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

_POINTS = 100  # at about a hundred a second, more would tell nothing new


def compensate(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Solve the first hundred postures with ``Robot.ik``, which works in millimetres and bounds joints by pi."""
    nominal, real = (_build_robot(inputs[f"{name}_dh"]) for name in ("nominal", "real"))
    joints = inputs["joints"][:_POINTS]

    def solve_postures() -> tuple[Any, Any]:
        found, claimed = joints.copy(), np.zeros(len(joints), dtype=bool)
        for i, start in enumerate(joints):
            answer = real.ik(nominal.fk(start), q=start)
            if answer is not None:
                found[i], claimed[i] = answer, True
        return found, claimed

    seconds, (found, claimed) = measure(solve_postures)
    return {"joints": found, "seconds": seconds, "claimed": claimed}


def identify(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Run scipy's default least squares on ``optimize_accuracy``: all 24 links' numbers, tool place and world."""
    optimization = import_module("pybotics.optimization")
    least_squares = import_module("scipy.optimize").least_squares
    positions = inputs["positions"] * 1e3
    robot = _build_robot(inputs["nominal_dh"])
    tool = robot.tool.matrix.copy()
    tool[:3, 3] += tool[:3, :3] @ inputs["target_start"] * 1e3
    robot.tool.matrix = tool
    world = inputs["device_base_start"].copy()
    world[:3, 3] *= 1e3
    robot.world_frame = world

    def solve_parameters() -> Any:
        handler = optimization.OptimizationHandler(
            robot, kinematic_chain_mask=True, tool_mask=[True] * 3 + [False] * 3, world_mask=True
        )
        start = handler.generate_optimization_vector()
        answer = least_squares(
            optimization.optimize_accuracy, start, args=(handler, inputs["joints"], positions)
        )
        handler.apply_optimization_vector(answer.x)
        return handler.robot

    seconds, found = measure(solve_parameters)
    places = [found.fk(check)[:3, 3] * 1e-3 for check in inputs["check_joints"]]
    return {"seconds": seconds, "check_positions": np.array(places)}


def _build_robot(rows: Any) -> Any:
    """Build from standard rows theta, d, a, alpha: modified rows take the link before the joint."""
    import_module("scipy")
    robot_module = import_module("pybotics.robot")
    theta, d, a, alpha = rows.T
    before = np.concatenate([[[0.0, 0.0]], np.column_stack([alpha, a * 1e3])[:-1]])
    robot = robot_module.Robot.from_parameters(np.column_stack([before, theta, d * 1e3]))
    cos, sin = np.cos(alpha[-1]), np.sin(alpha[-1])
    tool = np.eye(4)
    tool[1:3, 1:3] = [[cos, -sin], [sin, cos]]
    tool[0, 3] = a[-1] * 1e3
    robot.tool.matrix = tool
    return robot
