"""The motors of a robot as a procedure reads them, and the devices that read and move them."""

from dataclasses import dataclass

from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.drivers.interfaces import (
    Condition,
    Counts,
    Identity,
    JogsAxes,
    Joints,
    MasteringData,
    MasteringStore,
)
from cellcal.procedures.cell import Cell, GaugeSetup, MotionCaps
from cellcal.procedures.run import NeedsUnmetError, ProcedureError


class PositionLostAgainError(ProcedureError):
    """The encoders lost their position while the run was under way: its captures cannot be combined."""

    code = "procedure.position_lost_again"


@dataclass(frozen=True, slots=True)
class MotorState:
    """The state that the controller reports at one moment."""

    identity: Identity
    condition: Condition
    model: str
    counts: Counts
    joints_rad: Joints
    mastering: MasteringData
    drive: DriveTrain
    epoch: int
    gauge_setup: GaugeSetup
    gauge_range_m: float
    gauge_sigma_m: float
    limits: MotionCaps


@dataclass(frozen=True, slots=True)
class Motors:
    """The controller's values of its motors, in a cell with or without a draw-wire."""

    identity: Identity
    condition: Condition
    counts: Counts
    joints_rad: Joints
    mastering: MasteringData
    drive: DriveTrain
    epoch: int


def motor_store(cell: Cell) -> MasteringStore:
    """Return the robot's mastering, which the catalogue has made sure of."""
    if cell.mastering is None:
        raise NeedsUnmetError("the robot's mastering is out of reach", missing=("writes_mastering",))
    return cell.mastering


def axis_jog(cell: Cell) -> JogsAxes:
    """Return the robot's jog."""
    if cell.jogs is None:
        raise NeedsUnmetError("the robot does not jog single axes", missing=("jogs_single_axes",))
    return cell.jogs
