"""What the devices show ten times a second. A run's own readings always come first.

While a run reads a gauge or moves the robot, a screen's look at it waits for the next tenth of a second: it is
never queued behind a capture, and a capture waits at most for one look.
"""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from drivers.errors import DeviceError
from drivers.interfaces import Condition, Reading
from procedures.cell import Cell
from service.desk.recording import SETTLE_SIGMAS, Settle, Standing

CONDITION_EVERY_S = 1.0
STOP_EVERY_S = 0.15  # at every second look: a stopped robot is shown within half a second, in a run, too


class SharedGauge:
    """A gauge that a run and a screen both read, one at a time."""

    def __init__(self, gauge: Any) -> None:
        self._gauge, self._turn = gauge, asyncio.Lock()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._gauge, name)

    async def distance(self) -> Reading:
        async with self._turn:
            reading: Reading = await self._gauge.distance()
            return reading

    async def glimpse(self) -> Reading | None:
        """Return a reading, or None while somebody else takes one."""
        return None if self._turn.locked() else await self.distance()


@dataclass(slots=True)
class Shown:
    """The last that was heard of one device."""

    role: str
    name: str
    condition: Condition | None = None
    value: Any = None
    heard_at_s: float | None = None
    error: str = ""
    settle: Settle | None = None
    due: str = ""  # until when its calibration holds (ISO date)

    def as_json(self, now_s: float) -> dict[str, Any]:
        """Return it for a screen: the value with its age, and what is wrong."""
        condition = self.condition
        return {
            "role": self.role,
            "name": self.name,
            "state": "unknown" if condition is None else condition.readiness.value,
            "message": self.error or ("" if condition is None else condition.message),
            "remedy": "" if condition is None else condition.remedy,
            "age_s": None if self.heard_at_s is None else round(now_s - self.heard_at_s, 3),
            "value": self.value,
            "due": self.due,
            "settle": None if self.settle is None else self.settle.as_json(now_s),
        }


class Glance:
    """Looks at robot and gauge again and again, and remembers what it saw."""

    def __init__(self, cell: Cell, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._cell, self._clock = cell, clock
        self._asked_at_s = self._robot_asked_at_s = float("-inf")
        self.robot = Shown("robot", cell.robot.name)
        self.others = [
            Shown(role, device.name, settle=_settle(role, device), due=_due(role, cell))
            for role, device in (
                ("gauge", cell.gauge),
                ("tracker", cell.tracker),
                ("probe", cell.probe),
                ("dial", cell.dial),
            )
            if device is not None
        ]

    async def look(self, *, busy: bool) -> None:
        """Look once. ``busy``: a run has the devices, so only what cannot disturb it is asked."""
        await self._ask(self.robot, self._joints())
        for shown in self.others:
            if shown.role in ("gauge", "dial"):
                await self._ask(shown, self._length(shown.role))
        if self._clock() - self._robot_asked_at_s >= STOP_EVERY_S:
            self._robot_asked_at_s = self._clock()
            self.robot.condition = await self._cell.robot.condition()
        if not busy and self._clock() - self._asked_at_s >= CONDITION_EVERY_S:
            self._asked_at_s = self._clock()
            await self._conditions_of_others()

    def as_json(self) -> dict[str, Any]:
        """Return the live message: newest values with their ages."""
        now_s = self._clock()
        return {"devices": [shown.as_json(now_s) for shown in (self.robot, *self.others)]}

    def standing(self) -> Standing:
        """Return how robot and wire stand, as they were seen last."""
        now_s, robot = self._clock(), self.robot
        age_s = float("inf") if robot.heard_at_s is None else now_s - robot.heard_at_s
        gauge = next((shown for shown in self.others if shown.role == "gauge"), None)
        settled = None if gauge is None or gauge.settle is None else gauge.settle.settled(now_s)
        if robot.value is None:
            return Standing(None, moving=False, age_s=age_s, settled=settled)
        joints = tuple(robot.value["joints_rad"])
        return Standing(joints, robot.value["moving"], age_s, settled)

    async def _joints(self) -> Any:
        reading = await self._cell.robot.joints()
        return {"joints_rad": list(reading.joints_rad), "moving": reading.moving}

    async def _length(self, role: str) -> Any:
        device = getattr(self._cell, role)
        reading = await device.glimpse() if isinstance(device, SharedGauge) else None
        return None if reading is None else {"length_m": reading.value_m, "sigma_m": reading.sigma_m}

    async def _ask(self, shown: Shown, question: Any) -> None:
        try:
            value = await question
        except DeviceError as error:
            shown.error, shown.value = error.message, None
            return
        if value is None:
            return
        shown.value, shown.heard_at_s, shown.error = value, self._clock(), ""
        if shown.settle is not None:
            shown.settle.take(shown.heard_at_s, value["length_m"])

    async def _conditions_of_others(self) -> None:
        for shown in self.others:
            shown.condition = await getattr(self._cell, shown.role).condition()


def _due(role: str, cell: Cell) -> str:
    held = cell.gauge_certificate if role == "gauge" else None
    return "" if held is None else held.due


def _settle(role: str, device: Any) -> Settle | None:
    return Settle(SETTLE_SIGMAS * device.capabilities.sigma_m) if role in ("gauge", "dial") else None
