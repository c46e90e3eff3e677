"""The robots of the cell that are not selected: followed all the same, each over a connection of its own.

What they lose, and whether they stop or are out of reach, is told beside the selected one. Nothing here moves them.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError
from cellcal.drivers.interfaces import Condition, Robot
from cellcal.drivers.supervision import start_task
from cellcal.drivers.wire.cancellation import cancel_until_done
from cellcal.service.cell_process.live_values import DeviceStatus
from cellcal.service.cell_process.loss_watch import LossWatch
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.session_documents import DeviceDocument
from cellcal.service.watching.follow import RobotListener, follow_robot

_log = logging.getLogger(__name__)
ROLE = "other_robot"
_CANCEL_AGAIN_S = 70.0  # longer than a link may take to give its session back
ELSEWHERE = "another cellcal is connected to it."
BROKEN = "the program failed: this robot is not watched until that is started again, by itself."


class UnselectedRobots:
    """Follows all robots but one. A task a robot, so that a slow one holds up nothing."""

    def __init__(
        self, config: CellConfig, watch: LossWatch, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._config, self._watch, self._clock = config, watch, clock
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._shown: dict[str, DeviceStatus] = {}
        self._listener = RobotListener(_log.info, self._on_look, self._on_missing)

    async def follow_all_but(self, selected: str) -> None:
        """Follow every robot but the selected one, whose link is free when this returns."""
        await self._stop_robot(selected)
        for entry in self._config.robots:
            if entry.name != selected and entry.name not in self._tasks:
                self._shown[entry.name] = DeviceStatus(ROLE, entry.name, live=False)
                self._tasks[entry.name] = start_task(
                    make_message("watch of {robot}", robot=entry.name), partial(self._follow_entry, entry)
                )

    async def stop_following(self) -> None:
        """Stop following."""
        for name in list(self._tasks):
            await self._stop_robot(name)

    def as_json(self) -> list[DeviceDocument]:
        """Return how they are, as devices of the live message."""
        now_s = self._clock()
        return [shown.as_json(now_s) for shown in self._shown.values()]

    async def _stop_robot(self, name: str) -> None:
        task = self._tasks.pop(name, None)
        if task is not None:
            await cancel_until_done(task, every_s=_CANCEL_AGAIN_S)
        self._shown.pop(name, None)

    async def _follow_entry(self, entry: Any) -> None:
        try:
            await follow_robot(self._watch.watches, entry, self._listener)
        except Exception:  # shown on the screen; the supervisor names it and follows anew
            self._shown[entry.name].condition = None
            self._shown[entry.name].error = BROKEN
            raise

    async def _on_look(self, robot: Robot, condition: Condition) -> None:
        shown = self._shown[robot.name]
        shown.take_condition(condition, self._clock())
        try:
            reading = await robot.read_joints()
        except DeviceError as error:
            shown.error, shown.value = error.message, None
        else:
            value = {"joints_rad": list(reading.joints_rad), "moving": reading.moving}
            shown.update_value(value, self._clock())
        await self._watch.clear_resolved_loss(robot.name)

    def _on_missing(self, robot: str, condition: Condition | None) -> None:
        shown = self._shown[robot]
        shown.condition, shown.value = condition, None
        shown.error = ELSEWHERE if condition is None else ""
