"""figaroh 1.0.2: its structural calibration of the full parameters, from a data file to a solution."""

import tempfile
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_CONFIG = """
robot: {{name: arm}}
tasks:
  calibration:
    enabled: true
    type: kinematic_calibration
    kinematics: {{base_frame: universe, tool_frame: flange}}
    parameters:
      calibration_level: full_params
      include_non_geometric: false
      regularization_coefficient: 0.0
      outlier_threshold: 0.05
    measurements:
      markers:
        - {{measurable_dof: [true, true, true, false, false, false]}}
      poses: {{base_pose: null, tool_pose: null}}
    data:
      source_file: {data}
      number_of_samples: {count}
"""


def identify(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Time initialisation and solution together, as a user meets them; writing the data file is not timed."""
    base = import_module("figaroh.calibration.base_calibration")
    tools = import_module("figaroh.calibration.calibration_tools")

    class Calibration(base.BaseCalibration):  # type: ignore[misc, name-defined]
        def cost_function(self, var: Any) -> Any:
            places = tools.calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
            return self._compute_logmap_residuals(self.PEE_measured, places)

    with tempfile.TemporaryDirectory() as folder:
        data, config = Path(folder) / "data.csv", Path(folder) / "config.yaml"
        _write_data_file(data, inputs["joints"], inputs["positions"])
        config.write_text(_CONFIG.format(data=data, count=len(inputs["joints"])), encoding="utf-8")

        def solve_calibration() -> Any:
            calibration = Calibration(_build_robot(inputs["nominal_placements"]), str(config))
            calibration.calib_config.update(known_baseframe=False, known_tipframe=False)
            calibration.initialize()
            return calibration, calibration.solve(enable_logging=False)

        seconds, (calibration, result) = measure(solve_calibration)
    settings = {**calibration.calib_config, "NbSample": len(inputs["check_joints"])}
    places = tools.calc_updated_fkm(
        calibration.model, calibration.data, result.x, inputs["check_joints"], settings
    )
    return {
        "seconds": seconds,
        "check_positions": np.reshape(places, (3, -1)).T,
        "parameters": len(settings["param_name"]),
    }


def poses(inputs: Mapping[str, NDArray[np.float64]], measure: Any) -> dict[str, object]:
    """Solve the relaxed design and take the largest weights, as its threshold rule does for a fixed number."""
    optimal = import_module("figaroh.optimal.base_optimal_calibration")
    blocks, chosen = inputs["blocks"], int(inputs["chosen"])

    def solve_design() -> Any:
        pool = {i: blocks[:, :, i] @ blocks[:, :, i].T for i in range(blocks.shape[2])}
        optimiser = optimal.SOCPOptimizer(pool, {"NbSample": len(pool)})
        return list(optimiser.solve()[1])[:chosen]

    seconds, indices = measure(solve_design)
    return {"seconds": seconds, "indices": np.array(indices)}


def _build_robot(placements: Any) -> Any:
    pin = import_module("pinocchio")
    wrapper = import_module("pinocchio.robot_wrapper").RobotWrapper
    model, joint = pin.Model(), 0
    for k in range(len(placements) - 1):
        place = pin.SE3(placements[k][:3, :3], placements[k][:3, 3])
        joint = model.addJoint(joint, pin.JointModelRZ(), place, f"joint_{k + 1}")
    last = pin.SE3(placements[-1][:3, :3], placements[-1][:3, 3])
    model.addFrame(pin.Frame("flange", joint, 0, last, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit, model.upperPositionLimit = np.full(model.nq, -3.0), np.full(model.nq, 3.0)
    return wrapper(model)


def _write_data_file(path: Path, joints: Any, positions: Any) -> None:
    names = ["x1", "y1", "z1", *(f"joint_{k + 1}" for k in range(joints.shape[1]))]
    rows = np.column_stack([positions, joints])
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="", fmt="%.12g")
