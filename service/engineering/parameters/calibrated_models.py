"""From parameter sets to robot models and back: which value belongs to which number of the geometry."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.arm.mounting import FLOOR
from cellcal.calibration.arm.urdf import calibrated_urdf, read_urdf
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix, inverse_transform
from cellcal.calibration.identification.estimator import ArmFit
from cellcal.calibration.identification.identifiability import is_learnt, parameter_correlations
from cellcal.calibration.identification.layouts import make_layout
from cellcal.calibration.identification.parameters import GEOMETRY
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import elementary_rotation
from cellcal.service.engineering.parameters.parameter_set import (
    ParameterSet,
    ParameterSetError,
    ParameterValue,
)

_ROUNDED = 1e-6  # of an eigenvalue of stored correlations
_SAME_AXIS = 1e-3  # m and rad: descriptions round their numbers
_NAME_LINKS = (
    "Name the link at the flange (--tip-link), and the robot's base where the description begins elsewhere "
    "(--base-link)."
)


class IdentifiedLike(Protocol):
    """A parameter as an identification reports it."""

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def value(self) -> float: ...
    @property
    def sigma(self) -> float: ...
    @property
    def prior(self) -> float: ...


@dataclass(frozen=True, eq=False)
class CalibratedModel:
    """A nominal model with the deviations of a set, and the values that a rigid model has no place for."""

    model: RobotModel
    left_out: tuple[str, ...]


def nominal_sha256(model: RobotModel) -> str:
    """Return a hash of everything in a nominal model that deviations refer to."""
    parts = [model.placements.ravel(), model.theta0_rad, model.joint_coupling.ravel()]
    if model.gravity_in_base != FLOOR:  # sets of robots on the floor keep the hash that they have always had
        parts.append(np.array(model.gravity_in_base))
    numbers = np.concatenate(parts, dtype=np.float64)
    return hashlib.sha256(" ".join(f"{v:.12g}" for v in numbers + 0.0).encode()).hexdigest()


def calibrated_model(nominal: RobotModel, parameter_set: ParameterSet) -> CalibratedModel:
    """Return the nominal model moved by a set.

    Raises
    ------
    ParameterSetError
        The set belongs to another nominal model, or to other numbers under the same name.
    """
    if parameter_set.model != nominal.name or parameter_set.nominal_sha256 != nominal_sha256(nominal):
        raise ParameterSetError(
            make_message(
                "version {version} of robot {robot_serial} refers to another nominal model than {model} as it is "
                "here.",
                version=parameter_set.version,
                robot_serial=parameter_set.robot_serial,
                model=nominal.name,
            ),
            remedy="Identify again, or use the release with which the set was made.",
        )
    entries = _geometry_entries(nominal)
    errors = np.zeros((nominal.axis_count, 5) if nominal.dh is not None else (nominal.axis_count + 1, 6))
    left_out = []
    for value in parameter_set.values:
        entry = entries.get(value.name)
        if entry is None:
            left_out.append(value.name)
        else:
            errors[entry] = value.value
    moved = nominal.with_dh_errors(errors) if nominal.dh is not None else nominal.with_twists(errors)
    return CalibratedModel(moved, tuple(left_out))


def values_of_model(nominal: RobotModel, model: RobotModel) -> tuple[ParameterValue, ...]:
    """Return how a model with a DH table deviates from nominal; its uncertainty is unknown."""
    if nominal.dh is None or model.dh is None or model.axis_count != nominal.axis_count:
        raise CalibrationError(
            make_message(
                "{label}: deviations need two models with tables of the same length", label=model.label
            )
        )
    errors = model.dh.to_rows() - nominal.dh.to_rows()
    units = {0: "rad", 1: "m", 2: "m", 3: "rad", 4: "rad"}
    return tuple(
        ParameterValue(name, units[entry[1]], float(errors[entry]))
        for name, entry in _geometry_entries(nominal).items()
    )


def values_of_identification(
    parameters: Iterable[IdentifiedLike], fit: ArmFit | None = None
) -> tuple[ParameterValue, ...]:
    """Return what an identification found, with its standard uncertainties; from its fit, correlations too."""
    some = list(parameters)
    rho = np.eye(len(some))
    if fit is not None:
        at = {p.name: i for i, p in enumerate(fit.layout.parameters)}
        mine = [i for i, p in enumerate(some) if p.name in at]
        theirs = [at[some[i].name] for i in mine]
        rho[np.ix_(mine, mine)] = parameter_correlations(fit)[np.ix_(theirs, theirs)]
    clipped = np.clip(rho, -1.0, 1.0)
    return tuple(
        ParameterValue(
            p.name,
            p.unit,
            float(p.value),
            float(p.sigma),
            tuple(clipped[i, :i].tolist()) if fit else (),
            determined=is_learnt(p.sigma, p.prior),
        )
        for i, p in enumerate(some)
    )


def covariance_of(parameter_set: ParameterSet) -> Array | None:
    """Return the covariance of a set's values (k, k), or None if it does not hold it.

    Raises
    ------
    ParameterSetError
        Correlations that contradict each other.
    """
    values = parameter_set.values
    complete = all(len(v.correlations) == i and v.standard_uncertainty for i, v in enumerate(values))
    if not complete or len(values) < 2:
        return None
    rho = np.eye(len(values))
    for i, value in enumerate(values):
        rho[i, :i] = rho[:i, i] = value.correlations
    if float(np.linalg.eigvalsh(rho)[0]) < -_ROUNDED:
        raise ParameterSetError(
            make_message(
                "version {version} of robot {robot_serial}: its correlations contradict each other.",
                version=parameter_set.version,
                robot_serial=parameter_set.robot_serial,
            )
        )
    sigma = np.array([value.standard_uncertainty for value in values], dtype=float)
    covariance: Array = rho * np.outer(sigma, sigma)
    return covariance


def _geometry_entries(nominal: RobotModel) -> dict[str, tuple[int, int]]:
    layout = make_layout(nominal, "point", 1, level=GEOMETRY)
    names = [p.name for p in layout.parameters if p.role in ("offset", "geometry")]
    return dict(zip(names, layout.geometry, strict=True))


def calibrated_description(
    text: str, tip_link: str, nominal: RobotModel, calibrated: RobotModel, *, base_link: str | None = None
) -> str:
    """Return a URDF description whose joints stand where a calibration found them; the rest of it stays.

    The frames of the description may lie anywhere along the joints' axes. They keep their place relative to
    the nominal arm's frames, and those move. Without a base link the description's root is the robot's base.

    Raises
    ------
    CalibrationError
        The axes of the description are not those of the nominal model.
    """
    arm = read_urdf(text, tip_link=tip_link, base_link=base_link)
    robot = nominal.label
    if arm.model.axis_count != nominal.axis_count:
        raise CalibrationError(
            make_message(
                "between these links the description has {axis_count} joints, {robot} has {own_axis_count}.",
                axis_count=arm.model.axis_count,
                robot=robot,
                own_axis_count=nominal.axis_count,
            ),
            remedy=_NAME_LINKS,
        )
    ours, theirs = _joint_steps(nominal), _joint_steps(arm.model)
    beside = np.array(
        [inverse_transform(a) @ b for a, b in zip(_chain_steps(ours), _chain_steps(theirs), strict=True)]
    )
    off_axis = np.abs(beside[:-1, :2, 2:]).max()
    directions = np.sign(np.diag(nominal.joint_coupling))
    if off_axis > _SAME_AXIS or not np.allclose(beside[:-1, 2, 2], directions, atol=_SAME_AXIS):
        raise CalibrationError(
            make_message("the joints of the description are not where those of {robot} are.", robot=robot),
            remedy=_NAME_LINKS,
        )
    before = np.concatenate([np.eye(4)[None], inverse_transform(beside[:-1])])
    placements = before @ _joint_steps(calibrated) @ beside
    moved = replace(arm.model, placements=placements)
    return calibrated_urdf(arm, moved)


def _joint_steps(model: RobotModel) -> Array:
    """Return (n + 1, 4, 4): from the frame in which a joint turns to the next, all joints at zero."""
    turns = [
        homogeneous_matrix(elementary_rotation("z", np.array(t)), np.zeros(3))
        for t in (*model.theta0_rad, 0.0)
    ]
    return np.array([p @ t for p, t in zip(model.placements, turns, strict=True)])


def _chain_steps(steps: Array) -> Array:
    frames = [steps[0]]
    for step in steps[1:]:
        frames.append(frames[-1] @ step)
    return np.array(frames)
