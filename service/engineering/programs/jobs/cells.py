"""Cells that programs are made for: this service's robot, or a project. Used in the process that computes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.motion.cell_shapes import CellShape
from cellcal.procedures.surroundings import NOTHING_KNOWN, cell_shape
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.engineering.programs.project import SMALLEST_SIGMA, Project
from cellcal.service.engineering.programs.project_arms import IdentifiedArm, identified_arm
from cellcal.service.engineering.programs.project_poses import ProjectTool
from cellcal.service.engineering.programs.project_tables import RobotTable

HELD_OUT_LABEL = "error at poses held out of the identification"  # as the page labels the field
_IN_SPACE = 2.8  # the radius that holds 95 % of a tip, in standard deviations of one coordinate


def cell_here(config: CellConfig, cell_input: Mapping[str, Any]) -> Project:
    """Return a robot of this service's cell with its newest parameters, and tools and frames as runs left them.

    ``cell_input`` is what a page asked for, with ``sets``, the folder of all parameters beside the cell
    file, and with
    ``measured``, what runs of this cell kept. What a person entered goes before what a run measured.

    Raises
    ------
    CellError
        There is no such robot, or its parameters cannot be used.
    """
    robot = config.robot_named(cell_input["name"] or None)
    model = load_model(robot.model)
    tools, frames = _measured_frames(cell_input["measured"])
    tools |= {
        each["name"]: ProjectTool(pose_from_json(each), pose_from_json(each)) for each in cell_input["tools"]
    }
    frames |= {each["name"]: pose_from_json(each) for each in cell_input["frames"]}
    return Project(
        path=Path(f"{config.cell.name}, {robot.name}"),
        name=f"{config.cell.name}, {robot.name}",
        serial=robot.serial,
        nominal=model,
        controller=model,
        factory_known=False,
        identified=_identified_arm(config, cell_input, robot.serial, model),
        tools=tools,
        frames=frames,
        default_tool=_only_name(cell_input["tools"]),
        default_frame=_only_name(cell_input["frames"]),
        alignment=None,
        shapes=_cell_shape(config, robot.name, model),
        smallest_sigma=SMALLEST_SIGMA,
        master=None,
        programs=(),
        held_out_setting=HELD_OUT_LABEL,
    )


def _identified_arm(
    config: CellConfig, cell_input: Mapping[str, Any], serial: str, model: RobotModel
) -> IdentifiedArm | None:
    folder, sets = Path(config.path).parent, cell_input["sets"]
    if serial not in ParameterSets(folder / sets).robot_serials():
        return None
    held_out_m = cell_input["held_out_rms_m"]
    table = RobotTable(
        serial=serial,
        model=model.name,
        parameter_store=sets,
        held_out_rms_mm=None if held_out_m is None else held_out_m * 1e3,
    )
    return identified_arm(table, folder, model, "this cell")


def _measured_frames(found: Sequence[Mapping[str, Any]]) -> tuple[dict[str, ProjectTool], dict[str, Array]]:
    tools: dict[str, ProjectTool] = {}
    frames: dict[str, Array] = {}
    for result in found:
        value = result["value"]
        if result["what"] == "tool_frame":
            entered, real = (pose_from_json(value[key]) for key in ("read_back", "flange_tool"))
            tools[result["subject"]] = ProjectTool(entered, real, _tip_sigma_m(value), measured=True)
        elif result["what"] == "user_frame":
            frames[result["subject"]] = pose_from_json(value["read_back"])
    return tools, frames


def _tip_sigma_m(tool: Mapping[str, Any]) -> float:
    within = tool["tip"]["tip_u_in_space_m"] if "tip" in tool else tool["tip_u_m"]
    return float(within) / _IN_SPACE


def _cell_shape(config: CellConfig, robot: str, model: RobotModel) -> CellShape | None:
    around = config.motion_of(robot).surroundings
    return None if around == NOTHING_KNOWN else cell_shape(model, around)


def _only_name(entered: Sequence[Mapping[str, Any]]) -> str | None:
    """Return the one that a person entered, if it is one: programs that do not say mean it."""
    return str(entered[0]["name"]) if len(entered) == 1 else None


def pose_from_json(raw: Mapping[str, Any]) -> Array:
    """Return a pose (4, 4); a quaternion that a page sent need not be of unit length.

    Raises
    ------
    CalibrationError
        It is no pose.
    """
    x, y, z = (float(v) for v in raw["position_m"])
    turn = np.array([float(v) for v in raw["quaternion"]])
    w, qx, qy, qz = (float(v) for v in turn / max(float(np.linalg.norm(turn)), 1e-12))
    return Pose((x, y, z), (w, qx, qy, qz)).to_matrix()
