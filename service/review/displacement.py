"""By how much a robot's tip is displaced where another version of its parameters holds: a diff in millimetres."""

from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.motion.motion_check import MotionLimits
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.calibrated_models import calibrated_model
from cellcal.service.engineering.parameters.parameter_sets import FOLDER, ParameterSets
from cellcal.service.record.stored_results import newest_stored_result
from cellcal.service.review.review_models import Displacement

POSTURES = 400


def compute_displacement(config: CellConfig, robot_serial: str, before: int, after: int) -> Displacement:
    """Compare the arms of two versions.

    Raises
    ------
    ParameterSetError
        There is no such version, or it refers to another nominal model.
    """
    sets = ParameterSets(Path(config.path).parent / FOLDER)
    old, new = sets.load_set(robot_serial, before), sets.load_set(robot_serial, after)
    nominal = load_model(new.model)
    tool = newest_stored_result(config, robot_serial, "tool_frame")
    x, y, z = (0.0, 0.0, 0.0) if tool is None else tool.value["flange_tool"]["position_m"]
    tip = (float(x), float(y), float(z))
    joints = candidate_joints(nominal, MotionLimits(), POSTURES, hook_in_flange_m=tip)
    arms = [calibrated_model(nominal, version) for version in (old, new)]
    places = [arm.model.tip_positions(joints, np.array(tip)) for arm in arms]
    away = np.linalg.norm(places[1] - places[0], axis=1)
    changed = {name for arm in arms for name in arm.left_out if old.find_value(name) != new.find_value(name)}
    return Displacement(float(away.max()), float(away.mean()), len(joints), tip, tuple(sorted(changed)))
