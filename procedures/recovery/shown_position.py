"""The position of a robot as its controller shows it: lost axes, values, and motors that shown joints stand for."""

from dataclasses import dataclass, replace

from cellcal.calibration.mastering.position_record import ArmPositionRecord, ShownValue
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import AlarmKind, Condition, PositionCure, Readiness
from cellcal.procedures.cell import Cell, MotionLevel
from cellcal.procedures.robot_condition import read_reached_condition
from cellcal.procedures.run import NeedsUnmetError, RefusalError


@dataclass(frozen=True, slots=True)
class AxisState:
    """The position data of an axis that the controller reports at one moment."""

    lost_axes: tuple[int, ...]  # 0-based; empty also where a loss is shown and no axis is named
    is_lost: bool
    words: str
    cure: PositionCure
    without_zero: tuple[int, ...] = ()  # of the lost ones: their zero has to be made anew


def with_shown_motors(cell: Cell) -> Cell:
    """Return the cell with the motors that shown joints tell.

    They are jogged by slow joint moves where this software moves the robot and its controller goes that slow, else by
    a person.
    """
    motors = cell.shown_motors
    if motors is None:
        raise NeedsUnmetError("the gears of this robot are not in the cell file", missing=("drive_data",))
    commanded = cell.level is MotionLevel.COMMANDED and cell.robot.capabilities.moves_slowly
    return replace(cell, mastering=motors, jogs=motors if commanded else None)


async def read_position_data(cell: Cell) -> tuple[ShownValue, ...]:
    """Return what the controller shows about the position."""
    if cell.position_data is None:
        raise NeedsUnmetError("this robot's controller shows no position data", missing=("position_cure",))
    return await cell.position_data.position_data()


async def read_axis_state(cell: Cell) -> AxisState:
    """Return which axes the controller shows as lost."""
    cure = cell.robot.capabilities.position_cure
    if cure is None:
        raise NeedsUnmetError("no cure at the pendant is known", missing=("position_cure",))
    condition = await read_reached_condition(cell.robot)
    lost = _axes_of(condition, AlarmKind.TURNS)
    counters = cure is PositionCure.REVOLUTION_COUNTERS  # of which an axis without calibration has none
    without_zero = _axes_of(condition, AlarmKind.ENCODER) if counters else set()
    return AxisState(
        tuple(sorted(lost | without_zero)),
        condition.readiness is Readiness.POSITION_LOST,
        condition.message,
        cure,
        tuple(sorted(without_zero)),
    )


def _axes_of(condition: Condition, kind: AlarmKind) -> set[int]:
    return {alarm.axis for alarm in condition.alarms if alarm.kind is kind and alarm.axis is not None}


async def stored_position_record(cell: Cell) -> ArmPositionRecord:
    """Return the position record of this very robot."""
    record, serial = cell.position_record, (await cell.robot.identify()).serial
    if record is None:
        raise RefusalError(
            "no position record was taken before the loss: nothing can be proved by measurement",
            code="procedure.no_record",
            remedy="Bring the position back as the maker says, then take a position record at once.",
        )
    measured, motors = record.measured, cell.shown_motors
    if measured.robot_serial != serial:
        raise RefusalError(
            make_message(
                "the record is of robot {robot_serial}, this is {serial}",
                robot_serial=measured.robot_serial,
                serial=serial,
            ),
            code="procedure.wrong_record",
            remedy="Import the record of this robot.",
        )
    if motors is not None and await motors.drive_train() != measured.drive:
        raise RefusalError(
            "the gear ratios of the cell file are not those of the record",
            code="procedure.wrong_record",
            remedy="Compare motor_turns_per_joint_turn with the data sheet, and correct the cell file.",
        )
    return record
