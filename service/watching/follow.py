"""The watch over a whole cell until somebody ends it: encoders where a robot tells them, else stops and faults."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from drivers.errors import DeviceError, WrongDeviceError
from drivers.interfaces import Readiness, Robot
from service.configuration.cell_file import CellConfig
from service.runs.cell import leases
from service.runs.lease import DEVICES, is_held
from service.watching.held_mastering import HeldMastering, journalled_mastering
from service.watching.loss_modes import wrong_robot
from service.watching.watch import LastHealthyCounts, PositionLoss, Watch
from service.watching.watched import watched

_RETRY_S = 5.0


@dataclass(frozen=True, slots=True)
class Listener:
    """Who hears what the watch has to say."""

    say: Callable[[str], None]
    on_loss: Callable[[PositionLoss], Awaitable[None]]


async def follow(config: CellConfig, listener: Listener) -> None:
    """Watch all robots of a cell until cancelled; an unreachable one is looked for again and again."""
    async with asyncio.TaskGroup() as tasks:
        for robot in config.robots:
            tasks.create_task(_follow_robot(config, robot, listener))


async def _follow_robot(config: CellConfig, entry: Any, listener: Listener) -> None:
    told = ""
    while True:
        if is_held(leases(config), entry.serial, DEVICES):  # connecting could take the link away from a run
            await asyncio.sleep(_RETRY_S)
            continue
        try:
            async with entry.open() as robot:
                seen = watched(robot.capabilities)
                listener.say(f"{robot.name}: watched every {config.watch.period_s:g} s: {seen}.")
                told = ""
                if robot.capabilities.writes_mastering:
                    await _look_again_and_again(config, entry, robot, listener)
                else:
                    await _tell_stops(config, entry, robot, listener)
        except WrongDeviceError as error:
            if error.message != told:
                told = error.message
                await listener.on_loss(PositionLoss(entry.name, error.message, (), None, wrong_robot()))
        except DeviceError as error:
            if error.message != told:
                listener.say(f"{error}")
                told = error.message
        await asyncio.sleep(_RETRY_S)


async def _tell_stops(config: CellConfig, entry: Any, robot: Robot, listener: Listener) -> None:
    """Say each time that a robot stops, cannot be reached, or has neither any more."""
    told = ""
    while True:
        if not is_held(leases(config), entry.serial, DEVICES):  # a run tells of its own stops
            condition = await robot.condition()
            wrong = condition.readiness in (Readiness.STOPPED, Readiness.UNREACHABLE)
            words = f"{robot.name}: {condition.message} {condition.remedy}" if wrong else ""
            if words != told:
                listener.say(words or f"{robot.name}: neither stopped nor out of reach any more.")
            told = words
        await asyncio.sleep(config.watch.period_s)


async def _look_again_and_again(config: CellConfig, entry: Any, robot: Any, listener: Listener) -> None:
    memory = LastHealthyCounts(config.cell.data_dir)
    held = HeldMastering(journalled_mastering(config, entry.serial))
    period_s = config.watch.period_s
    watch = Watch(robot, memory, listener.on_loss, period_s=period_s, warn=listener.say, held=held)
    while True:
        if is_held(
            leases(config), entry.serial, DEVICES
        ):  # a run has the robot; its own steps guard the encoders
            watch.forget_motion()
        else:
            await watch.look()
        await asyncio.sleep(config.watch.period_s)
