"""A robot before one device that sees its flange: a draw-wire hooked to it, or a tracker and its target.

Shared by the calibration, the accuracy check and the drift check: what is read before anything moves, one capture,
and what captures mean to the mathematics.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.observations import Observations
from cellcal.calibration.identification.parameters import GRAVITY, Priors
from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.message import make_message
from cellcal.calibration.poses.arm_fit import ArmTask
from cellcal.drivers.interfaces import Counts, Instruction, Joints
from cellcal.procedures.cell import Cell, MotionCaps
from cellcal.procedures.forecast import Knowledge
from cellcal.procedures.motion.robot_readiness import check_position_kept
from cellcal.procedures.procedure_definition import NEEDS
from cellcal.procedures.robot_condition import read_reached_condition
from cellcal.procedures.run import NeedsUnmetError, RefusalError
from cellcal.procedures.steps.capture import SPREAD_SIGMAS
from cellcal.procedures.steps.length import LengthCapture, capture_length
from cellcal.procedures.steps.mastering import (
    length_gauge,
    nominal_model,
    refuse_other_model,
    refuse_unhealthy,
)
from cellcal.procedures.steps.measure_point import PointCapture, measure_point, tracker_of

Method = Literal["wire", "tracker"]
Triple = tuple[float, float, float]
ArmCapture = LengthCapture | PointCapture

ARM_SIGMA_M = 8e-5  # of one coordinate: what gears, backlash and settling leave that no parameter describes
READY = {
    "wire": Instruction(
        "wire_is_hooked",
        "Hook the draw-wire to the flange, its mouth towards the middle of the robot's work; "
        "nothing may touch the wire.",
    ),
    "tracker": Instruction(
        "target_is_mounted",
        "Mount the tracker's target on the flange so that the tracker sees it; keep people out of the beam.",
    ),
}


@dataclass(frozen=True, slots=True)
class Bench:
    """The robot and its device before a series."""

    method: Method
    serial: str
    model: str
    joints_rad: Joints
    counts_at_zero: Counts  # empty where the robot keeps none
    drive: DriveTrain | None  # None where the robot's mastering is out of reach
    epoch: int | None
    target_in_flange_m: Triple  # hook or reflector, by a ruler
    anchor_in_base_m: Triple  # of the wire; zero for a tracker
    range_m: float
    sigma_m: float  # of one coordinate of a reading
    limits: MotionCaps

    def nominal_model(self) -> RobotModel:
        """Return the arm as its maker draws it."""
        return load_model(self.model)

    def make_task(
        self, level: int = GRAVITY, priors: Priors | None = None, arm_sigma_m: float = ARM_SIGMA_M
    ) -> ArmTask:
        """Return what a fit of this robot's captures is about."""
        noise = self.sigma_m / 2.0 if self.method == "wire" else self.sigma_m
        task = ArmTask(
            model=self.model,
            kind="length" if self.method == "wire" else "point",
            sigma_m=math.hypot(noise, arm_sigma_m),
            target_in_flange_m=self.target_in_flange_m,
            anchor_in_base_m=self.anchor_in_base_m,
            level=level,
        )
        return task if priors is None else replace(task, priors=priors)


async def read_healthy_arm(cell: Cell) -> tuple[RobotModel, Joints]:
    """Return the arm as it is drawn and where it stands; refuse one not ready, not mastered, or another model."""
    condition = await read_reached_condition(cell.robot)
    mastering = None if cell.mastering is None else await cell.mastering.read_mastering()
    refuse_unhealthy(condition, mastering)
    model = nominal_model(cell)
    joints_rad = (await cell.robot.read_joints()).joints_rad
    refuse_other_model(model, joints_rad, await cell.robot.flange_pose())
    return model, joints_rad


async def read_bench(cell: Cell, method: Method) -> Bench:
    """Read who the robot is and where it stands; refuse one that is not ready, not mastered, or another model."""
    model, joints_rad = await read_healthy_arm(cell)
    identity = await cell.robot.identify()
    mastering = None if cell.mastering is None else await cell.mastering.read_mastering()
    target, anchor, range_m, sigma_m = _device_of(cell, method)
    return Bench(
        method=method,
        serial=identity.serial,
        model=model.name,
        joints_rad=joints_rad,
        counts_at_zero=() if mastering is None else mastering.counts_at_zero,
        drive=None if cell.mastering is None else await cell.mastering.drive_train(),
        epoch=None if cell.mastering is None else await cell.mastering.encoder_epoch(),
        target_in_flange_m=target,
        anchor_in_base_m=anchor,
        range_m=range_m,
        sigma_m=sigma_m,
        limits=cell.limits,
    )


def _device_of(cell: Cell, method: Method) -> tuple[Triple, Triple, float, float]:
    if method == "wire":
        at, can = cell.gauge_setup, length_gauge(cell).capabilities
        if at is None:
            raise _missing_setup_error("gauge_setup", "Say in cell.toml where the wire is fixed and hooked.")
        return at.hook_in_flange_m, at.anchor_in_base_m, can.range_m, can.sigma_m
    setup, sees = cell.tracker_setup, tracker_of(cell).capabilities
    if setup is None:
        raise _missing_setup_error("tracker_setup", "Say in cell.toml where the target sits on the flange.")
    return setup.target_in_flange_m, (0.0, 0.0, 0.0), sees.range_m, sees.sigma_m


def _missing_setup_error(need: str, remedy: str) -> NeedsUnmetError:
    return NeedsUnmetError(
        make_message("this cell does not say {needs}", needs=NEEDS[need][0]),
        missing=(NEEDS[need][0],),
        remedy=remedy,
    )


async def check_same_robot(cell: Cell, epoch: int | None) -> int | None:
    """Check that the encoders have not lost their position; one that tells no epoch says at least what it knows."""
    if epoch is None or cell.mastering is None:
        await check_position_kept(cell)
        return None
    found = await cell.mastering.encoder_epoch()
    if found != epoch:
        raise RefusalError(
            make_message(
                "the robot lost its position during this run (encoder epoch {epoch}, now {found})",
                epoch=epoch,
                found=found,
            ),
            code="procedure.position_lost_again",
            remedy="Run mastering_recovery; what was measured before cannot be combined with later captures.",
        )
    return found


async def capture_arm(cell: Cell, label: str, samples: int, method: Method, *, target: int = 0) -> ArmCapture:
    """Let the arm settle and measure its target once more, several readings averaged."""
    if method == "wire":
        return replace(await capture_length(cell, label, samples), target=target)
    return replace(await measure_point(cell, label, samples), target=target)


def values_of(captures: tuple[ArmCapture, ...]) -> Array:
    """Return what was measured, (N, 1) lengths or (N, 3) places [m].

    Raises
    ------
    RefusalError
        A tracker stood at more than one station.
    """
    stations = {capture.station for capture in captures if isinstance(capture, PointCapture)}
    if len(stations) > 1:
        raise RefusalError(
            "the tracker was moved to another station during the series: its places are of two frames",
            code="procedure.station_moved",
            remedy="Leave the tracker where it stands and start a new run.",
        )
    return np.array([[c.length_m] if isinstance(c, LengthCapture) else list(c.position_m) for c in captures])


def noise_m(capture: ArmCapture) -> float:
    """Return the standard deviation [m] of one coordinate of a capture, as its device states it."""
    if isinstance(capture, LengthCapture):
        return capture.sigma_m
    return math.sqrt(float(np.trace(np.array(capture.covariance_m2))) / 3.0)


def station_of(captures: tuple[ArmCapture, ...]) -> int:
    """Return from which station a tracker saw these; 0 for a wire."""
    return next((capture.station for capture in captures if isinstance(capture, PointCapture)), 0)


def joints_of(captures: tuple[ArmCapture, ...], axes: int) -> Array:
    """Return the joints (N, n) of captures [rad]."""
    return np.array([capture.joints_rad for capture in captures], dtype=float).reshape(-1, axes)


def observations_of(task: ArmTask, captures: tuple[ArmCapture, ...]) -> Observations:
    """Return captures as rows of a fit."""
    targets = [capture.target for capture in captures]
    return task.to_observations(
        joints_of(captures, task.nominal_model().axis_count), values_of(captures), targets
    )


def of_target(captures: tuple[ArmCapture, ...], target: int) -> tuple[ArmCapture, ...]:
    """Return the captures of one target: 0 is that on the flange, then come the points of the end-effector."""
    return tuple(capture for capture in captures if capture.target == target)


def distance_m(one: ArmCapture, other: ArmCapture) -> float:
    """Return how far two captures of one pose are from each other [m]."""
    values = values_of((one, other))
    return float(np.linalg.norm(values[1] - values[0]))


def captures_agree(one: ArmCapture, other: ArmCapture, sigma_m: float) -> bool:
    """Return whether two captures of one pose may be of the same place."""
    return distance_m(one, other) <= SPREAD_SIGMAS * sigma_m


def declared_bench(knowledge: Knowledge, method: Method) -> Bench | None:
    """Return the robot as it is assumed before its controller is read; None where too little is known of the cell."""
    if knowledge.model is None:
        return None
    device = _declared_device(knowledge, method)
    if device is None:
        return None
    target, anchor, range_m, sigma_m = device
    return Bench(
        method=method,
        serial="" if knowledge.record is None else knowledge.record.robot_serial,
        model=knowledge.model.name,
        joints_rad=(0.0,) * knowledge.model.axis_count,
        counts_at_zero=(),
        drive=None,
        epoch=None,
        target_in_flange_m=target,
        anchor_in_base_m=anchor,
        range_m=range_m,
        sigma_m=sigma_m,
        limits=knowledge.limits,
    )


def _declared_device(knowledge: Knowledge, method: Method) -> tuple[Triple, Triple, float, float] | None:
    if method == "wire":
        if knowledge.gauge_setup is None or knowledge.gauge is None:
            return None
        at = knowledge.gauge_setup
        return at.hook_in_flange_m, at.anchor_in_base_m, knowledge.gauge.range_m, knowledge.gauge.sigma_m
    if knowledge.tracker_setup is None or knowledge.tracker is None:
        return None
    sees = knowledge.tracker
    return knowledge.tracker_setup.target_in_flange_m, (0.0, 0.0, 0.0), sees.range_m, sees.sigma_m
