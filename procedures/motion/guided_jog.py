"""A turn of one axis by a person at the pendant: guided while it is made, and checked by the counts when it stands.

An unmastered axis of a real controller is moved by no program. What a person does wrong costs another instruction
and nothing else: the rest of the way is asked for, an axis that had to stand is turned back first.
"""

import contextlib
import math
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError
from cellcal.drivers.interfaces import GuidesPerson, Instruction
from cellcal.procedures.cell import Cell
from cellcal.procedures.instruction_page import with_page
from cellcal.procedures.motion.approach import OVERSHOOT_RAD
from cellcal.procedures.motion.axis_watch import AxisWatch
from cellcal.procedures.motion.jog_guidance import JogGuidance, JogLeg
from cellcal.procedures.motion.manual_moves import NotThereError
from cellcal.procedures.motors import motor_store
from cellcal.procedures.questions import ask_while_watching
from cellcal.procedures.robot_condition import read_reached_condition

TRIES = 12


@dataclass(frozen=True, slots=True)
class HandJog:
    """A turn of one joint that a person makes; ``from_below``: it has to come to rest turning upwards."""

    axis: int
    delta_rad: float
    speed_rad_s: float
    tolerance_rad: float
    from_below: bool = False


async def jog_by_hand(cell: Cell, jog: HandJog) -> None:
    """Ask for a turn of one joint alone until the motors' counts show it, and that no other joint turned.

    A motor that has not found its index may count a part of a turn when it does: a turn is forgiven then.

    Raises
    ------
    DeclinedError
        The technician said no.
    NotThereError
        It was asked for again and again, and a joint stands elsewhere.
    """
    store = motor_store(cell)
    watch = AxisWatch(await store.drive_train(), await store.encoder_counts())
    allowance_rad = await _index_allowance_rad(cell, watch, jog.axis)
    progress_text, axis, names = "", jog.axis, cell.robot.capabilities.all_axis_names()
    for _ in range(TRIES):
        leg = _next_leg(jog, watch, axis, names)
        await _ask_and_watch(cell, jog, leg, watch, allowance_rad, progress_text)
        if _is_there(jog, watch, axis, allowance_rad):
            watch.accept_axis(axis)
        other = watch.other_axis(jog.axis, _allowance_of_others(allowance_rad, jog.axis))
        if other is None and _is_there(jog, watch, jog.axis, allowance_rad):
            return
        axis = jog.axis if other is None else other
        progress_text = "Not there yet. "
        if other is not None:
            turned = math.degrees(watch.turned_rad[other] - watch.accepted_rad[other])
            progress_text = make_message(
                "{other} turned by {turned:+.2f} deg and should have stood. ",
                other=names[other],
                turned=turned,
            )
    left_deg = math.degrees(_left_rad(jog, watch, axis))
    raise NotThereError(
        make_message(
            "{axis} was not turned as asked: {open_deg:+.2f} deg are left.",
            axis=names[axis],
            open_deg=left_deg,
        ),
        remedy="Find out what keeps it from turning, then resume.",
    )


async def _index_allowance_rad(cell: Cell, watch: AxisWatch, axis: int) -> Array:
    """Return what each joint's count may jump when a motor that seeks its index finds it (n,)."""
    seeking = any(alarm.axis in (axis, None) for alarm in (await read_reached_condition(cell.robot)).alarms)
    per_turn = np.abs(watch.drive.radians_per_turn())
    if not seeking:
        return np.zeros(len(per_turn))
    allowance_rad = per_turn[:, axis].copy()
    allowance_rad[axis] = per_turn[axis].sum()
    return allowance_rad


def _allowance_of_others(allowance_rad: Array, axis: int) -> Array:
    others = allowance_rad.copy()
    others[axis] = 0.0
    return others


def _left_rad(jog: HandJog, watch: AxisWatch, axis: int) -> float:
    goal = jog.delta_rad if axis == jog.axis else float(watch.accepted_rad[axis])
    return goal - float(watch.turned_rad[axis])


def _is_there(jog: HandJog, watch: AxisWatch, axis: int, allowance_rad: Array) -> bool:
    allowed = jog.tolerance_rad + (float(allowance_rad[axis]) if axis == jog.axis else 0.0)
    near = abs(_left_rad(jog, watch, axis)) <= allowed
    return near and (not jog.from_below or watch.is_from_below(axis))


def _next_leg(jog: HandJog, watch: AxisWatch, axis: int, names: tuple[str, ...]) -> JogLeg:
    """Return what to turn next: upwards at the end, where the joint has to come from below."""
    left_rad = _left_rad(jog, watch, axis)
    if not jog.from_below or left_rad >= OVERSHOOT_RAD:
        return JogLeg(axis, left_rad, 0.0, names)
    if abs(left_rad - OVERSHOOT_RAD) <= jog.tolerance_rad and not watch.is_from_below(axis):
        return JogLeg(axis, OVERSHOOT_RAD, 0.0, names)  # near enough already; only the side is missing
    return JogLeg(axis, left_rad - OVERSHOOT_RAD, OVERSHOOT_RAD, names)


async def _ask_and_watch(
    cell: Cell, jog: HandJog, leg: JogLeg, watch: AxisWatch, allowance_rad: Array, progress_text: str
) -> None:
    """Ask for a leg, and show from the counts what is left of it until the person says that it stands."""
    words = Instruction(
        "jog_by_hand",
        make_message(
            "{progress_text}{sentence}",
            progress_text=progress_text,
            sentence=leg.sentence(jog.speed_rad_s),
        ),
    )
    shown = JogGuidance.begin(leg, watch, jog.tolerance_rad)
    page = with_page(words, "ask", jog=shown.as_json())
    store = motor_store(cell)

    async def show_turn(guides: GuidesPerson | None) -> None:
        nonlocal shown
        with contextlib.suppress(DeviceError):  # the look after the answer raises it
            watch.take_counts(await store.encoder_counts())
        shown = shown.after(watch, _allowance_of_others(allowance_rad, leg.axis))
        if guides is not None:
            guides.show_guidance(shown.sentence, shown.as_json())

    await ask_while_watching(cell, page, show_turn, cell.limits.look_s)
    watch.take_counts(await store.encoder_counts())
