"""A simulated robot made like the real one: zero positions and tool from two paths of the same tags.

The first path is what the robot thinks (its joints at each tag), the second what a device measured there. Where the
device stands is found, too. F. S. Cheng, Calibration of Robot Reference Frames, 2008, 5.1.
"""

import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array, Pose, homogeneous_matrix
from cellcal.calibration.identification.cross_validation import ErrorSummary
from cellcal.calibration.identification.identify import Identification, identify_arm
from cellcal.calibration.identification.misfit import refuse_gross_misfit, refuse_misfit
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.parameters import OFFSETS
from cellcal.calibration.identification.selection import IdentificationOptions
from cellcal.calibration.message import make_message
from cellcal.calibration.points.tag_placement import SpatialUncertainty, spatial_uncertainty
from cellcal.calibration.points.tag_points import TagPairs, refuse_other_size
from cellcal.calibration.uncertainty import coverage_factor

LEAST_TAGS = 12
_SIGMA_M = 3e-4  # weighs the rows alike; the residuals tell the rest
_TOOL_TELLS = 1.0  # of the spread: a long tool may double how far its tip goes
_SAME_POSE_M = 0.002  # what a controller's own figures may differ from its nominal model


@dataclass(frozen=True, slots=True)
class FoundValue:
    """One deviation of the real robot from its model."""

    name: str
    unit: str
    value: float
    standard_uncertainty: float
    prior: float


@dataclass(frozen=True, slots=True)
class UnidentifiedValue:
    """A value that the tags cannot determine, what it hides behind, and what would show it."""

    name: str
    partner: str
    cure: str


@dataclass(frozen=True, slots=True)
class SimulatedRobot:
    """The model's zero positions and tool as the tags have them."""

    model: str
    values: tuple[FoundValue, ...]
    flange_tool: Pose  # the target's place; its attitude is the flange's own
    tool: SpatialUncertainty  # how well its place is known [m]
    device_base: Pose  # where the device stands: the robot's base seen from it
    device_moved_m: float | None  # from the start guess; None without one
    degrees_of_freedom: float
    before: ErrorSummary  # tool and place fitted, the arm as in the simulation; tags that were not fitted
    after: ErrorSummary  # the same with the found zero positions
    fit_rms_m: float
    tags: int
    rejected: tuple[str, ...]
    unpaired: tuple[str, ...]
    unknowable: tuple[UnidentifiedValue, ...]
    remarks: tuple[str, ...]

    @property
    def coverage_factor(self) -> float:
        """The factor from a standard uncertainty to 95 %."""
        return coverage_factor(max(self.degrees_of_freedom, 1.0))

    @property
    def is_better(self) -> bool:
        """Whether tags that were not fitted are met better than before."""
        return self.after.rmse_m < self.before.rmse_m


def calibrate_simulated_robot(
    model: RobotModel, pairs: TagPairs, *, level: int = OFFSETS, start_guess: Pose | None = None
) -> tuple[SimulatedRobot, RobotModel]:
    """Find zero positions, tool and device from the robot's tags and the measured ones.

    Parameters
    ----------
    model : RobotModel
        The simulation's.
    pairs : Pairs
        The robot's path, which tells joints, and the measured one [m].
    level : int
        1 zero positions, as in the text; 2 the whole geometry.
    start_guess : Pose, optional
        device_base as the simulation has it: only compared with, the start is found from the tags.

    Returns
    -------
    SimulatedRobot, RobotModel
        What was found, and the calibrated model.

    Raises
    ------
    DegenerateDataError
        Fewer than `LEAST_TAGS` tags in common.
    CalibrationError
        No joints, another number of them, another unit, or joints that do not belong to the controller's poses.
    """
    joints = _tag_joints(model, pairs)
    nominal = model.base_flange(joints)
    remarks = _against_controller(pairs, nominal)
    measured = pairs.other.to_positions()
    refuse_other_size(
        nominal[:, :3, 3], measured, (pairs.one.source, pairs.other.source), tolerance=_TOOL_TELLS
    )
    found = _identify_tags(model, joints, measured, level)
    state, fit = found.state, found.robust.fit
    names = [p.name for p in fit.layout.parameters]
    tool = [names.index(f"tool {axis}") for axis in "xyz"]
    spread = np.sqrt(np.diag(fit.covariance)) if len(fit.covariance) else np.zeros(len(names))
    values = [
        FoundValue(p.name, p.unit, float(value), float(sigma), p.prior)
        for p, value, sigma in zip(fit.layout.parameters, fit.deviations, spread, strict=True)
        if p.role in ("offset", "geometry")
    ]
    device_base = Pose.from_matrix(state.devices[0].device_base)
    freedom = max(found.robust.degrees_of_freedom, 1.0)
    result = SimulatedRobot(
        model=model.name,
        values=tuple(values),
        flange_tool=Pose.from_matrix(homogeneous_matrix(np.eye(3), state.flange_tool[:3, 3])),
        tool=spatial_uncertainty(fit.covariance[np.ix_(tool, tool)], freedom),
        device_base=device_base,
        device_moved_m=None
        if start_guess is None
        else math.dist(start_guess.position_m, device_base.position_m),
        degrees_of_freedom=freedom,
        before=found.before_errors,
        after=found.held_out,
        fit_rms_m=found.fit_errors.rmse_m,
        tags=len(pairs.one),
        rejected=tuple(pairs.one.tag_label(int(row)) for row in found.rejected),
        unpaired=pairs.unpaired,
        unknowable=tuple(UnidentifiedValue(n.parameter, n.partner, n.cure) for n in found.not_identified),
        remarks=remarks,
    )
    return result, state.arm_model


def _identify_tags(model: RobotModel, joints: Array, measured: Array, level: int) -> Identification:
    """Identify; a device that was moved during the path is no part of the method, so none is looked for."""
    rows = PointObservations(
        joints, measured, np.full(len(joints), _SIGMA_M), np.zeros(len(joints), dtype=np.intp)
    )
    refuse_misfit(model, rows)
    found = identify_arm(model, rows, options=IdentificationOptions(level=level, find_breaks=False))
    refuse_gross_misfit(model, rows, found.judgement.held_out_m)
    return found


def _tag_joints(model: RobotModel, pairs: TagPairs) -> Array:
    robot = pairs.one
    if not robot.joints_rad:
        raise CalibrationError(
            make_message(
                "{source} tells no joints: a pose alone does not tell how the arm stood.", source=robot.source
            ),
            remedy="Export the robot's path with the joint values of each tag.",
        )
    joints = np.array(robot.joints_rad)
    if joints.shape[1] != model.axis_count:
        raise CalibrationError(
            make_message(
                "{source} has {count} joints, {model} has {axis_count}.",
                source=robot.source,
                count=joints.shape[1],
                model=model.name,
                axis_count=model.axis_count,
            ),
            remedy="Name the columns of the joints, or another model.",
        )
    if len(joints) < LEAST_TAGS:
        raise DegenerateDataError(
            make_message(
                "{joint_count} tags are too few to find zero positions and to check them.",
                joint_count=len(joints),
            ),
            remedy=make_message(
                "Measure {least_tags} tags or more, better 30, moving every joint as far as possible.",
                least_tags=LEAST_TAGS,
            ),
        )
    return joints


def _against_controller(pairs: TagPairs, nominal: Array) -> tuple[str, ...]:
    """Compare the controller's own poses with the model: the same tool point must carry one to the other."""
    robot = pairs.one
    if not robot.quaternions:
        return ()
    controller_rotations = robot.to_rotations()
    at = np.einsum("nji,nj->ni", nominal[:, :3, :3], robot.to_positions() - nominal[:, :3, 3])
    turn = np.swapaxes(nominal[:, :3, :3], 1, 2) @ controller_rotations
    spread_m = float(np.linalg.norm(at - np.median(at, axis=0), axis=1).max())
    turned = float(np.abs(turn - turn[0]).max())
    if spread_m > _SAME_POSE_M or turned > 0.01:
        raise CalibrationError(
            make_message(
                "the joints of {source} do not belong to its poses by the model: the tool would wander by "
                "{wander_mm:.2f} mm.",
                source=robot.source,
                wander_mm=spread_m * 1e3,
            ),
            remedy="Choose the robot's own model; see the units of the joints and how J2 and J3 are coupled.",
        )
    return (
        make_message(
            "the robot's poses agree with its joints and the model within {spread_mm:.3f} mm",
            spread_mm=spread_m * 1e3,
        ),
    )
