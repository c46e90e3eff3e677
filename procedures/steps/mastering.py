"""Steps that read what a robot knows about its motors."""

import asyncio
from dataclasses import replace

import numpy as np

from cellcal.calibration.arm.kinematics import MODEL_TOLERANCE_M, RobotModel
from cellcal.calibration.geometry import Pose
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import UnreachableError
from cellcal.drivers.interfaces import (
    Condition,
    Counts,
    DistanceGauge,
    Joints,
    MasteringData,
    Readiness,
)
from cellcal.procedures.cell import Cell
from cellcal.procedures.motors import Motors, MotorState, PositionLostAgainError, motor_store
from cellcal.procedures.robot_condition import read_reached_condition
from cellcal.procedures.run import NeedsUnmetError, RefusalError

BOOT_DEADLINE_S = 300.0
BOOT_PAUSE_S = 0.5
INSTRUCTION_S = 15.0  # what a turn costs besides its way where a person makes it: plans prefer few turns


async def read_motors_alone(cell: Cell) -> Motors:
    """Read identity, counts, mastering, gears and epoch; nothing of any instrument."""
    store = motor_store(cell)
    return Motors(
        identity=await cell.robot.identify(),
        condition=await read_reached_condition(cell.robot),
        counts=await store.encoder_counts(),
        joints_rad=(await cell.robot.read_joints()).joints_rad,
        mastering=await store.read_mastering(),
        drive=await store.drive_train(),
        epoch=await store.encoder_epoch(),
    )


async def read_motors(cell: Cell) -> MotorState:
    """Read identity, counts, mastering, gears and epoch, and where the wire is fixed."""
    store, gauge = motor_store(cell), length_gauge(cell)
    if cell.gauge_setup is None:
        raise NeedsUnmetError("the cell file does not say where the wire is fixed", missing=("gauge_setup",))
    condition, mastering = await read_reached_condition(cell.robot), await store.read_mastering()
    joints_rad = (await cell.robot.read_joints()).joints_rad
    if mastering.mastered and condition.readiness is Readiness.READY:
        refuse_other_model(nominal_model(cell), joints_rad, await cell.robot.flange_pose())
    return MotorState(
        identity=await cell.robot.identify(),
        condition=condition,
        model=nominal_model(cell).name,
        counts=await store.encoder_counts(),
        joints_rad=joints_rad,
        mastering=mastering,
        drive=await store.drive_train(),
        epoch=await store.encoder_epoch(),
        gauge_setup=cell.gauge_setup,
        gauge_range_m=gauge.capabilities.range_m,
        gauge_sigma_m=gauge.capabilities.sigma_m,
        limits=replace(cell.limits, settle_s=INSTRUCTION_S) if cell.is_jogged_by_hand else cell.limits,
    )


def model_error_m(model: RobotModel, joints_rad: Joints, base_flange: Pose) -> float:
    """Return how far the controller's own flange is from where the model puts it [m]."""
    ours = model.base_flange(np.array([joints_rad]))[0, :3, 3]
    return float(np.linalg.norm(ours - np.array(base_flange.position_m)))


def refuse_unhealthy(condition: Condition, mastering: MasteringData | None) -> None:
    """Refuse a robot that is not ready, or whose own mastering is not valid."""
    if condition.readiness is not Readiness.READY or (mastering is not None and not mastering.mastered):
        raise RefusalError(
            make_message(
                "the robot is not ready or not mastered: {condition_message}",
                condition_message=condition.message or "mastering data invalid",
            ),
            code="procedure.not_healthy",
            remedy="Clear what is wrong, then start a new run.",
        )


def refuse_other_model(model: RobotModel, joints_rad: Joints, base_flange: Pose) -> None:
    """Refuse a robot whose controller has its flange elsewhere than the model of the cell file."""
    error_m = model_error_m(model, joints_rad, base_flange)
    if error_m > MODEL_TOLERANCE_M:
        raise RefusalError(
            make_message(
                "the controller says its flange is {error_mm:.0f} mm from where a {model_name} has it",
                error_mm=error_m * 1000.0,
                model_name=model.label,
            ),
            code="procedure.wrong_model",
            remedy="Correct the robot's model in the cell file, then start a new run.",
        )


async def stored_record(cell: Cell) -> MasteringRecord:
    """Return the mastering record of this very robot."""
    record, identity = cell.record, await cell.robot.identify()
    if record is None:
        raise RefusalError(
            "no mastering record was taken before the loss: lost turns cannot be found by measurement",
            code="procedure.no_record",
            remedy="Master the robot by its marks or pins, then take a mastering record at once.",
        )
    if not record.is_measured:
        raise RefusalError(
            "the mastering record is from a controller's backup: it holds counts, and no lengths or places",
            code="procedure.no_record",
            remedy="If only the controller's memory was lost, type its counts in (`cellcal mastering show`). "
            "Else master the robot by its marks or pins, then take a mastering record at once.",
        )
    if record.robot_serial != identity.serial:
        raise RefusalError(
            make_message(
                "the record is of robot {robot_serial}, this is {serial}",
                robot_serial=record.robot_serial,
                serial=identity.serial,
            ),
            code="procedure.wrong_record",
            remedy="Import the record of this robot.",
        )
    return record


async def read_counts(cell: Cell) -> Counts:
    """Return the counts of all motors; between a loss and the index they only tell how far a motor turned."""
    return await motor_store(cell).encoder_counts()


async def read_alarms(cell: Cell) -> Condition:
    """Return the robot's condition in the maker's words."""
    return await read_reached_condition(cell.robot)


async def wait_for_robot(cell: Cell, gone: tuple[str, ...]) -> Condition:
    """Wait until the robot answers after a power cycle, without the alarms that the power cycle takes away.

    Who says yes before the switch is turned is waited for.
    """
    cell.motion.epoch = None  # a power cycle after a loss begins a new epoch
    condition = await cell.robot.read_condition()
    for _ in range(round(BOOT_DEADLINE_S / BOOT_PAUSE_S)):
        waiting = any(alarm.code in gone for alarm in condition.alarms)
        if condition.readiness is not Readiness.UNREACHABLE and not waiting:
            return condition
        await asyncio.sleep(BOOT_PAUSE_S)
        condition = await cell.robot.read_condition()
    if condition.readiness is not Readiness.UNREACHABLE:
        return condition
    raise UnreachableError(
        cell.robot.name,
        "the controller did not come back after the power cycle",
        remedy="Look at its screen.",
    )


async def check_same_epoch(cell: Cell, epoch: int) -> int:
    """Check that the encoders have not lost their position since ``epoch`` was read."""
    found = await motor_store(cell).encoder_epoch()
    if found != epoch:
        raise PositionLostAgainError(
            make_message(
                "the robot lost its position during this run (encoder epoch {epoch}, now {found})",
                epoch=epoch,
                found=found,
            ),
            remedy="Start the recovery anew; the points measured before cannot be combined with later ones.",
        )
    return found


async def reset_alarms(cell: Cell) -> Condition:
    """Acknowledge position alarms and say what is left."""
    await motor_store(cell).reset_position_alarms()
    cell.motion.epoch = None  # what follows is a new beginning for the encoders
    return await read_reached_condition(cell.robot)


def length_gauge(cell: Cell) -> DistanceGauge:
    """Return the cell's length gauge."""
    if cell.gauge is None:
        raise NeedsUnmetError("the cell has no length gauge", missing=("gauge",))
    return cell.gauge


def nominal_model(cell: Cell) -> RobotModel:
    """Return the robot's nominal model."""
    if cell.model is None:
        raise NeedsUnmetError("no kinematic model of the robot is known", missing=("model",))
    return cell.model
