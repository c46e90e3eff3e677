"""The functions of the public API that read files; `cellcal` lends them its name."""

from os import PathLike
from pathlib import Path

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.arm.robot_models import known_names
from cellcal.drivers.program_registry import read_program as read_program_data
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.identification.identify import IdentifyReport, identify_file
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from cellcal.service.engineering.measured.measurements import Measurements, ReadOptions
from cellcal.service.engineering.measured.measurements import read_measurements as read_measurement_file
from cellcal.service.engineering.programs.files import read_bytes


def robot_names() -> tuple[str, ...]:
    """Return the names of the robot models that ship, sorted."""
    return tuple(sorted(known_names()))


def load_robot(name: str) -> RobotModel:
    """Return a nominal robot.

    Parameters
    ----------
    name : str
        One of `robot_names`; a model file, ``arm.toml``; or a description, ``arm.urdf?base=LINK&tip=LINK``. With
        ``@wall``, ``@ceiling`` or ``@tilt:x=30`` behind it where it is not upright.
        ``@ceiling`` or ``@tilt:x=30`` behind it where it is not upright.

    Returns
    -------
    RobotModel
        Links [m, rad], joint limits [rad], and gravity in the base; ``base_flange(joints_rad)`` is its forward
        kinematics, (N, n) [rad] to (N, 4, 4) [m].

    Raises
    ------
    CellError
        There is no such model; the remedy names the nearest.
    """
    return load_model(name)


def read_measurements(
    path: str | PathLike[str], robot: RobotModel | str, options: ReadOptions | None = None
) -> Measurements:
    """Read a file of measurements: joints beside points, poses or lengths.

    Parameters
    ----------
    path : path
        A table of text or a workbook. Separator, decimal comma, units and columns are detected and reported in
        ``guesses``.
    robot : RobotModel or str
        The robot that was measured.
    options : ReadOptions, optional
        What the file does not say: columns, units, the convention of attitudes, joint coupling.

    Returns
    -------
    Measurements
        Usable rows in SI, and the rows that are none with their reasons.

    Raises
    ------
    CellError
        The file cannot be understood; the sentence names the line or column and the remedy the option that helps.
    """
    model = load_robot(robot) if isinstance(robot, str) else robot
    return read_measurement_file(Path(path), model, options)


def identify(path: str | PathLike[str], robot: str, options: IdentifyOptions | None = None) -> IdentifyReport:
    """Identify the kinematic parameters of a robot from a file of measurements.

    Parameters
    ----------
    path : path
        As for `read_measurements`.
    robot : str
        As for `load_robot`.
    options : IdentifyOptions, optional
        Level of the model, rows to hold out, a check file, an earlier fit to start from.

    Returns
    -------
    IdentifyReport
        Errors before, of the fit and of held-out rows [m]; parameters with standard deviations [m, rad]; what the
        data cannot tell, with its partner and the cure. ``as_document()`` is what ``cellcal identify --json`` prints.

    Raises
    ------
    CellError
        Unusable data, or measurements that do not fit this robot; the remedy names the cause that fits.

    Notes
    -----
    The level is chosen by cross-validation over groups of rows; the sources of the methods stand in
    `cellcal.calibration.identification`.
    """
    return identify_file(Path(path), robot, options)


def read_program(path: str | PathLike[str]) -> ProgramFile:
    """Read a robot program of any brand that is supported: FANUC, KUKA, ABB, Universal Robots, Yaskawa.

    Parameters
    ----------
    path : path
        A program file as the controller writes it.

    Returns
    -------
    ProgramFile
        Positions with tool, frame, posture and line, and what moves points without standing in the file. Every byte
        that is not a changed coordinate stays when positions are changed.

    Raises
    ------
    CellError
        No program, or one that is not understood, with line and column.
    """
    file = Path(path)
    return read_program_data(file.name, read_bytes(file))
