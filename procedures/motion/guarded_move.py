"""Moves that a touch ends: the arm travels, the probe is watched, and the joints are read all the way."""

import asyncio
from collections.abc import Coroutine, Sequence
from dataclasses import dataclass, field
from typing import Any

from cellcal.drivers.interfaces import ContactEdge, Joints, Robot, TouchProbe
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion import motion_gate
from cellcal.procedures.motion.joint_history import TimedJoints
from cellcal.procedures.motion.motion_gate import MotionCare
from cellcal.procedures.motion.robot_readiness import loop_time

READ_PAUSE_S = 0.005


@dataclass(slots=True)
class GuardedTravel:
    """The observations along a guarded way."""

    readings: list[TimedJoints] = field(default_factory=list)
    edge: ContactEdge | None = None


async def move_until_contact(
    cell: Cell, probe: TouchProbe, stops: Sequence[Joints], speed_rad_s: float, care: MotionCare
) -> GuardedTravel:
    """Move from stop to stop until the contact closes; the arm stands when this returns or raises."""
    travel, enough = GuardedTravel(), asyncio.Event()
    watching = asyncio.create_task(probe.wait_for_touch())
    recording = asyncio.create_task(_record_joints(cell.robot, travel.readings, enough))
    try:
        for stop in stops:
            going = motion_gate.move_along(cell, [stop], speed_rad_s, care=care)
            await _move_guarded(going, watching, recording)
            if watching.done():
                break
        # a touch may still be on its way
        await asyncio.wait({watching}, timeout=probe.capabilities.reaction_s)
        travel.edge = watching.result() if watching.done() else None
        enough.set()
        await recording
    finally:
        await _end_tasks(watching, recording)
    travel.readings.append(await _read_timed(cell.robot))
    return travel


async def _move_guarded(
    going: Coroutine[Any, Any, None], watching: asyncio.Task[ContactEdge], recording: asyncio.Task[None]
) -> None:
    """Move unless and until one of the guards ends: a cancelled move stops. Raise what went wrong with any."""
    moving = asyncio.create_task(going)
    try:
        await asyncio.wait({moving, watching, recording}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        await _end_tasks(moving)
    for task in (moving, watching, recording):
        if task.done() and not task.cancelled() and (trouble := task.exception()) is not None:
            raise trouble


async def _record_joints(robot: Robot, readings: list[TimedJoints], enough: asyncio.Event) -> None:
    """Read the joints over and over, and end between two readings: a cancelled one may cost the link."""
    while not enough.is_set():
        readings.append(await _read_timed(robot))
        await asyncio.sleep(READ_PAUSE_S)


async def _read_timed(robot: Robot) -> TimedJoints:
    asked_s = loop_time()
    reading = await robot.read_joints()
    return TimedJoints(asked_s, reading.taken_at_s, reading.joints_rad, reading.device_time_s)


async def _end_tasks(*tasks: asyncio.Task[None] | asyncio.Task[ContactEdge]) -> None:
    """Cancel what still runs and wait for its end, also when we are cancelled ourselves; then re-raise."""
    cancelled: asyncio.CancelledError | None = None
    for task in tasks:
        task.cancel()
    while not all(task.done() for task in tasks):
        try:
            await asyncio.wait(tasks)
        except asyncio.CancelledError as error:
            cancelled = error
    for task in tasks:
        if not task.cancelled():
            task.exception()  # consumed: what matters of it is raised by who looked
    if cancelled is not None:
        raise cancelled
