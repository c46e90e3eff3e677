"""The first part of a recovery: from position alarms to encoders whose readings within a turn are known."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Condition, Counts, Instruction
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.lost_plans import index_travel
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.motion.turn_uncertainty import Turns, posture_uncertainty
from cellcal.procedures.questions import ask_confirmation, ask_to_move
from cellcal.procedures.run import ProcedureError, Run
from cellcal.procedures.setting_texts import describe_setting
from cellcal.procedures.steps.mastering import read_alarms, read_counts, reset_alarms, wait_for_robot
from cellcal.procedures.steps.motion import CountsToJoints, IndexTurn, pass_index

NEW_BATTERY = Instruction("new_battery", "Exchange the encoder batteries. Leave the brakes closed.")
POWER_CYCLE = Instruction("power_cycle", "Switch the controller off, wait ten seconds, switch it on again.")
SLOW_MOTION = Instruction(
    "may_move",
    "The robot does not know where it is. It will turn one joint after the other, slowly, by one motor turn "
    "each, and stay there. Look at the robot: is there room, and is the draw-wire free? May it move?",
)
SLOW_JOGS = Instruction(
    "may_move",
    "The robot does not know where it is. With the pendant, you turn one joint after the other, by about one and a "
    "half motor turns each. Look at the robot: is there room, and is the draw-wire free? May it move?",
)
ROUNDS = 5
INDEX_TURNS = 1.1
HAND_INDEX_TURNS = 1.4  # a person who stops short by a fifth has still passed it


class StillAlarmedError(ProcedureError):
    """The position alarms do not go away."""

    code = "procedure.still_alarmed"


@dataclass(frozen=True, slots=True)
class AlarmCodes:
    """The maker's names of alarms that a recovery knows how to answer."""

    battery: Annotated[
        tuple[str, ...],
        describe_setting("Battery alarms", "Alarms that say that an encoder battery is empty.", "technical"),
    ] = ("SRVO-062",)
    power_cycle: Annotated[
        tuple[str, ...],
        describe_setting(
            "Restart alarms", "Alarms that go away when the controller is switched off and on.", "technical"
        ),
    ] = ("SRVO-038",)
    index: Annotated[
        tuple[str, ...],
        describe_setting(
            "Index alarms", "Alarms that go away when the motor has turned past its index.", "technical"
        ),
    ] = ("SRVO-075",)


@dataclass(frozen=True, slots=True)
class IndexTurning:
    """The turns of motors past their index."""

    speed_rad_s: float
    room: MotionBounds
    doubt_turns: Turns


@dataclass(frozen=True, slots=True)
class ClearedEncoders:
    """Encoders that report no alarm."""

    lost: bool  # whether there were alarms: encoders that report nothing may have kept their position
    counts: Counts  # what healthy encoders would count now: the last healthy counts, and the turns since


@dataclass(frozen=True, slots=True)
class AlarmRound:
    """The number of looks at the alarms, and whether one of them said that a position was lost."""

    number: int = 0
    lost: bool = False


async def end_battery_alarms(run: Run, codes: AlarmCodes) -> AlarmRound:
    """Exchange batteries and restart the controller until only alarms are left that let the axes be jogged.

    For a robot that a person has to bring somewhere first: with a battery alarm it has no drive power.
    """
    alarm_round = AlarmRound()
    for k in range(1, ROUNDS):
        active, alarm_round = await _look_at_alarms(run, codes, alarm_round)
        if not active & {*codes.battery, *codes.power_cycle}:
            break
        await _restart_with_batteries(run, codes, active, k)
    return alarm_round


async def clear_position_alarms(
    run: Run,
    record: MasteringRecord,
    last_counts: Counts,
    codes: AlarmCodes,
    turning: IndexTurning,
    before: AlarmRound = AlarmRound(),
) -> ClearedEncoders:
    """Clear the position alarms: battery, power cycle, one turn of every motor past its index.

    Raises
    ------
    StillAlarmedError
        An alarm stays that this procedure cannot answer.
    """
    counts, alarm_round = last_counts, before
    for k in range(before.number + 1, ROUNDS + 1):
        active, alarm_round = await _look_at_alarms(run, codes, alarm_round)
        if active & {*codes.battery, *codes.power_cycle}:
            await _restart_with_batteries(run, codes, active, k)
        elif active & {*codes.index}:
            counts = await _pass_indices(run, record, counts, k, turning)
        elif active:
            await run.write(f"reset the alarms {k}", reset_alarms)
        else:
            break
    await run.ensure("no alarm is left", check_no_alarm)
    return ClearedEncoders(alarm_round.lost, counts)


async def _look_at_alarms(run: Run, codes: AlarmCodes, seen: AlarmRound) -> tuple[set[str], AlarmRound]:
    condition = await run.step(f"look at the alarms {seen.number + 1}", read_alarms)
    active = {alarm.code for alarm in condition.alarms}
    lost = bool(active & {*codes.battery, *codes.power_cycle, *codes.index})
    return active, AlarmRound(seen.number + 1, seen.lost or lost)


async def _restart_with_batteries(run: Run, codes: AlarmCodes, active: set[str], k: int) -> None:
    if active & {*codes.battery}:
        await run.step(f"new battery {k}", ask_confirmation, NEW_BATTERY)
    await run.write(f"acknowledge the lost position {k}", reset_alarms)
    await run.step(f"power cycle {k}", ask_confirmation, POWER_CYCLE)
    gone = (*codes.battery, *codes.power_cycle)
    await run.step(f"wait for the robot {k}", wait_for_robot, gone)


async def check_no_alarm(cell: Cell) -> Condition:
    """Refuse while an alarm stands; asked again on every entry, since a person may have cleared it meanwhile."""
    condition = await read_alarms(cell)
    if condition.alarms:
        raise StillAlarmedError(
            make_message(
                "the robot still reports {alarms}",
                alarms=", ".join(sorted({alarm.code for alarm in condition.alarms})),
            ),
            remedy="Clear the alarm by the controller's manual, then resume.",
        )
    return condition


async def _pass_indices(
    run: Run, record: MasteringRecord, last_counts: Counts, k: int, turning: IndexTurning
) -> Counts:
    """Turn every motor past its index: a controller names its newest alarms only, so all axes are suspect.

    J1 first: a wrist motor turns the joints after it too. Returns what healthy encoders would count afterwards.
    """
    healthy = CountsToJoints(record.drive, record.counts_at_zero, (0,) * len(last_counts))
    last_joints = healthy.joints_at(last_counts)
    turns = HAND_INDEX_TURNS if run.is_jogged_by_hand else INDEX_TURNS
    known_values = (record, last_joints, turns, turning.room, turning.doubt_turns)
    travel = await run.solve(f"plan the turns {k}", index_travel, *known_values)
    doubt = posture_uncertainty(record.drive, turning.doubt_turns)
    await run.step(f"slow motion {k}", ask_to_move, SLOW_JOGS if run.is_jogged_by_hand else SLOW_MOTION)
    before = await run.step(f"counts before the turns {k}", read_counts)
    for axis in range(len(last_counts)):
        name = f"turn J{axis + 1} past its encoder mark, {k}"
        turn = IndexTurn(axis, travel[axis], before, last_joints, doubt)
        await run.move(name, pass_index, turn, turning.speed_rad_s)
    await run.write(f"clear the alarms {k}", reset_alarms)
    there = np.add(last_joints, travel)
    return tuple(int(count) for count in record.drive.to_counts(there, np.array(record.counts_at_zero)))
