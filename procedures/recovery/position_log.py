"""Whether a position was lost while a run was interrupted: lengths from before and after would be of two positions.

A controller that knows where its axes are says nothing of a loss that was brought back meanwhile; its log does.
"""

from dataclasses import dataclass
from typing import cast

from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Instruction, KeepsPositionHistory
from cellcal.procedures.cell import Cell
from cellcal.procedures.questions import ask_confirmation
from cellcal.procedures.run import RefusalError

POSITION_KEPT = Instruction(
    "position_kept",
    "This run was interrupted after its lengths were begun, and the controller's log does not tell what happened "
    "since. Was no axis mastered, calibrated or updated, and no position lost, since then?",
)


@dataclass(frozen=True, slots=True)
class LogPlace:
    """The newest entries of a controller's log; ``is_kept``: whether it keeps one that tells of lost positions."""

    marks: tuple[str, ...]
    is_kept: bool


async def note_log_place(cell: Cell) -> LogPlace:
    """Return where the controller's log stands now."""
    if not cell.robot.capabilities.keeps_position_history:
        return LogPlace((), is_kept=False)
    history = await cast(KeepsPositionHistory, cell.robot).position_history(())
    return LogPlace(history.marks, is_kept=bool(history.marks))


async def refuse_lost_since(cell: Cell, place: LogPlace, is_later_entry: bool) -> int:
    """Return how many entries since concern the position: none, or this raises.

    Raises
    ------
    RefusalError
        The position was lost, or an axis was brought back, since the lengths were begun.
    DeclinedError
        The log does not tell it, and the technician said that something was done.
    """
    if not is_later_entry:
        return 0
    if place.is_kept:
        history = await cast(KeepsPositionHistory, cell.robot).position_history(place.marks)
        if history.alarms:
            alarm = history.alarms[0]
            raise RefusalError(
                make_message(
                    "the position was lost while this run was interrupted: {code} {text}",
                    code=alarm.code,
                    text=alarm.text,
                ),
                remedy="Start a new run: lengths from before and after the loss cannot be combined.",
            )
        if history.is_whole:
            return 0
    await ask_confirmation(cell, POSITION_KEPT)
    return 0
