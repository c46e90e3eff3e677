"""Calibration of industrial robot cells: what the command ``cellcal`` does, for Python.

>>> import cellcal
>>> report = cellcal.identify("measurements.csv", "ur10")
>>> report.held_out.rmse_m
>>> cellcal.predict_readings(report.identification, joints_rad).expanded_m

Everything in ``__all__`` is public; nothing else is promised. Lengths are metres, angles radians, poses homogeneous
matrices named by their product (``base_tip = base_flange @ flange_tip``). What cannot be done raises `CellError`
with a sentence and a remedy.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellcal.calibration.arm.kinematics import RobotModel
    from cellcal.calibration.compensation.compensate import Compensation, compensate
    from cellcal.calibration.errors import CellError
    from cellcal.calibration.identification.reading_prediction import ReadingPrediction, predict_readings
    from cellcal.drivers.programs.positions import ProgramFile
    from cellcal.library import identify, load_robot, read_measurements, read_program, robot_names
    from cellcal.service.engineering.identification.identify import IdentifyReport
    from cellcal.service.engineering.identification.row_fit import IdentifyOptions
    from cellcal.service.engineering.measured.measurements import Measurements, ReadOptions

__all__ = [
    "CellError",
    "Compensation",
    "IdentifyOptions",
    "IdentifyReport",
    "Measurements",
    "ProgramFile",
    "ReadOptions",
    "ReadingPrediction",
    "RobotModel",
    "compensate",
    "identify",
    "load_robot",
    "predict_readings",
    "read_measurements",
    "read_program",
    "robot_names",
]

# Loaded at first use: the command line must not wait for numpy.
_MODULES = {
    "CellError": "cellcal.calibration.errors",
    "Compensation": "cellcal.calibration.compensation.compensate",
    "IdentifyOptions": "cellcal.service.engineering.identification.row_fit",
    "IdentifyReport": "cellcal.service.engineering.identification.identify",
    "Measurements": "cellcal.service.engineering.measured.measurements",
    "ProgramFile": "cellcal.drivers.programs.positions",
    "ReadOptions": "cellcal.service.engineering.measured.measurements",
    "ReadingPrediction": "cellcal.calibration.identification.reading_prediction",
    "RobotModel": "cellcal.calibration.arm.kinematics",
    "compensate": "cellcal.calibration.compensation.compensate",
    "identify": "cellcal.library",
    "load_robot": "cellcal.library",
    "predict_readings": "cellcal.calibration.identification.reading_prediction",
    "read_measurements": "cellcal.library",
    "read_program": "cellcal.library",
    "robot_names": "cellcal.library",
}


def __getattr__(name: str) -> Any:
    """Load a public name at its first use."""
    if name not in _MODULES:
        raise AttributeError(f"module 'cellcal' has no attribute {name!r}")
    value = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
