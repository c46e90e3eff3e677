"""The work at the pendant after a lost position, axis by axis, in the words of each make; and its looking after.

Nothing is written by wire: a person jogs and confirms, and the state of the axis is read until it is as it should be.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError
from cellcal.drivers.interfaces import GuidesPerson, Instruction, Joints, PositionCure, Readiness
from cellcal.procedures.axis_texts import joints_text
from cellcal.procedures.cell import Cell
from cellcal.procedures.instruction_page import with_page
from cellcal.procedures.questions import ask_confirmation, ask_while_watching
from cellcal.procedures.recovery.shown_position import (
    AxisState,
    read_axis_state,
    with_shown_motors,
)
from cellcal.procedures.robot_condition import read_reached_condition
from cellcal.procedures.run import ProcedureError, RefusalError

Zero = Literal["kept", "new"]
TRIES = 5
WATCH_S = 0.5  # between looks at the axis while a person works at it
_AXES: Mapping[PositionCure, tuple[str, ...]] = {
    PositionCure.REVOLUTION_COUNTERS: ("1", "2", "3", "4", "5", "6"),
    PositionCure.ABSOLUTE_DATA: ("S", "L", "U", "R", "B", "T"),
    PositionCure.MASTERING_GAUGE: ("A1", "A2", "A3", "A4", "A5", "A6"),
}
USUAL_ZERO: Mapping[PositionCure, Zero] = {
    PositionCure.REVOLUTION_COUNTERS: "kept",
    PositionCure.ABSOLUTE_DATA: "kept",
    PositionCure.MASTERING_GAUGE: "new",
}
SHOWS_EACH_AXIS = (PositionCure.REVOLUTION_COUNTERS, PositionCure.MASTERING_GAUGE)


class NotBroughtBackError(ProcedureError):
    """The controller still shows a lost position after the work at the pendant was said to be done."""

    code = "procedure.not_brought_back"


@dataclass(frozen=True, slots=True)
class AxisCure:
    """One axis and how its position is brought back; ``was_lost``: the controller shows it as lost."""

    axis: int
    cure: PositionCure
    zero: Zero
    was_lost: bool


@dataclass(frozen=True, slots=True)
class CuredAxis:
    """The controller's values of an axis after a person had worked at it, and how often that took a yes."""

    axis: int
    tries: int
    words: str


def axis_name(cure: PositionCure, axis: int) -> str:
    """Return what the maker calls an axis."""
    names = _AXES[cure]
    return names[axis] if 0 <= axis < len(names) else str(axis + 1)


async def bring_back_axis(cell: Cell, what: AxisCure) -> CuredAxis:
    """Ask for the work at one axis until the controller no longer shows it as lost, where it shows each by itself.

    Raises
    ------
    DeclinedError
        The technician said no.
    NotBroughtBackError
        It was asked for again and again, and the axis is shown as lost.
    """
    wrong_text = await _done_before_text(cell, what)
    for tries in range(1, TRIES + 1):
        await _ask_and_watch(cell, what, wrong_text)
        state = await read_axis_state(cell)
        if what.axis not in state.lost_axes or what.cure not in SHOWS_EACH_AXIS:
            return CuredAxis(what.axis, tries, state.words)
        wrong_text = make_message(
            "The controller still shows axis {axis} as lost. ", axis=axis_name(what.cure, what.axis)
        )
    raise _not_back_error(state)


async def _done_before_text(cell: Cell, what: AxisCure) -> str:
    """Return what to say where the work was done already, as by an entry of the run that lost the link after it."""
    if not what.was_lost or what.cure not in SHOWS_EACH_AXIS:
        return ""
    if what.axis in (await read_axis_state(cell)).lost_axes:
        return ""
    return make_message(
        "The controller shows axis {axis} as brought back already: where that was done as said here, only confirm. ",
        axis=axis_name(what.cure, what.axis),
    )


async def see_none_lost(cell: Cell, brought_back: tuple[int, ...]) -> AxisState:
    """Return the state of all axes once the controller shows none as lost; have the rest done at the pendant.

    Raises
    ------
    RefusalError
        An axis is lost that was not when the run began: no step of this run led a person through bringing it back.
    NotBroughtBackError
        It still shows a lost position after several tries.
    """
    state = await read_axis_state(cell)
    names = ", ".join(axis_name(state.cure, axis) for axis in brought_back)
    for _ in range(TRIES):
        if not state.is_lost:
            return state
        if others := [axis for axis in state.lost_axes if axis not in brought_back]:
            raise _lost_since_error(state, others)
        text = make_message(
            "The controller still shows a lost position: {words} Bring it back at the pendant and reset the alarm. "
            "Look again at each axis of this run ({names}): its mark, and what was done at the pendant.",
            words=state.words,
            names=names,
        )
        await ask_confirmation(cell, Instruction("position_still_lost", text))
        state = await read_axis_state(cell)
    raise _not_back_error(state)


async def make_ready(cell: Cell, reference_rad: Joints) -> Joints:
    """Have the arm brought near the record's pose, and the controller made ready; return where it then stands.

    Raises
    ------
    ProcedureError
        It is not ready after several tries.
    """
    by_hand = with_shown_motors(cell).is_jogged_by_hand
    allowed = (Readiness.READY, Readiness.NOT_READY) if by_hand else (Readiness.READY,)
    words = ""
    for _ in range(TRIES):
        text = make_message(
            "{words}In manual mode bring the robot near the pose of the record, as the pendant shows the joints: "
            "{joints}. Watch the arm: an axis may stand some motor turns from what is shown. Then hook the draw-wire "
            "to the flange and make the controller ready to move.",
            words=words,
            joints=joints_text(cell, reference_rad, 1),
        )
        await ask_confirmation(cell, Instruction("near_record_pose", text))
        condition = await read_reached_condition(cell.robot)
        if condition.readiness in allowed:
            return (await cell.robot.read_joints()).joints_rad
        words = make_message("Not ready yet: {reason} ", reason=condition.message)
    raise NotBroughtBackError(
        make_message("the robot is not ready: {reason}", reason=condition.message), remedy=condition.remedy
    )


def cure_instruction(what: AxisCure, wrong_text: str = "") -> Instruction:
    """Return what a person does at the pendant for one axis."""
    axis = axis_name(what.cure, what.axis)
    if what.cure is PositionCure.REVOLUTION_COUNTERS and what.zero == "kept":
        text = make_message(
            "{wrong_text}Axis {axis}: in manual mode, jog this axis alone until its calibration mark lines up. Then "
            "update the revolution counter of this axis alone at the pendant.",
            wrong_text=wrong_text,
            axis=axis,
        )
    elif what.cure is PositionCure.REVOLUTION_COUNTERS:
        text = make_message(
            "{wrong_text}Axis {axis}: do the fine calibration of this axis alone, as the maker's manual says, then "
            "update its revolution counter at the pendant.",
            wrong_text=wrong_text,
            axis=axis,
        )
    elif what.cure is PositionCure.ABSOLUTE_DATA and what.zero == "kept":
        text = make_message(
            "{wrong_text}Axis {axis}: with a new battery in place, jog this axis alone to its home mark. "
            "Then type the absolute data of this axis from the robot's label, and reset the alarm.",
            wrong_text=wrong_text,
            axis=axis,
        )
    elif what.cure is PositionCure.ABSOLUTE_DATA:
        text = make_message(
            "{wrong_text}Axis {axis}: with a new battery in place, jog this axis alone to its home mark "
            "and make its home position anew there, then reset the alarm.",
            wrong_text=wrong_text,
            axis=axis,
        )
    else:
        text = make_message(
            "{wrong_text}Axis {axis}: in T1, jog this axis alone to the mark of its gauge cartridge. Fit the EMD or "
            "the dial gauge and master this axis at the pendant, as the maker's manual says for the mounted tool.",
            wrong_text=wrong_text,
            axis=axis,
        )
    return Instruction(f"bring_back_{what.cure.value}", text)


async def _ask_and_watch(cell: Cell, what: AxisCure, wrong_text: str) -> None:
    """Ask for the work, and show what the controller says of the axis until the person says that it is done."""

    async def show_state(guides: GuidesPerson | None) -> None:
        if (
            guides is None or what.cure not in SHOWS_EACH_AXIS
        ):  # one alarm of all axes says nothing of this one
            return
        try:
            state = await read_axis_state(cell)
        except DeviceError:  # the look after the answer raises it
            return
        axis, is_lost = axis_name(what.cure, what.axis), what.axis in state.lost_axes
        if is_lost:
            sentence = make_message("Axis {axis} is not brought back yet.", axis=axis)
        else:
            sentence = make_message("The controller takes axis {axis} as good.", axis=axis)
        guides.show_guidance(sentence, {"axis": what.axis, "is_lost": is_lost})

    instruction = cure_instruction(what, wrong_text)
    name = axis_name(what.cure, what.axis)
    await ask_while_watching(cell, with_page(instruction, "ask", axis_name=name), show_state, WATCH_S)


def _lost_since_error(state: AxisState, axes: list[int]) -> RefusalError:
    names = ", ".join(axis_name(state.cure, axis) for axis in axes)
    return RefusalError(
        make_message(
            "axis {names} lost its position after this run had begun: {words}", names=names, words=state.words
        ),
        remedy="Start a new run: it leads through every axis that is lost, and proves all of them.",
    )


def _not_back_error(state: AxisState) -> NotBroughtBackError:
    return NotBroughtBackError(
        make_message("the position was not brought back: {words}", words=state.words),
        remedy="Do not run programs. Bring the position back as the maker's manual says, then resume.",
    )
