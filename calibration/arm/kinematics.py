"""What is known of arms in one place: models, their frames and derivatives, and models by name."""

from cellcal.calibration.arm.chain_columns import (
    cosine_and_sine,
    cross_product,
    frames_of_placements,
    independent_columns,
    placement_columns,
    twists_by_independent_columns,
)
from cellcal.calibration.arm.dh_table import DhTable
from cellcal.calibration.arm.model_references import load_model
from cellcal.calibration.arm.robot_model import MODEL_TOLERANCE_M, RobotModel, chain_frames, joint_columns
from cellcal.calibration.arm.robot_models import model_names

__all__ = [
    "MODEL_TOLERANCE_M",
    "DhTable",
    "RobotModel",
    "chain_frames",
    "cosine_and_sine",
    "cross_product",
    "frames_of_placements",
    "independent_columns",
    "joint_columns",
    "load_model",
    "model_names",
    "placement_columns",
    "twists_by_independent_columns",
]
