"""The two arms of a project: the one that its controller computes with, and the one that stands in the cell."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.arm.model_references import model_of_text
from cellcal.calibration.arm.robot_models.model_text import read_model_text
from cellcal.calibration.arm.ur_factory import factory_model
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import describe_unreadable, read_plain_text
from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.free_parameters import StartingPoint, starting_state
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.parameters import GEOMETRY, ArmState, ParameterLayout
from cellcal.calibration.message import make_message
from cellcal.service.engineering.parameters.calibrated_models import calibrated_model, covariance_of
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, parse_set
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.engineering.parameters.ur_files import (
    model_of_ros,
    read_calibration_conf,
    read_ros_kinematics,
)
from cellcal.service.engineering.programs.project_poses import ProjectError
from cellcal.service.engineering.programs.project_tables import RobotTable

_OF_PLACES = ("base", "anchor", "tool", "wire")  # of the measuring, and no part of the arm


@dataclass(frozen=True, eq=False)
class IdentifiedArm:
    """A robot's parameter set as an arm, with what is known of its uncertainty."""

    state: ArmState  # without a tool
    sha256: str  # of the parameter set
    version: int
    layout: (
        ParameterLayout | None
    )  # names the free parameters of `covariance`; None where no covariance is kept
    covariance: Array | None  # (p, p)
    held_out_rms_m: float | None  # what the identification missed of readings that it had not seen
    undetermined: tuple[str, ...] = ()  # parameters that it left where they were assumed


def nominal_arm(path: Path, name: str) -> RobotModel:
    """Return the arm of a model file of the user's own, written as those that ship.

    Raises
    ------
    ProjectError
        No such file, or one that lacks something.
    """
    try:
        return model_of_text(name, read_model_text(name, _read_text(path)))
    except CalibrationError as refused:
        raise ProjectError(
            make_message("{path}: {refused_message}", path=path, refused_message=refused.message),
            remedy=refused.remedy,
        ) from refused
    except (DocumentError, TypeError, ValueError) as broken:
        raise ProjectError(
            make_message("{path} is no model of a robot: {broken}", path=path, broken=broken)
        ) from broken


def factory_arm(path: Path, nominal: RobotModel) -> RobotModel:
    """Return the arm that a controller computes with, from its ``calibration.conf``, ROS's file of it, or a set.

    Raises
    ------
    ProjectError
        None of these, or of another arm.
    """
    text = _read_text(path)
    try:
        if "delta_theta" in text:
            return factory_model(nominal, read_calibration_conf(text, nominal).table)
        if "[[parameter]]" in text:
            return calibrated_model(nominal, parse_set(text, str(path))).model
        if "kinematics:" in text:
            return model_of_ros(read_ros_kinematics(text), nominal)
    except CellError as refused:
        raise ProjectError(
            make_message("{path}: {refused_message}", path=path, refused_message=refused.message),
            remedy=refused.remedy,
        ) from refused
    raise ProjectError(
        make_message("{path} is no factory calibration.", path=path),
        remedy="Name a calibration.conf, the file of ur_calibration, or an exported parameter set.",
    )


def identified_arm(robot: RobotTable, folder: Path, nominal: RobotModel, where: str) -> IdentifiedArm | None:
    """Return the arm of the set that a project names, or None where it names none.

    Raises
    ------
    ProjectError
        A set of another robot, or a value that its arm has no place for.
    """
    serial, rms_mm = robot.serial, robot.held_out_rms_mm
    found = _parameter_set(robot, folder, where)
    if found is None:
        return None
    if found.robot_serial != serial:
        raise ProjectError(
            make_message(
                "{where}: the parameters are of robot {found_serial}, the project is of {serial}.",
                where=where,
                found_serial=found.robot_serial,
                serial=serial,
            ),
            remedy="Export the set of this robot, or mend the serial.",
        )
    try:
        calibrated_model(nominal, found)
        values = {v.name: v.value for v in found.values if not v.name.startswith(_OF_PLACES)}
        state = starting_state(nominal, StartingPoint(values), (), np.eye(4), ())
        layout, covariance = _parameter_spread(found, state)
    except CellError as refused:
        raise ProjectError(
            make_message("{where}: {refused_message}", where=where, refused_message=refused.message),
            remedy=refused.remedy,
        ) from refused
    held_out = None if rms_mm is None else rms_mm / 1e3
    names = tuple(value.name for value in found.values if not value.determined)
    return IdentifiedArm(state, found.sha256, found.version, layout, covariance, held_out, names)


def _parameter_set(robot: RobotTable, folder: Path, where: str) -> ParameterSet | None:
    file, store, version = robot.parameters, robot.parameter_store, robot.parameter_version
    if file is not None and store is not None:
        raise ProjectError(
            make_message(
                "{where}: {name} and {other} exclude each other.",
                where=where,
                name="parameters",
                other="parameter_store",
            ),
            remedy="Leave one of the two out.",
        )
    if version is not None and store is None:
        raise ProjectError(
            make_message(
                "{where}: parameter_version is a whole number, beside parameter_store.", where=where
            ),
            remedy="Write parameter_store, too, or leave parameter_version out.",
        )
    if file is not None:
        path = (folder / file).resolve()
        return parse_set(_read_text(path), str(path))
    return (
        None if store is None else ParameterSets((folder / store).resolve()).load_set(robot.serial, version)
    )


def _parameter_spread(found: ParameterSet, state: ArmState) -> tuple[ParameterLayout | None, Array | None]:
    """Return the parameters of the arm that the set knows with all correlations, and their covariance."""
    whole = covariance_of(found)
    if whole is None:
        return None, None
    nominal = state.nominal
    layout = make_layout(nominal, "point", 1, level=GEOMETRY, terms=state.terms)
    names = [value.name for value in found.values]
    at = [i for i, name in enumerate(names) if not name.startswith(_OF_PLACES)]
    order = {p.name: i for i, p in enumerate(layout.parameters)}
    rows = np.array([order[names[i]] for i in at])
    covariance = np.zeros((len(layout), len(layout)))
    covariance[np.ix_(rows, rows)] = whole[np.ix_(at, at)]
    return layout, covariance


def _read_text(path: Path) -> str:
    try:
        return read_plain_text(path)
    except (OSError, DocumentError) as broken:
        raise ProjectError(describe_unreadable(path, broken)) from broken
